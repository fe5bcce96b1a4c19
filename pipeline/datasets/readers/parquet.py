"""Apache `.parquet` with columns x, y, z and perhaps intensity and label; read by pyarrow."""

from __future__ import annotations

from pathlib import Path

from .scan import KNOWN_COLUMNS, Scan, check_names, scan_from_columns

_MOST_METADATA = 2**20  # names and lists in the footer


def read(path: Path) -> Scan:
    """The scan in a Parquet file; null becomes NaN. Other columns than those of a scan are not read.

    Raises
    ------
    ScanError
        The file is not whole, a column is missing, or a coordinate is not a number.
    """
    import pyarrow.parquet as pq

    limits = {
        "thrift_string_size_limit": _MOST_METADATA,
        "thrift_container_size_limit": _MOST_METADATA,
    }
    with path.open("rb") as stream:
        file = pq.ParquetFile(stream, pre_buffer=False, **limits)
        names = [field.name for field in file.schema_arrow]
        check_names(path, names)
        chosen = [name for name in names if name.lower() in KNOWN_COLUMNS]
        table = file.read(chosen, use_threads=False)
        columns = {name: table.column(name).to_numpy() for name in chosen}
    return scan_from_columns(path, columns)
