"""Raw little-endian float32 rows: KITTI `.bin` (x y z intensity) and nuScenes `.pcd.bin` (and ring)."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ....schemas.errors import ScanError
from .scan import Scan, scan_from_columns

_KITTI = ("x", "y", "z", "intensity")
_NUSCENES = (*_KITTI, "ring")


def read(path: Path, columns: tuple[str, ...] | None = None) -> Scan:
    """The scan in a raw float32 file with the given columns, or those that its suffix means."""
    names = columns or (_NUSCENES if path.name.lower().endswith(".pcd.bin") else _KITTI)
    n_bytes = path.stat().st_size
    if n_bytes % (4 * len(names)):
        raise ScanError(
            f"{path}: {n_bytes} bytes found, a multiple of {4 * len(names)} wanted ({len(names)} float32 columns: "
            f"{' '.join(names)}); the file is truncated, or has other columns: name them in input.columns"
        )
    rows = np.fromfile(path, dtype="<f4").reshape(-1, len(names))
    return scan_from_columns(path, {name: rows[:, i] for i, name in enumerate(names)})
