"""The look that all tables of the terminal share, and the same tables as Markdown and CSV."""

from __future__ import annotations

import csv
import io
import math
import re
from collections.abc import Container, Iterable, Mapping, Sequence
from functools import cache

from rich.box import SIMPLE_HEAD
from rich.console import Console, ConsoleOptions, RenderResult
from rich.measure import Measurement
from rich.table import Table
from rich.text import Text

from ...terminal import shown

#: A word that its column is too narrow for is shortened to no less than so many characters.
_SHORTEST = 8
_NUMBER = re.compile(r"[-+]?[0-9]+(\.[0-9]+)?")


def plain_table(
    title: str,
    columns: Iterable[str],
    rows: Iterable[Sequence[object]],
    words: Container[int] = (0,),
    digits: Mapping[int, int] | None = None,
) -> Table:
    """A table without rules; no name in it is read as markup, and None is shown as a dash.

    Words break into lines at their blanks; a word that is too long for its column is shortened in the middle.

    Parameters
    ----------
    columns : headings
    rows : cells in the order of the columns
    words : indices of the columns that hold words; the others hold numbers, which are never broken or shortened
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
    cells = [[_cell(value, (digits or {}).get(i, 3)) for i, value in enumerate(row)] for row in rows]
    among = {
        i: frozenset(word for row in cells for word in row[i].plain.split())
        for i in range(len(table.columns))
        if i in words
    }
    for row in cells:
        table.add_row(*(_Words(cell, among[i]) if i in among else cell for i, cell in enumerate(row)))
    return table


def shortened(names: Iterable[str], width: int) -> dict[str, str]:
    """Each name in at most `width` characters with an ellipsis in the middle; longer where two would become the same.

    Of a long name more of the end is kept, where the numbers of scans stand.

    Examples
    --------
    >>> list(shortened(["n008__LIDAR_TOP__1533151603597909", "n008__LIDAR_TOP__1533151603647909"], 12).values())
    ['n00…03597909', 'n00…03647909']
    """
    names = list(names)
    for own in range(max(width, _SHORTEST), max(map(len, names), default=0) + 1):
        head = (own - 1) * 3 // 11
        short = {
            name: name if len(name) <= own else f"{name[:head]}…{name[len(name) - (own - 1 - head) :]}"
            for name in names
        }
        if len(set(short.values())) == len(short):
            return short
    return {name: name for name in names}


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
    """A table as spreadsheets open it (RFC 4180, lines end with a line feed); floats in full, None is an empty cell.

    A text that a spreadsheet would take for a formula begins with an apostrophe, unless it is a number.

    Examples
    --------
    >>> print(csv_table(["pair"], [["=1+1"], ["-5"], [-0.5]]), end="")
    pair
    '=1+1
    -5
    -0.5
    """
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(headings)
    writer.writerows([_in_spreadsheet(cell) for cell in row] for row in rows)
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


_shortened = cache(shortened)


class _Words:
    """A cell of words: breaks into lines at blanks, and shortens words that are too long for its column.

    among : all words of the column, so that different ones stay different
    """

    def __init__(self, text: Text, among: frozenset[str]) -> None:
        self._text, self._among = text, among

    def __rich_measure__(self, console: Console, options: ConsoleOptions) -> Measurement:
        lines, words = self._text.plain.splitlines(), self._text.plain.split()
        longest = max(map(len, words), default=0)
        return Measurement(min(longest, _SHORTEST), max(map(len, lines), default=0))

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        width = options.max_width
        if all(len(word) <= width for word in self._text.plain.split()):
            yield self._text
        else:
            short = _shortened(self._among, width)
            yield Text(" ".join(short[word] for word in self._text.plain.split()), self._text.style, overflow="fold")


def _in_markdown(value: object) -> str:
    """A cell; what would end it or its line is written otherwise."""
    text = "" if value is None else number(value) if isinstance(value, float) else shown(value)
    return " ".join(text.split()).replace("|", "\\|")


def _in_spreadsheet(value: object) -> object:
    """A cell; a text that begins a formula is marked as text (OWASP, CSV Injection)."""
    if not isinstance(value, str):
        return value
    text = shown(value)
    return f"'{text}" if text.startswith(("=", "+", "-", "@")) and not _NUMBER.fullmatch(text) else text


def _cell(value: object, digits: int) -> Text:
    if isinstance(value, Text):
        return value
    return Text(number(value, digits) if value is None or isinstance(value, float) else str(value))
