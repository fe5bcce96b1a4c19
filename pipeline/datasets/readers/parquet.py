"""Apache `.parquet` with columns x, y, z and perhaps intensity and label; read by pyarrow."""

from __future__ import annotations

from pathlib import Path

from ....schemas.errors import ScanError
from .scan import Scan, scan_from_columns


def read(path: Path) -> Scan:
    """The scan in a Parquet file; null becomes NaN.

    Raises
    ------
    ScanError
        The file is not whole, a column is missing, or a coordinate is no number.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    try:
        table = pq.ParquetFile(path).read()
    except pa.ArrowException as error:
        raise ScanError(f"{path}: not a whole Parquet file ({error})") from error
    return scan_from_columns(path, {name: table.column(name).to_numpy() for name in table.column_names})
