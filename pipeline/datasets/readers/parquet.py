"""Apache `.parquet` with columns x, y, z and perhaps intensity and label; read by pyarrow."""

from __future__ import annotations

from pathlib import Path

from .scan import Scan, refused_unless, scan_from_columns


def read(path: Path) -> Scan:
    """The scan in a Parquet file; null becomes NaN.

    Raises
    ------
    ScanError
        The file is not whole, a column is missing, or a coordinate is no number.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    with refused_unless(path, "a whole Parquet file", pa.ArrowException):
        table = pq.ParquetFile(path).read()
    return scan_from_columns(path, {name: table.column(name).to_numpy() for name in table.column_names})
