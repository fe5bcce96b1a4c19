"""Feather `.feather` (Apache Arrow), as Argoverse 2 writes its sweeps; read by pyarrow."""

from __future__ import annotations

from pathlib import Path

from .scan import KNOWN_COLUMNS, Scan, check_names, scan_from_columns


def read(path: Path) -> Scan:
    """The scan in a Feather file; null becomes NaN. Other columns than those of a scan are not read.

    Raises
    ------
    ScanError
        The file is not whole, a column is missing, or a coordinate is not a number.
    """
    import pyarrow as pa

    with path.open("rb") as stream:
        names = pa.ipc.open_file(stream).schema.names
        check_names(path, names)
        chosen = [i for i, name in enumerate(names) if name.lower() in KNOWN_COLUMNS]
        options = pa.ipc.IpcReadOptions(included_fields=chosen, use_threads=False)
        table = pa.ipc.open_file(stream, options=options).read_all()
        columns = {name: table.column(name).to_numpy() for name in table.column_names}
    return scan_from_columns(path, columns)
