"""Views in each medium: the terminal, Markdown and CSV; the pages' templates show the same parts."""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Iterator
from functools import cache, partial
from textwrap import TextWrapper

from rich.box import SIMPLE_HEAD
from rich.console import Console, ConsoleOptions, Group, RenderableType, RenderResult
from rich.measure import Measurement
from rich.table import Table as RichTable
from rich.text import Text

from ..terminal import shown
from .view import SHORTEST, Answers, Note, Part, Table, View, shortened

#: Colours of words that fill a cell.
_COLOURS = {
    **dict.fromkeys(("worse", "mixed", "vanished", "FAIL", "NO", "does not hold", "cannot be used"), "red"),
    **dict.fromkeys(("better", "appeared", "pass", "yes", "holds"), "green"),
    **dict.fromkeys(("undecided", "not decided"), "yellow"),
}
#: Beginnings of formulas; the full-width ones in East Asian locales.
_FORMULA = ("=", "+", "-", "@", "\uff1d", "\uff0b", "\uff0d", "\uff20")
_NUMBER = re.compile(r"[-+]?[0-9]+(\.[0-9]+)?")
_INDENT, _NARROWEST = 14, 40
_WRAPPER = partial(TextWrapper, break_long_words=False, break_on_hyphens=False)


def terminal(view: View) -> RenderableType:
    """A view as rich prints it; no name in it is read as markup."""
    return Group(*map(_in_terminal, view))


def markdown(view: View) -> str:
    r"""A view for a merge request: its heading bold, warnings as a list, tables as GitHub and GitLab show them.

    Examples
    --------
    >>> print(markdown([Table("", ["pair", "CDC"], [["a|b", 0.5]])]), end="")
    | pair | CDC |
    | :--- | ---: |
    | a\|b | 0.500 |
    """
    text = ""
    for part in filter(None, map(_in_markdown, view)):
        is_item = part.startswith("- ") and text.rpartition("\n")[2].startswith("- ")
        text += f"{chr(10) * (1 if is_item else 2) if text else ''}{part}"
    return f"{text}\n"


def csv_table(table: Table) -> str:
    """A table as spreadsheets open it (RFC 4180, lines end with a line feed); floats in full, None is an empty cell.

    A text that a spreadsheet would take for a formula begins with an apostrophe, unless it is a number.

    Examples
    --------
    >>> print(csv_table(Table("", ["pair"], [["=1+1"], ["-5"], [-0.5]])), end="")
    pair
    '=1+1
    -5
    -0.5
    """
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(table.headings)
    writer.writerows([_in_spreadsheet(cell) for cell in row] for row in table.rows)
    return text.getvalue()


def _in_terminal(part: Part) -> RenderableType:
    if isinstance(part, Note):
        return Text(part.text, part.style)
    return _AnswerLines(part) if isinstance(part, Answers) else _table(part)


def _table(table: Table) -> RichTable:
    """A table without rules; words break into lines at blanks, numbers never."""
    title = Text(table.title, "bold") if table.title else None
    made = RichTable(title=title, title_justify="left", title_style="", box=SIMPLE_HEAD, padding=(0, 1, 0, 0))
    columns = [i for i in range(len(table.headings)) if i not in table.wide]
    cells = table.cells
    for i in columns:
        is_words, heading = i in table.words, table.headings[i]
        longest = max((len(word) for row in (table.headings, *cells) for word in row[i].split()), default=1)
        made.add_column(
            heading,
            justify="left" if is_words else "right",
            overflow="fold" if is_words else "ellipsis",
            no_wrap=not is_words if table.fixed is None else i in table.fixed,
            min_width=max(map(len, heading.split()), default=1) if is_words else None,
            width=longest if i in table.whole else None,
        )
    breaking = [i for i, column in zip(columns, made.columns, strict=True) if i in table.words and not column.no_wrap]
    among = {i: frozenset(word for row in cells for word in row[i].split()) for i in breaking}
    for place, row in enumerate(cells):
        texts = {i: Text(row[i], _COLOURS.get(row[i], "")) for i in columns}
        made.add_row(
            *(_Words(text, among[i]) if i in among else text for i, text in texts.items()),
            style="bold" if place in table.bold else None,
            end_section=place in table.ruled,
        )
    return made


