"""Raw rows of little-endian float32: KITTI `.bin` (x y z intensity) and nuScenes `.pcd.bin` (and ring)."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ....schemas.errors import ScanError
from .scan import Scan, scan_from_columns


def read(path: Path, columns: tuple[str, ...]) -> Scan:
    """The scan in a file of rows of these columns.

    Raises
    ------
    ScanError
        The file's length is no multiple of a row's, or x, y or z is not among the columns.
    """
    n_bytes = path.stat().st_size
    if n_bytes % (4 * len(columns)):
        raise ScanError(
            f"{path}: {n_bytes} bytes found, a multiple of {4 * len(columns)} wanted ({len(columns)} float32 columns: "
            f"{' '.join(columns)}); the file is truncated, or has other columns: name them in input.columns"
        )
    rows = np.fromfile(path, dtype="<f4").reshape(-1, len(columns))
    return scan_from_columns(path, {name: rows[:, i] for i, name in enumerate(columns)})
