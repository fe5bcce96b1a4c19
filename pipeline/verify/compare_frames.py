"""Comparison of stored tables with recomputed ones, with one rule per column, and the tally of its results."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pandas as pd

from ...schemas.columns import Row
from ...schemas.data_files import read_data
from ...schemas.tables import TABLES
from ...stages.arrays import BoolArray, FloatArray

#: Tolerance of every number without a rule: metres, shares, eigenvalues. Counts and ids are exact all the same.
DEFAULT_TOLERANCE = 1e-9
_RELATIVE = 1e-12
_RULES = read_data("verification")
#: Columns and tables that are not recomputed, and why.
NOT_COMPARED: dict[str, str] = _RULES["not_compared"]
#: Table of the values of checks with another name.
TABLE_OF = {"scan": "ground"}
#: Mismatches listed per table.
MAX_LISTED = 5


@dataclass(frozen=True)
class ColumnComparison:
    """Stored and recomputed values of one column.

    rows : keys of the values
    difference : (n,) float64, absolute; 0 for text, and if one value is null
    is_wrong : (n,) True if the values differ by more than the tolerance
    """

    column: str
    rows: pd.Index[Any]
    stored: Any
    recomputed: Any
    difference: FloatArray
    is_wrong: BoolArray


def compare(
    table: str, stored: pd.DataFrame, recomputed: pd.DataFrame, *, is_whole: bool = True
) -> Iterator[ColumnComparison]:
    """Compare the rows of two frames by their index, then each recomputed column; null equals null.

    Parameters
    ----------
    table : name for the rules
    stored, recomputed : frames with the same keys as index
    is_whole : the stored frame must have the recomputed rows and no others; otherwise at least these
    """
    if not stored.index.equals(recomputed.index):
        is_twice = stored.index.duplicated()
        is_surplus = (is_twice | ~stored.index.isin(recomputed.index)) & is_whole
        is_missing = ~recomputed.index.isin(stored.index)
        for rows, a, b in (
            (stored.index[is_surplus], "present", "absent"),
            (recomputed.index[is_missing], "absent", "present"),
        ):
            if n := len(rows):
                yield ColumnComparison("row", rows, [a] * n, [b] * n, np.zeros(n), np.ones(n, dtype=np.bool_))
        recomputed = recomputed[~is_missing]
        stored = stored[~is_twice].reindex(recomputed.index)
    for name in stored.index.names if is_whole else ():
        if name is not None:  # equal, as the rows are
            key = recomputed.index.get_level_values(str(name)).to_numpy()
            nowhere = np.zeros(len(key))
            yield ColumnComparison(str(name), recomputed.index, key, key, nowhere, nowhere.astype(np.bool_))
    for column in recomputed.columns:
        name = f"{table}.{column}"
        assert name not in NOT_COMPARED, f"{name} is recomputed though a rule says it is not"
        tolerance = _RULES["tolerance"].get(name, DEFAULT_TOLERANCE)
        a, b = _values(stored[column]), _values(recomputed[column])
        if object in (a.dtype, b.dtype):
            is_wrong = np.array([x != y for x, y in zip(a.tolist(), b.tolist(), strict=True)], dtype=np.bool_)
            difference = np.zeros(len(a))
        else:
            difference = np.abs(a - b)
            is_wrong = ~np.isclose(a, b, rtol=_RELATIVE if tolerance else 0.0, atol=tolerance, equal_nan=True)
        yield ColumnComparison(column, recomputed.index, a, b, np.nan_to_num(difference), is_wrong)


def _values(column: pd.Series[Any]) -> Any:
    """Numbers as float64 with NaN for null; text as objects with None for null."""
    if pd.api.types.is_numeric_dtype(column.dtype):  # flags too
        return column.to_numpy(dtype=np.float64)
    values = column.to_numpy(dtype=object, copy=True)
    values[pd.isna(values)] = None
    return values if any(isinstance(value, str) for value in values) else values.astype(np.float64)


@dataclass(frozen=True)
class Mismatch:
    """A stored value that differs from the recomputed one."""

    table: str
    pair_id: str
    side: str
    object: str
    column: str
    stored: str
    recomputed: str


@dataclass
class TableCheck:
    """The comparisons of one table.

    columns : columns with at least one compared value
    largest : largest absolute difference; 0 if all are equal
    where : pair, row and column of the largest difference
    n_wrong : values that differ by more than rounding allows
    """

    table: str
    what: str
    columns: tuple[str, ...] = ()
    n_numbers: int = 0
    largest: float = 0.0
    where: str = ""
    n_wrong: int = 0


@dataclass
class Tally:
    """Results of all comparisons of a run.

    compared, excused : columns (`table.column`) with compared values; columns or tables that need no comparison
    skipped : reasons why something is not recomputed
    n_rows : by table, of whole tables and of drawn objects; a table without any of either kind cannot be compared
    """

    checks: dict[str, TableCheck] = field(default_factory=dict)
    mismatches: dict[str, list[Mismatch]] = field(default_factory=dict)
    skipped: Counter[str] = field(default_factory=Counter)
    compared: set[str] = field(default_factory=set)
    excused: set[str] = field(default_factory=lambda: {*NOT_COMPARED})
    n_rows: Counter[tuple[str, bool]] = field(default_factory=Counter)
    is_damaged: bool = False

    def compare(
        self,
        table: str,
        stored: pd.DataFrame,
        recomputed: pd.DataFrame,
        *,
        pair_id: str = "",
        side: str = "",
        is_whole: bool = True,
    ) -> None:
        """Compare rows of a table; see `compare`."""
        name, check = TABLE_OF.get(table, table), self.check(table)
        self.n_rows[name, is_whole] += len(recomputed)
        for own in compare(name, stored, recomputed, is_whole=is_whole):
            check.n_numbers += len(own.rows)
            check.n_wrong += int(own.is_wrong.sum())
            if not len(own.rows):
                continue
            self.compared.add(own.column if "." in own.column else f"{name}.{own.column}")
            i = int(own.difference.argmax())
            if own.difference[i] > check.largest:
                words = (f"pair {pair_id}" if pair_id else "", _object(own.rows, i, side) or side, own.column)
                check.largest, check.where = float(own.difference[i]), ", ".join(filter(None, words))
            for i in np.flatnonzero(own.is_wrong)[:MAX_LISTED].tolist():
                values = _word(own.stored[i]), _word(own.recomputed[i])
                self._list(Mismatch(table, pair_id, side, _object(own.rows, i, side), own.column, *values))

    def compare_values(
        self, table: str, stored: Row, recomputed: Row, *, pair_id: str = "", side: str = "", **keys: Any
    ) -> None:
        """Compare single values by name, such as metadata of a job; `keys` identify the owner."""
        index = pd.MultiIndex.from_arrays([[key] for key in keys.values()], names=list(keys)) if keys else None
        a, b = (pd.DataFrame([row], index=index, columns=list(recomputed)) for row in (stored, recomputed))
        self.compare(table, a, b, pair_id=pair_id, side=side, is_whole=False)

    def skip(self, why: str, *columns: str) -> None:
        """Note why something is not recomputed; its columns (`table.column`) or tables need no comparison."""
        self.skipped.update([why] if why else [])
        self.excused.update(columns)

    def check(self, table: str) -> TableCheck:
        """Result of a table, created if necessary."""
        return self.checks.setdefault(table, TableCheck(table, _RULES["compared"][table]))

    def reject(self, table: str, pair_id: str, why: str) -> None:
        """Count an unusable table as a mismatch."""
        self.is_damaged = True
        self.check(table).n_wrong += 1
        self._list(Mismatch(table, pair_id, "", "", "the table", "is unusable", why))

    def unknown(self, tables: Iterable[str]) -> Iterator[str]:
        """Columns that were not compared without a declared reason; empty if a table is damaged."""
        without_rows = {table for (table, _), n in self.n_rows.items() if not n}
        for table in tables:
            if not (self.is_damaged or table in self.excused | without_rows):
                columns = (f"{table}.{name}" for name in TABLES[table].schema.names)
                yield from (name for name in columns if name not in self.compared | self.excused)

    def results(self) -> tuple[tuple[TableCheck, ...], tuple[Mismatch, ...]]:
        """Checks with their compared columns, and the listed mismatches, in the order of the report."""
        checks = [self.checks[table] for table in _RULES["compared"] if table in self.checks]
        for check in checks:
            names = TABLES[check.table].schema.names if check.table in TABLES else []
            check.columns = tuple(name for name in names if f"{check.table}.{name}" in self.compared)
        return tuple(checks), tuple(own for check in checks for own in self.mismatches.get(check.table, ()))

    def _list(self, mismatch: Mismatch) -> None:
        listed = self.mismatches.setdefault(mismatch.table, [])
        if len(listed) < MAX_LISTED:
            listed.append(mismatch)


def _object(rows: pd.Index[Any], i: int, side: str) -> str:
    """Text of the keys of a row, such as "real 3, sim 5" or "point 12"; "" for single values and whole sides."""
    key = rows[i] if isinstance(rows, pd.MultiIndex) else (rows[i],)
    named = {str(name): value for name, value in zip(rows.names, key, strict=True) if name is not None and value != -1}
    side = named.pop("side", side) if len(named) > 1 else side
    of_side = {"community_id": side}
    return ", ".join(f"{of_side.get(name, name.removesuffix('_id'))} {value}" for name, value in named.items())


def _word(value: object) -> str:
    """Text of a value with all its digits."""
    if isinstance(value, float | np.floating):
        return "null" if np.isnan(value) else repr(float(value))
    return "null" if value is None else str(value)
