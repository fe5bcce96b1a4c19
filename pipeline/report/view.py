"""Views as plain data: a view is a list of lines and tables; `render` renders it for each medium."""

from __future__ import annotations

import math
from collections.abc import Container, Iterable, Mapping, Sequence
from dataclasses import dataclass, field

#: Least number of characters of a shortened name.
SHORTEST = 8


@dataclass(frozen=True)
class Note:
    """A line of text.

    style : "bold" for the heading of a view, a colour such as "yellow" for a warning, as rich names them
    """

    text: str
    style: str = ""


@dataclass(frozen=True)
class Table:
    """A table of words and numbers; None is shown as a dash.

    words : indices of the columns that hold words, which may break into lines; the others hold numbers
    digits : by index of a column, the digits of its floats; by default three
    wide : indices of columns that a terminal has no room for
    fixed : indices of the columns that never break into lines; None for all that hold numbers
    ruled : indices of rows that a line follows
    bold : indices of bold rows
    whole : indices of columns as wide as their longest word, which is not shortened
    """

    title: str
    headings: Sequence[str]
    rows: Sequence[Sequence[object]]
    words: Container[int] = (0,)
    digits: Mapping[int, int] = field(default_factory=dict)
    wide: Container[int] = ()
    fixed: Container[int] | None = None
    ruled: Container[int] = ()
    bold: Container[int] = ()
    whole: Container[int] = ()

    @property
    def cells(self) -> list[list[str]]:
        """The rows as text."""
        return [[_text(value, self.digits.get(i, 3)) for i, value in enumerate(row)] for row in self.rows]


@dataclass(frozen=True)
class Answers:
    """Headings with their answers as text, each with a detail and a setting, which may be empty."""

    sections: Sequence[tuple[str, Sequence[tuple[str, str, str]]]]


Part = Note | Table | Answers
View = Sequence[Part]


def number(value: float | None, digits: int = 3) -> str:
    """A number with the given decimals; a dash if absent."""
    return "-" if value is None or math.isnan(value) else f"{value:.{digits}f}"


def signed(value: float | None) -> str:
    """A difference with its sign."""
    return "-" if value is None else f"{value:+.3f}"


def percent(value: float | None) -> str:
    """A share in per cent."""
    return "-" if value is None else f"{100 * value:.0f} %"


def mean_and_spread(mean: float | None, std: float | None, digits: int = 3) -> str:
    """A mean with its standard deviation, each a dash if absent."""
    return f"{number(mean, digits)} ± {number(std, digits)}"


def shortened(names: Iterable[str], width: int) -> dict[str, str]:
    """Each name in at most `width` characters with an ellipsis in the middle; longer where two would become the same.

    Of a long name more of the end is kept, where the numbers of scans stand.

    Examples
    --------
    >>> list(shortened(["n008__LIDAR_TOP__1533151603597909", "n008__LIDAR_TOP__1533151603647909"], 12).values())
    ['n00…03597909', 'n00…03647909']
    """
    names = list(names)
    for own in range(max(width, SHORTEST), max(map(len, names), default=0) + 1):
        head = (own - 1) * 3 // 11
        short = {
            name: name if len(name) <= own else f"{name[:head]}…{name[len(name) - (own - 1 - head) :]}"
            for name in names
        }
        if len(set(short.values())) == len(short):
            return short
    return {name: name for name in names}


def sentence(text: str) -> str:
    """A line as a sentence; r_lambda and the like keep their names."""
    return f"{text if text.startswith('r_') else text[:1].upper() + text[1:]}{'' if text.endswith('.') else '.'}"


def _text(value: object, digits: int) -> str:
    return number(value, digits) if value is None or isinstance(value, float) else str(value)


def count(n: int, noun: str) -> str:
    """A number with its noun.

    Examples
    --------
    >>> count(1, "pair"), count(5, "independent place")
    ('1 pair', '5 independent places')
    """
    return f"{n} {noun}" if n == 1 else f"{n} {noun}s"
