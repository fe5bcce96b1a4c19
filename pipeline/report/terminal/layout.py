"""The look that all tables of the terminal share, and the same tables as Markdown and CSV."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Container, Iterable, Mapping, Sequence

from rich.box import SIMPLE_HEAD
from rich.table import Table
from rich.text import Text


def plain_table(
    title: str,
    columns: Iterable[str],
    rows: Iterable[Sequence[object]],
    words: Container[int] = (0,),
    digits: Mapping[int, int] | None = None,
) -> Table:
    """A table without rules; no name in it is read as markup, and None is shown as a dash.

    Parameters
    ----------
    columns : headings
    rows : cells in the order of the columns
    words : indices of the columns that hold words; the others hold numbers, which are never broken into lines
    digits : by index of a column, the digits of its floats; by default three
    """
    table = Table(
        title=Text(title, style="bold"), title_justify="left", title_style="", box=SIMPLE_HEAD, padding=(0, 1, 0, 0)
    )
    for i, column in enumerate(columns):
        if i in words:
            table.add_column(column, overflow="fold")
        else:
            table.add_column(column, justify="right", no_wrap=True)
    for row in rows:
        table.add_row(*(_cell(value, (digits or {}).get(i, 3)) for i, value in enumerate(row)))
    return table


def markdown_table(headings: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    r"""A table as GitHub and GitLab show it; columns that hold no text are set to the right, None is an empty cell.

    Examples
    --------
    >>> print(markdown_table(["pair", "CDC"], [["a|b", 0.5]]), end="")
    | pair | CDC |
    | :--- | ---: |
    | a\|b | 0.500 |
    """
    cells = [list(row) for row in rows]
    is_text = [any(isinstance(row[i], str) for row in cells) for i in range(len(headings))]
    rule = [":---" if text else "---:" for text in is_text]
    lines = [map(_in_markdown, headings), rule, *(map(_in_markdown, row) for row in cells)]
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)


def csv_table(headings: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """A table as spreadsheets open it (RFC 4180, lines end with a line feed); floats in full, None is an empty cell."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(headings)
    writer.writerows(rows)
    return text.getvalue()


def number(value: float | None, digits: int = 3) -> str:
    """A number as the terminal shows it; a dash where there is none."""
    return "-" if value is None or math.isnan(value) else f"{value:.{digits}f}"


def signed(value: float | None) -> str:
    """A difference with its sign."""
    return "-" if value is None else f"{value:+.3f}"


def percent(value: float | None) -> str:
    """A share as the terminal shows it."""
    return "-" if value is None else f"{100 * value:.0f} %"


def mean_and_spread(mean: float | None, std: float | None, digits: int = 3) -> str:
    """A mean with its standard deviation, each a dash where there is none."""
    return f"{number(mean, digits)} ± {number(std, digits)}"


def _in_markdown(value: object) -> str:
    """A cell; what would end it or its line is written otherwise."""
    text = "" if value is None else number(value) if isinstance(value, float) else str(value)
    return " ".join(text.split()).replace("|", "\\|")


def _cell(value: object, digits: int) -> Text:
    if isinstance(value, Text):
        return value
    return Text(number(value, digits) if value is None or isinstance(value, float) else str(value))
