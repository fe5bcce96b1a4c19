"""Comma-separated `.csv` with a header line; read by pandas."""

from __future__ import annotations

from pathlib import Path

from .scan import Scan, refused_unless, scan_from_columns


def read(path: Path) -> Scan:
    """The scan in a `.csv` file with columns x, y, z and perhaps intensity and label; an empty cell becomes NaN.

    Raises
    ------
    ScanError
        It is no table, a column is missing, or a coordinate is no number.
    """
    import pandas as pd

    with refused_unless(path, "a CSV table", ValueError):  # pandas' parser errors are ValueErrors
        frame = pd.read_csv(path, skipinitialspace=True)
    return scan_from_columns(path, {str(name).strip(): frame[name].to_numpy() for name in frame.columns})
