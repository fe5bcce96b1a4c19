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
    np.load(
        path,
        mmap_mode="r",
        allow_pickle=False,
    )  # takes no memory, and rejects a file shorter than its array
    array = np.load(path, allow_pickle=False)
    if array.dtype.names:
        return scan_from_columns(path, {name: array[name] for name in array.dtype.names})
    if array.ndim != 2 or array.shape[1] < 3 or array.dtype.kind not in "fiu":
        raise ScanError(
            f"{path}: expected numbers of shape (n, 3) or (n, 4), got a {array.dtype} array of shape {array.shape}",
        )
    n_rows, n_columns = array.shape
    if n_columns == len(columns):
        return scan_from_columns(path, dict(zip(columns, array.T, strict=True)))
    if n_columns > 4 and n_rows in (3, 4):
        raise ScanError(
            f"{path}: expected one row per point, got an array of shape {array.shape}; save array.T",
        )
    if n_columns > 4:
        raise ScanError(
            f"{path}: expected an array of shape (n, 3) or (n, 4), got {array.shape}; name its "
            f"{n_columns} columns in input.columns, or of one side alone in input.real_columns or "
            "input.sim_columns"
        )
    return scan_from_columns(path, dict(zip(_COLUMNS, array.T, strict=False)))
