"""NumPy `.npy`: rows of x y z and perhaps intensity, or a structured array with named fields."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ....schemas.errors import ScanError
from .scan import Scan, refused_unless, scan_from_columns

_COLUMNS = ("x", "y", "z", "intensity")


def read(path: Path) -> Scan:
    """The scan in a `.npy` file.

    Raises
    ------
    ScanError
        The array is not whole, holds objects (pickles, which could run code), or has another shape.
    """
    with refused_unless(path, "a whole .npy array", ValueError, EOFError):
        array = np.load(path, allow_pickle=False)
    if array.dtype.names:
        return scan_from_columns(path, {name: array[name] for name in array.dtype.names})
    if array.ndim != 2 or array.shape[1] < 3 or array.dtype.kind not in "fiu":
        raise ScanError(
            f"{path}: {array.dtype} array of shape {array.shape} found, numbers of shape (n, 3) or (n, 4) wanted"
        )
    return scan_from_columns(path, dict(zip(_COLUMNS, array.T, strict=False)))
