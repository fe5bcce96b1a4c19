"""All tables that fidpipe writes: columns, types, nullability, units, keys and versions.

This is the contract with all readers of our Parquet files. `Table.check` is called before a table is written and after
it is read; the metadata of a field has the unit and meaning of the column.

The tables are the rows of `tables.csv` next to this file: one per column, in the order of the file, with the rank of
the column among those that the rows of the table are sorted by (`key`), and "yes" if it may be null. A column of type
`score` is one of the catalogue (`metrics.csv`), or a group of it: all of its columns. Those of the group `object` may
also be of type `mean` or `mean and deviation` (over `meaning`), or `object score` (with another meaning). A `constant`
is a string that is the same in all rows of a file.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import chain, groupby
from operator import itemgetter

import pyarrow as pa

from .columns import Table, column
from .data_files import read_rows
from .metric_catalogue import METRIC, OBJECT_METRICS


def _columns(row: dict[str, str]) -> Iterator[pa.Field]:
    """The columns of a row of `tables.csv`."""
    name = row["column"]
    kind = row["type"]
    meaning = row["meaning"]
    optional = row["null"] == "yes"
    if kind == "score":
        for metric in METRIC.values():
            if name in (metric.column, metric.group):
                is_nullable = optional and "required" not in metric.flags
                number = pa.int32() if "count" in metric.flags else pa.float64()
                unit = metric.unit or ""
                yield column(metric.column, number, metric.meaning, unit, is_nullable)
    elif kind == "object score":
        for score in OBJECT_METRICS:
            yield column(score, pa.float64(), meaning, optional=optional)
    elif kind.startswith("mean"):
        for score in OBJECT_METRICS:
            words = f"mean of {score} over {meaning}"
            yield column(f"{score}_mean", pa.float64(), words, optional=optional)
            if kind == "mean and deviation":
                words = f"standard deviation (n - 1) of {score} over {meaning}"
                yield column(f"{score}_std", pa.float64(), words, optional=optional)
    else:
        arrow_type = pa.type_for_alias(kind.replace("constant", "string"))
        yield column(name, arrow_type, meaning, row["unit"], optional)


def _read_tables() -> Iterator[Table]:
    for name, group in groupby(read_rows("tables"), itemgetter("table")):
        rows = list(group)
        keys = sorted((int(row["key"]), row["column"]) for row in rows if row["key"])
        fields = chain.from_iterable(map(_columns, rows))
        of_file = tuple(row["column"] for row in rows if row["type"] == "constant")
        yield Table(name, pa.schema(fields), tuple(key for _, key in keys), of_file)


#: All tables by name; the name is also the folder or file in a run.
TABLES = {table.name: table for table in _read_tables()}
#: Names of the tables with a file per pair, or per side of a pair.
PAIR_TABLES = tuple(name for name, table in TABLES.items() if table.of_file)