class _Words:
    """A cell of words: breaks into lines at blanks, and shortens words that are too long for its column.

    among : all words of the column, so that different ones stay different
    """

    def __init__(self, text: Text, among: frozenset[str]) -> None:
        self._text, self._among = text, among

    def __rich_measure__(self, console: Console, options: ConsoleOptions) -> Measurement:
        lines, words = self._text.plain.splitlines(), self._text.plain.split()
        longest = max(map(len, words), default=0)
        return Measurement(min(longest, SHORTEST), max(map(len, lines), default=0))

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        width = options.max_width
        if all(len(word) <= width for word in self._text.plain.split()):
            yield self._text
        else:
            short = _shortened(self._among, width)
            yield Text(" ".join(short[word] for word in self._text.plain.split()), self._text.style, overflow="fold")


_shortened = cache(shortened)


class _AnswerLines:
    """Headings on the left, their answers next to them."""

    def __init__(self, answers: Answers) -> None:
        self._sections = answers.sections

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        width = max(options.max_width, _NARROWEST)
        for heading, items in self._sections:
            lines = [line for item in items for line in _lines(item, width - _INDENT)]
            for i, line in enumerate(lines):
                title = (heading if i == 0 else "").ljust(_INDENT)
                yield Text.assemble((title, "bold" if heading[0].isupper() else ""), line)


def _lines(item: tuple[str, str, str], width: int) -> Iterator[str]:
    """An item in lines: words, detail, and at the end of the first line the setting; the rest is wrapped below."""
    words, detail, setting = item
    hang = " " * 3 * (words[1:3] == "  ")
    if detail and len(words) + len(detail) + len(setting) + 5 <= width:
        words, detail = f"{words}   {detail}", ""
    if setting and len(words) + len(setting) + 2 <= width:
        words, setting = words.ljust(width - len(setting)) + setting, ""
    for text, indent in ((words, ""), ("   ".join(filter(None, (detail, setting))), hang)):
        yield from _WRAPPER(width=width, initial_indent=indent, subsequent_indent=hang).wrap(text)


def _in_markdown(part: Part) -> str:
    if isinstance(part, Note):
        text = _escaped(part.text.strip().removeprefix("note: "))
        return f"**{text}**" if "bold" in part.style else f"- {text}" if part.style and text else text
    if isinstance(part, Answers):
        return "\n\n".join(
            f"{heading.strip()}: {lines[0]}" if len(lines) == 1 else "\n".join([f"{heading.strip()}:\n", *lines])
            for heading, items in part.sections
            for lines in [["- " * (len(items) > 1) + _escaped("; ".join(filter(None, item))) for item in items]]
        )
    rule = [":---" if i in part.words else "---:" for i in range(len(part.headings))]
    headings = [_escaped(" ".join(heading.split())) for heading in part.headings]
    rows = [[_escaped(cell) for cell in row] for row in part.cells]
    lines = [f"| {' | '.join(row)} |" for row in (headings, rule, *rows)]
    return "\n".join([f"**{_escaped(part.title)}**\n"] * bool(part.title) + lines)


def _escaped(text: str) -> str:
    """Text for Markdown: no name ends a cell, or becomes HTML, a link or a picture."""
    return re.sub(r"[\\|<\[]", r"\\\g<0>", shown(text))


def _in_spreadsheet(value: object) -> object:
    """A cell; a text that begins a formula is marked as text (OWASP, CSV Injection)."""
    if not isinstance(value, str):
        return value
    text = shown(value)
    return f"'{text}" if text.startswith(_FORMULA) and not _NUMBER.fullmatch(text) else text
