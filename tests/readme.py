"""The tables of the README that come from the code. `python tests/readme.py` writes them anew."""

import re
from pathlib import Path

from fidpipe.schemas import metrics, settings

FILE = Path(__file__).parents[1] / "README.md"
TABLES = {"scores": metrics.to_markdown, "settings": settings.to_markdown}


def with_tables(text):
    """The text with each table between its two marks; the marks must be there."""
    for name, table in TABLES.items():
        marks = re.compile(rf"(<!-- {name}: .*? -->\n).*?(<!-- end of {name} -->)", re.DOTALL)
        text, n = marks.subn(lambda found, table=table: found[1] + table() + found[2], text)
        if n != 1:
            raise ValueError(f"{FILE}: {n} tables marked {name!r} found, one is wanted")
    return text


if __name__ == "__main__":
    FILE.write_text(with_tables(FILE.read_text(encoding="utf-8")), encoding="utf-8")
