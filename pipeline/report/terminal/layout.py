"""The look that all tables of the terminal share."""

from __future__ import annotations

from rich.box import SIMPLE_HEAD
from rich.table import Table
from rich.text import Text


def plain_table(title: str, *columns: str, words: int = 1) -> Table:
    """A table without rules; the first `words` columns hold words, the others numbers."""
    table = Table(
        title=Text(title, style="bold"),  # a Text, so that a name in it is never read as markup
        title_justify="left",
        title_style="",
        box=SIMPLE_HEAD,
        padding=(0, 1, 0, 0),
    )
    for i, column in enumerate(columns):
        table.add_column(column, justify="left" if i < words else "right", overflow="fold", no_wrap=i >= words)
    return table


def number(value: float | None, digits: int = 3) -> str:
    """A number as the terminal shows it; a dash where there is none."""
    return "-" if value is None else f"{value:.{digits}f}"


def percent(value: float | None) -> str:
    """A share as the terminal shows it."""
    return "-" if value is None else f"{100 * value:.0f} %"
