"""Views in the terminal; templates of the pages show the same parts."""

from __future__ import annotations

from textwrap import wrap

from rich.box import SIMPLE_HEAD
from rich.console import Console, ConsoleOptions, Group, RenderableType, RenderResult
from rich.table import Table as RichTable
from rich.text import Text

from .view import COLOURS, Answers, Item, Note, Part, Table, View

_INDENT = 14
_GAP = "   "  #: between words, detail and setting, and before those below the words
_NARROWEST = 40
_WHOLE_WORD = 24  #: words up to this length are never cut


def terminal(view: View) -> RenderableType:
    """A view as rich prints it; no name in it is read as markup."""
    return Group(*map(_in_terminal, view))


def _in_terminal(part: Part) -> RenderableType:
    if isinstance(part, Note):
        return Text(part.text, part.style)
    return _AnswerLines(part) if isinstance(part, Answers) else _table(part)


def _table(table: Table) -> RichTable:
    """A table without rules; words break into lines at blanks, numbers never."""
    rich_table = RichTable(
        title=Text(table.title, "bold") if table.title else None,
        title_justify="left",
        title_style="",
        box=SIMPLE_HEAD,
        padding=(0, 1, 0, 0),
    )
    cells = table.cells
    columns = [i for i in range(len(table.headings)) if i not in table.wide]
    for i in columns:
        is_words = i in table.words
        words = " ".join((table.headings[i], *(row[i] for row in cells))).split()
        rich_table.add_column(
            table.headings[i],
            justify="left" if is_words else "right",
            no_wrap=not is_words or i in table.whole,
            min_width=min(_WHOLE_WORD, max(map(len, words), default=1)) if is_words else None,
        )
    for row in cells:
        rich_table.add_row(*(Text(row[i], COLOURS.get(row[i], "")) for i in columns))
    return rich_table


class _AnswerLines:
    """Headings on the left, their answers next to them."""

    def __init__(self, answers: Answers) -> None:
        self._sections = answers.sections

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        for heading, items in self._sections.items():
            title = Text(heading.ljust(_INDENT), "bold" if heading[0].isupper() else "")
            for item in items:
                lines = _item_lines(item, max(options.max_width, _NARROWEST) - _INDENT)
                yield title + Text(f"\n{' ' * _INDENT}".join(lines))
                title = Text(" " * _INDENT)


def _item_lines(item: Item, width: int) -> list[str]:
    """An item in one line, or its words above its detail and setting."""
    words, *more = filter(None, item)
    line = _GAP.join((words, *more))
    if len(line) <= width:
        return [line]
    lines = []
    for text, start in ((words, ""), (_GAP.join(more), _GAP)):
        lines += wrap(
            text,
            width,
            initial_indent=start,
            subsequent_indent=start,
            break_long_words=False,
            break_on_hyphens=False,
        )
    return lines
