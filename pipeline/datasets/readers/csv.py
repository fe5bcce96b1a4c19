"""Comma-separated `.csv` with a header line; read by pandas."""

from __future__ import annotations

from pathlib import Path

from ....schemas.errors import ScanError
from .scan import Scan, scan_from_columns

_LONGEST_HEADER_BYTES, _MOST_COLUMNS = 2**20, 1000  # a column costs pandas a thousand bytes, regardless of its content


def read(path: Path) -> Scan:
    """The scan in a `.csv` file with columns x, y, z and perhaps intensity and label; an empty cell becomes NaN.

    Raises
    ------
    ScanError
        The file is not a table, a column is missing, or a coordinate is not a number.
    """
    import pandas as pd

    with path.open("rb") as file:
        n_columns = file.readline(_LONGEST_HEADER_BYTES).count(b",") + 1
    if n_columns > _MOST_COLUMNS:
        raise ScanError(f"{path}: {n_columns} columns found, at most {_MOST_COLUMNS} are read")
    frame = pd.read_csv(path, skipinitialspace=True, low_memory=False)
    return scan_from_columns(path, {str(name).strip(): frame[name].to_numpy() for name in frame.columns})
