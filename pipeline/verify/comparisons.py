"""Compares stored numbers with recomputed ones, and keeps what is to be said of it, and of which columns nothing is."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ...schemas.tables import TABLES
from ...stages.arrays import IndexArray, IntArray

#: What rounding allows; lengths in metres also stand for shares and shapes, which are about 1.
LENGTH_M = 1e-9
SPECTRUM = 1e-9
#: Influence is rounded to 1e-9: two roundings may be one step apart.
INFLUENCE = 1.5e-9
#: Louvain's method computes in single precision.
MODULARITY = 1e-5
#: What two ways to an influence may differ by, absolute and relative.
ROUNDING = 1e-11
_RELATIVE = 1e-12
_MOST_SHOWN = 5

#: What is compared of each table, for people.
WORDS = {
    "files": "content as it was written (SHA-256)",
    "rows": "names of pair and side, order by keys, none twice",
    "scan": "points kept of the scan, and where they lie",
    "ground": "cut, heights, flags of all points",
    "sensor": "the scan, described again by the same code",
    "graph": "all edge lengths; all edges of drawn nodes",
    "communities": "Louvain again; numbering; reference: nearest real points",
    "objects": "sizes; place and shape of drawn objects",
    "matching": "which objects match, and how far apart",
    "coverage": "drawn objects, from all distances",
    "surface": "displacement of drawn objects",
    "pieces": "counts, shares and moves of all pieces",
    "selection": "influence, nodes kept, optimal alignment",
    "metrics": "scores from dense matrices",
    "baselines": "distances of others",
    "seeds": "row of the set seed",
    "pairs": "counts, cuts, means, deviations, medians",
    "run.json": "means and deviations over pairs",
}
#: The columns that nothing is compared with, and why; every other column of every table is recomputed.
NOT_COMPARED = {
    "baselines.reason": "words for people",
    "pairs.reason": "why a pair failed: it is not tried again",
    "timings": "seconds of a clock",
}
#: Tables of which the rows of the drawn objects alone are compared as a whole.
_OF_OBJECTS = ("objects", "coverage", "surface", "pieces", "selection", "metrics", "baselines")
#: The table that a number stands in, where what is compared of it has a name of its own.
_TABLE_OF = {"scan": "ground"}


@dataclass(frozen=True)
class Place:
    """Where a number stands."""

    table: str
    pair_id: str
    side: str = ""
    object: str = ""


@dataclass(frozen=True)
class Mismatch:
    """A number that is not what the tables before it give."""

    table: str
    pair_id: str
    side: str
    object: str
    column: str
    stored: str
    recomputed: str


@dataclass(frozen=True)
class TableCheck:
    """What was compared of one table.

    largest : largest absolute difference; 0 where all are equal
    where : the column and the place of it
    n_wrong : numbers that do not agree within what rounding allows
    columns : of which at least one value was compared
    """

    table: str
    what: str
    columns: tuple[str, ...]
    n_numbers: int
    largest: float
    where: str
    n_wrong: int


@dataclass
class _Tally:
    n_numbers: int = 0
    largest: float = 0.0
    where: str = ""
    mismatches: list[Mismatch] = field(default_factory=list)
    n_wrong: int = 0
    n_of_objects: int = 0


class Comparisons:
    """Compares numbers, and keeps what is to be said of it."""

    def __init__(self) -> None:
        self._tallies: dict[str, _Tally] = {}
        self._left_out: dict[str, int] = {}
        self._compared: set[str] = set()
        self._excused: set[str] = set()

    def compare(
        self,
        place: Place,
        column: str,
        stored: Any,
        recomputed: Any,
        *,
        tolerance: float = 0.0,
        rows: Sequence[object] | None = None,
        covers: Sequence[str] = (),
    ) -> None:
        """Compares one value or an array of them: numbers, words or truth values; None and NaN are alike.

        Parameters
        ----------
        tolerance : absolute, to which a relative one of 1e-12 is added; 0 wants exactly equal values
        rows : names of the rows of an array
        covers : columns that are compared by it, as `table.column`, where it is not the one of this name
        """
        a, b = _values(stored), _values(recomputed)
        tally = self._tallies.setdefault(place.table, _Tally())
        tally.n_of_objects += bool(place.object)
        self._compared.update(covers or [f"{_TABLE_OF.get(place.table, place.table)}.{column}"])
        if a.shape != b.shape:
            self._note(tally, place, f"number of rows of {column}", len(a), len(b))
            return
        tally.n_numbers += len(a)
        if object in (a.dtype, b.dtype):
            wrong = np.array([x != y for x, y in zip(a, b, strict=True)], dtype=np.bool_)
        else:
            apart = np.abs(a - b)
            is_null = np.isnan(a) & np.isnan(b)
            wrong = ~(is_null | (apart <= (tolerance + _RELATIVE * np.abs(b) if tolerance else 0.0)))
            known = np.where(np.isnan(apart), 0.0, apart)
            if len(known) and known.max() > tally.largest:
                tally.largest = float(known.max())
                tally.where = _where(place, column, rows, int(known.argmax()))
        for i in np.flatnonzero(wrong).tolist():
            name = column if rows is None else f"{column} of {rows[i]}"
            self._note(tally, place, name, a[i], b[i])

    def refuse(self, place: Place, why: str, columns: Collection[str] = ()) -> None:
        """Notes that a table is not one that anything can be computed from."""
        self._note(self._tallies.setdefault(place.table, _Tally()), place, "the table", "cannot be computed with", why)
        self.excuse([_TABLE_OF.get(place.table, place.table), *columns])

    def leave_out(self, what: str, columns: Collection[str] = ()) -> None:
        """Notes what was not compared, and for which columns, `table.column` or `table`, that is the reason."""
        self._left_out[what] = self._left_out.get(what, 0) + 1
        self.excuse(columns)

    def excuse(self, columns: Collection[str]) -> None:
        """Notes columns, `table.column` or `table`, that are not compared for a reason that is told elsewhere."""
        self._excused.update(columns)

    def unknown(self, table: str, columns: Sequence[str]) -> list[str]:
        """Of the columns of a table those that nothing was compared with, though nothing says why.

        Where no object of the table was drawn, all are excused.
        """
        excused = NOT_COMPARED.keys() | self._excused
        names = {f"{table}.{column}": column for column in columns}
        left = [own for name, own in names.items() if name not in self._compared | excused]
        if table in excused or (left and self._has_no_object(table)):
            return []
        return left

    def _has_no_object(self, table: str) -> bool:
        """Whether a table of objects is told of, and none of its objects was drawn."""
        tally = self._tallies.get(table)
        return table in _OF_OBJECTS and tally is not None and not tally.n_of_objects

    @property
    def tables(self) -> tuple[TableCheck, ...]:
        """What was compared, by table, in the order of the stages."""
        order = [name for name in WORDS if name in self._tallies]
        return tuple(
            TableCheck(name, WORDS[name], self._columns(name), own.n_numbers, own.largest, own.where, own.n_wrong)
            for name, own in ((name, self._tallies[name]) for name in order)
        )

    @property
    def mismatches(self) -> tuple[Mismatch, ...]:
        """Of each table the first few that do not agree."""
        return tuple(mismatch for name in WORDS if name in self._tallies for mismatch in self._tallies[name].mismatches)

    @property
    def not_compared(self) -> list[str]:
        """What was left out, in words, and how often."""
        return [f"{what}: {n} times" if n > 1 else what for what, n in self._left_out.items()]

    def _columns(self, table: str) -> tuple[str, ...]:
        """The columns of a table of which values were compared, in its order."""
        names = TABLES[table].schema.names if table in TABLES else []
        return tuple(name for name in names if f"{table}.{name}" in self._compared)

    def _note(self, tally: _Tally, place: Place, column: str, stored: object, recomputed: object) -> None:
        tally.n_wrong += 1
        if len(tally.mismatches) < _MOST_SHOWN:
            own = (place.table, place.pair_id, place.side, place.object, column, _word(stored), _word(recomputed))
            tally.mismatches.append(Mismatch(*own))


def point_names(point_ids: Sequence[int] | IntArray | IndexArray) -> Sequence[str]:
    """The names of the rows of some points, made when one is asked for."""
    return _PointNames(point_ids)


class _PointNames(Sequence[str]):
    def __init__(self, point_ids: Sequence[int] | IntArray | IndexArray) -> None:
        self._point_ids = point_ids

    def __len__(self) -> int:
        return len(self._point_ids)

    def __getitem__(self, i: Any) -> Any:
        return f"point {self._point_ids[i]}"


def _values(own: Any) -> np.ndarray[tuple[int], np.dtype[Any]]:
    """Numbers as float64, (n,), NaN for None; words as they are."""
    array = np.atleast_1d(np.asarray(own))
    if array.dtype.kind in "USO" and any(isinstance(value, str) for value in array.tolist()):
        return array.astype(object)
    return array.astype(np.float64)


def _where(place: Place, column: str, rows: Sequence[object] | None, i: int) -> str:
    """A number's place in words."""
    name = column if rows is None else f"{column} of {rows[i]}"
    words = [f"pair {place.pair_id}" if place.pair_id else "", place.object or place.side, name]
    return ", ".join(filter(None, words))


def _word(value: object) -> str:
    """A value with all its digits."""
    if isinstance(value, float | np.floating):
        return "null" if np.isnan(value) else repr(float(value))
    return "null" if value is None else str(value)
