"""Comma-separated `.csv` with a header line; read by pandas."""

from __future__ import annotations

from pathlib import Path

from ....schemas.errors import ScanError
from .scan import Scan, scan_from_columns


def read(path: Path) -> Scan:
    """The scan in a `.csv` file with columns x, y, z and perhaps intensity and label; an empty cell becomes NaN.

    Raises
    ------
    ScanError
        It is no table, a column is missing, or a coordinate is no number.
    """
    import pandas as pd

    try:
        frame = pd.read_csv(path, skipinitialspace=True)
    except (ValueError, UnicodeDecodeError) as error:  # pandas' parser errors are ValueErrors
        raise ScanError(f"{path}: not a CSV table ({str(error).strip()})") from error
    return scan_from_columns(path, {str(name).strip(): frame[name].to_numpy() for name in frame.columns})
