"""Definition of a table: named columns of fixed type, nullability, unit and meaning, and the sort keys of its rows."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import pyarrow as pa

SIDES = ("real", "sim")
#: The sides as people call them.
SIDE_NAMES = {"real": "real", "sim": "simulated"}
#: The farthest that a range or a motion may reach: squares, sums and single precision hold it with room to spare.
FARTHEST_M = 1e9
#: A row of a table by column; the schema of the table has names and types.
Row = dict[str, Any]


@dataclass(frozen=True)
class Table:
    """One table: its name, its columns, and the columns by which its rows are sorted.

    of_file : columns that are the same in all rows of a file: the pair, or the pair and the side
    """

    name: str
    schema: pa.Schema
    keys: tuple[str, ...]
    of_file: tuple[str, ...] = ()
    version: int = 1

    def check(self, table: pa.Table) -> pa.Table:
        """Return the table unchanged after checking names, types and nullability.

        Raises
        ------
        ValueError
            A column is missing, surplus, of another type, or has or allows a null that the schema
            forbids.
        """
        if table.schema != self.schema:
            expected, got = _names_and_types(self.schema), _names_and_types(table.schema)
            raise ValueError(f"table {self.name}: expected columns {expected}, got {got}")
        for name in self._without_nulls:
            if n_null := table.column(name).null_count:
                raise ValueError(
                    f"table {self.name}, column {name}: expected no nulls, got {n_null}"
                )
        return table

    @cached_property
    def _without_nulls(self) -> list[str]:
        return [field.name for field in self.schema if not field.nullable]

    @cached_property
    def _fields(self) -> list[pa.Field]:
        return list(self.schema)

    def build(self, columns: Mapping[str, Any]) -> pa.Table:
        """Build a checked table from arrays; a single string, number or None fills its column.

        Absent columns are null, and so is NaN where the schema allows it.
        """
        n_rows = next(len(value) for value in columns.values() if _is_column(value))
        arrays = []
        for field in self._fields:
            value = columns.get(field.name)
            if _is_column(value):
                arrays.append(pa.array(value, type=field.type, from_pandas=field.nullable))
            else:
                arrays.append(pa.repeat(pa.scalar(value, type=field.type), n_rows))
        return self.check(pa.Table.from_arrays(arrays, schema=self.schema))

    def from_rows(self, rows: Iterable[Row]) -> pa.Table:
        """Build a checked table from dictionaries, sorted by the table's keys (nulls last); absent values are null."""
        table = pa.Table.from_pylist(list(rows), schema=self.schema)
        if len(table) > 1:
            table = table.sort_by([(key, "ascending") for key in self.keys])
        return self.check(table)


def _names_and_types(schema: pa.Schema) -> str:
    return ", ".join(f"{field.name} {field.type}" for field in schema)


def _is_column(value: Any) -> bool:
    return hasattr(value, "__len__") and not isinstance(value, str)


def column(
    name: str,
    kind: pa.DataType,
    meaning: str,
    unit: str = "",
    optional: bool = False,
) -> pa.Field:
    """Column with its meaning, and its unit if it has one."""
    metadata = {"meaning": meaning}
    if unit:
        metadata["unit"] = unit
    return pa.field(name, kind, nullable=optional, metadata=metadata)
