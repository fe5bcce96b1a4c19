"""NumPy `.npy`: rows of x y z and perhaps intensity, or a structured array with named fields."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ....schemas.errors import ScanError
from .scan import Scan, scan_from_columns

_COLUMNS = ("x", "y", "z", "intensity")


def read(path: Path, columns: tuple[str, ...] = ()) -> Scan:
    """The scan in a `.npy` file; `columns` name those of an array that has as many.

    Raises
    ------
    ScanError
        The array is not whole, holds objects (pickles, which could run code), or has another shape.
    """
    # takes no memory, and rejects a file shorter than its array
    np.load(path, mmap_mode="r", allow_pickle=False)
    array = np.load(path, allow_pickle=False)
    if array.dtype.names:
        return scan_from_columns(path, {name: array[name] for name in array.dtype.names})
    names: tuple[str, ...] = _COLUMNS
    if array.ndim == 2 and array.shape[1] == len(columns):
        names = columns
    if (
        array.ndim != 2
        or not 3 <= array.shape[1] <= len(names)
        or array.dtype.kind not in "fiu"
    ):
        raise ScanError(
            f"{path}: expected numbers of shape (n, 3) or (n, 4), got a {array.dtype} array of "
            f"shape {array.shape}; save array.T if a column is a point, or name the columns in "
            "input.columns, or of one side alone in input.real_columns or input.sim_columns"
        )
    return scan_from_columns(path, dict(zip(names, array.T, strict=False)))
