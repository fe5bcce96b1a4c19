"""Views as plain data: lists of lines and tables, which `render` renders for each medium."""

from __future__ import annotations

import math
from collections.abc import Container, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

#: Colours of verdicts.
COLOURS = {
    **dict.fromkeys(("worse", "mixed", "vanished", "FAIL"), "red"),
    **dict.fromkeys(("better", "appeared", "pass", "yes"), "green"),
    "undecided": "yellow",
}


@dataclass(frozen=True)
class Note:
    """A line of text.

    style : "bold" for the heading of a view, a colour such as "yellow" for a warning, as rich names
        them
    """

    text: str
    style: str = ""


@dataclass(frozen=True)
class Table:
    """A table of words and numbers; None is shown as a dash.

    words : indices of the columns that hold words, which may break into lines; the others hold
        numbers
    digits : of its floats
    wide : indices of columns that a terminal has no room for
    whole : indices of columns of words that never break into lines
    links : what the first cell of each row leads to on a page; "" for nothing
    """

    title: str
    headings: Sequence[str]
    rows: Sequence[Sequence[object]]
    words: Container[int] = (0,)
    digits: int = 3
    wide: Container[int] = ()
    whole: Container[int] = ()
    links: Sequence[str] = ()

    @property
    def cells(self) -> list[list[str]]:
        """The rows as text."""
        cells = []
        for row in self.rows:
            cells.append([_text(value, self.digits) for value in row])
        return cells


#: An answer as text, a detail and a setting, which may be empty.
Item = tuple[str, str, str]


@dataclass(frozen=True)
class Answers:
    """Answers by their heading; those without answers are not shown."""

    sections: Mapping[str, Sequence[Item]]


def items_of(*texts: str) -> list[Item]:
    """Answers without details and settings; empty texts are left out."""
    return [(text, "", "") for text in texts if text]


Part = Note | Table | Answers
View = Sequence[Part]


def warnings(texts: Iterable[str]) -> list[Note]:
    """Remarks that qualify what a view shows."""
    return [Note(f"note: {text}", "yellow") for text in texts]


def columns_of(rows: Iterable[Mapping[str, Any]], names: Sequence[str]) -> list[list[Any]]:
    """Rows of a table: the values of these columns."""
    cells = []
    for row in rows:
        cells.append([row[name] for name in names])
    return cells


def first_of(lines: Sequence[str], most: int, more: str) -> list[str]:
    """At most so many lines; the number of the others is inserted into the last one.

    Examples
    --------
    >>> first_of(["a", "b", "c"], 1, "{} more")
    ['a', '2 more']
    """
    if len(lines) <= most:
        return list(lines)
    return [*lines[:most], more.format(len(lines) - most)]


def number(value: float | None, digits: int = 3) -> str:
    """A number with the given decimals; a dash if absent."""
    return "-" if value is None or math.isnan(value) else f"{value:.{digits}f}"


def signed(value: float | None) -> str:
    """A difference with its sign."""
    return "-" if value is None else f"{value:+.3f}"


def percent(value: float | None) -> str:
    """A share in per cent."""
    return "-" if value is None else f"{100 * value:.0f} %"


def count(n: int, noun: str) -> str:
    """A number with its noun.

    Examples
    --------
    >>> count(1, "pair"), count(5, "independent place")
    ('1 pair', '5 independent places')
    """
    return f"{n} {noun}" if n == 1 else f"{n} {noun}s"


def shortened(names: Iterable[str], width: int) -> dict[str, str]:
    """Each name in at most `width` characters with an ellipsis in the middle.

    Names stay longer where two would become the same. Of a long name more of the end is kept, which
    has the numbers of scans.

    Examples
    --------
    >>> names = ["n008__LIDAR_TOP__1533151603597909", "n008__LIDAR_TOP__1533151603647909"]
    >>> list(shortened(names, 12).values())
    ['n00…03597909', 'n00…03647909']
    """
    names = list(names)
    for length in range(width, max(map(len, names), default=0)):
        n_head = (length - 1) * 3 // 11
        short = {}
        for name in names:
            is_long = len(name) > length
            tail = name[n_head + 1 - length :]
            short[name] = f"{name[:n_head]}…{tail}" if is_long else name
        if len(set(short.values())) == len(short):
            return short
    return {name: name for name in names}


def _text(value: object, digits: int) -> str:
    return number(value, digits) if value is None or isinstance(value, float) else str(value)
