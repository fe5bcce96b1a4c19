"""Tables of the documentation that come from the code: `python tools/readme.py` rewrites them."""

import re
from pathlib import Path

from fidpipe.schemas import metric_catalogue, settings_text, tables

DOCS = Path(__file__).parents[1] / "docs"
TABLES = {
    DOCS / "scores.md": {"scores": metric_catalogue.to_markdown},
    DOCS / "settings.md": {"settings": settings_text.to_markdown},
    DOCS / "tables.md": {"tables": tables.to_markdown},
}


def with_tables(page):
    """The text of a page with each of its tables rewritten between its two marks, which must exist."""
    text = page.read_text(encoding="utf-8")
    for name, table in TABLES[page].items():
        marks = re.compile(rf"(<!-- {name}: .*? -->\n).*?(<!-- end of {name} -->)", re.DOTALL)
        text, n = marks.subn(lambda found, table=table: found[1] + table() + found[2], text)
        if n != 1:
            raise ValueError(f"{page}: expected one table marked {name!r}, got {n}")
    return text


if __name__ == "__main__":
    for page in TABLES:
        page.write_text(with_tables(page), encoding="utf-8")
