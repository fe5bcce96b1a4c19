"""Apache `.parquet`, and Feather `.feather` as Argoverse 2 writes its sweeps; read by pyarrow."""

from __future__ import annotations

from pathlib import Path

from .scan import KNOWN_COLUMNS, Scan, check_names, scan_from_columns


def read(path: Path) -> Scan:
    """The scan in a file of named columns; null becomes NaN. Other columns than those of a scan are not read.

    Raises
    ------
    ScanError
        The file is not whole, a column is missing, or a coordinate is not a number.
    """
    from pyarrow import dataset

    file = dataset.dataset(path, format=path.suffix[1:].lower())
    check_names(path, file.schema.names)
    known = [name for name in file.schema.names if name.lower() in KNOWN_COLUMNS]
    table = file.to_table(known, use_threads=False)
    return scan_from_columns(path, {name: table.column(name).to_numpy() for name in known})
