"""What a table is: named columns of fixed type, nullability, unit and meaning, and the columns that sort its rows."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from itertools import islice
from typing import Any

import numpy as np
import pyarrow as pa

from .metrics import OBJECT_METRICS, Metric

SIDES = ("real", "sim")
#: A row of a table, by column; the table says which columns there are and of which type.
Row = dict[str, Any]
_ROWS_AT_ONCE = 5000

STRING, INT32, FLOAT64, BOOL = pa.string(), pa.int32(), pa.float64(), pa.bool_()
#: Strings that are the same in all rows of a file: in memory a dictionary, in Parquet plain strings.
CONSTANT = pa.dictionary(INT32, STRING)


@dataclass(frozen=True)
class Table:
    """One table: its name, its columns, and the columns by which its rows are sorted."""

    name: str
    schema: pa.Schema
    keys: tuple[str, ...]
    version: int = 1

    def check(self, table: pa.Table) -> pa.Table:
        """The table itself, if names, types and nullability are as agreed.

        Raises
        ------
        ValueError
            A column is missing, surplus, of another type, or has a null that the schema forbids.
        """
        if table.schema.names != self.schema.names:
            raise ValueError(f"table {self.name}: columns {table.schema.names} found, {self.schema.names} wanted")
        for field in self.schema:
            column = table.column(field.name)
            if column.type != field.type and not (field.type == CONSTANT and column.type == pa.string()):
                raise ValueError(f"table {self.name}, column {field.name}: {column.type} found, {field.type} wanted")
            if not field.nullable and column.null_count:
                raise ValueError(
                    f"table {self.name}, column {field.name}: {column.null_count} nulls found, none allowed"
                )
        return table

    def build(self, columns: Mapping[str, Any], n_rows: int | None = None) -> pa.Table:
        """A checked table from arrays; a single string, number or None fills its column for `n_rows` rows."""
        if n_rows is None:
            n_rows = next(len(value) for value in columns.values() if _is_column(value))
        arrays = []
        for field in self.schema:
            value = columns[field.name]
            if _is_column(value):
                arrays.append(pa.array(value, type=field.type, from_pandas=False))
            elif field.type == CONSTANT:
                arrays.append(pa.DictionaryArray.from_arrays(np.zeros(n_rows, dtype=np.int32), pa.array([value])))
            else:
                arrays.append(pa.repeat(pa.scalar(value, type=field.type), n_rows))
        return self.check(pa.Table.from_arrays(arrays, schema=self.schema))

    @property
    def same(self) -> list[str]:
        """The columns that are dictionaries in memory."""
        return [field.name for field in self.schema if field.type == CONSTANT]

    def plain(self, table: pa.Table) -> pa.Table:
        """The table with plain strings in place of dictionaries."""
        plain = [field.with_type(pa.string()) if field.type == CONSTANT else field for field in table.schema]
        return table.cast(pa.schema(plain))

    def from_rows(self, rows: Iterable[Row]) -> pa.Table:
        """A checked table from dictionaries, sorted by the table's keys (nulls last); absent values are null."""
        left = iter(rows)
        parts = [self.schema.empty_table()]
        while part := list(islice(left, _ROWS_AT_ONCE)):  # dictionaries are large; there may be very many
            parts.append(pa.Table.from_pylist(part, schema=self.schema))
        table = pa.concat_tables(parts)
        return self.check(table.sort_by([(key, "ascending") for key in self.keys]))


def _is_column(value: Any) -> bool:
    return hasattr(value, "__len__") and not isinstance(value, str)


def column(name: str, kind: pa.DataType, meaning: str, unit: str = "", optional: bool = False) -> pa.Field:
    """A column with its meaning, and its unit if it has one."""
    metadata = {"meaning": meaning}
    if unit:
        metadata["unit"] = unit
    return pa.field(name, kind, nullable=optional, metadata=metadata)


def table(name: str, keys: tuple[str, ...], *columns: pa.Field) -> Table:
    """A table of some columns, whose rows are sorted by `keys`."""
    return Table(name, pa.schema(columns), keys)


def mean_columns(of: str) -> list[pa.Field]:
    """The means of all object scores."""
    return [column(f"{name}_mean", FLOAT64, f"mean of {name} over {of}", optional=True) for name in OBJECT_METRICS]


def score_column(metric: Metric, *, optional: bool | None = None) -> pa.Field:
    """The column of a score, as the catalogue describes it; `optional` where a table sees that otherwise."""
    kind = INT32 if metric.is_count else FLOAT64
    is_nullable = metric.is_nullable if optional is None else optional
    return column(metric.column, kind, metric.meaning, metric.unit or "", is_nullable)


PAIR = column("pair_id", CONSTANT, "name of the scan pair")
SIDE = column("side", CONSTANT, "real or sim")
POINT = column("point_id", INT32, "row of the point in its input file, from 0")
COMMUNITY = column("community_id", INT32, "object of this side; 0 is the largest, -1 no object (communities.leave_out)")
LABEL = column("label", STRING, "semantic class, where the input has labels", optional=True)
