"""Raw rows of little-endian float32: KITTI `.bin` (x y z intensity) and nuScenes `.pcd.bin` (and ring)."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ....schemas.errors import ScanError
from .scan import Scan, scan_from_columns

_SAMPLE_BYTES = 8 * 3 * 4 * 5 * 7 * 100


def read(path: Path, columns: tuple[str, ...]) -> Scan:
    """The scan in a file of rows of these columns.

    Raises
    ------
    ScanError
        The file's length is not a multiple of the row length, or x, y or z is not among the columns.
    """
    n_bytes = path.stat().st_size
    if (n_columns := _float64_columns(path, columns)) is not None:
        raise ScanError(
            f"{path}: expected float32, got float64 in rows of {n_columns} columns; convert it: "
            f"np.fromfile(file, '<f8').astype('<f4').tofile(file)"
        )
    if n_bytes % (4 * len(columns)):
        raise ScanError(
            f"{path}: expected a multiple of {4 * len(columns)} bytes ({len(columns)} float32 columns: "
            f"{' '.join(columns)}), got {n_bytes}; the file is truncated, or has other columns: name them "
            "in input.columns, or of one side alone in input.real_columns or input.sim_columns"
        )
    rows = np.fromfile(path, dtype="<f4").reshape(-1, len(columns))
    return scan_from_columns(path, {name: rows[:, i] for i, name in enumerate(columns)})


def _float64_columns(path: Path, columns: tuple[str, ...]) -> int | None:
    """Number of float64 columns if the values are plausible only as float64; else None.

    The lower half of a float64 is noise when it is read as float32: of all magnitudes, NaN among them. Of the widths
    that divide the file that is taken under which x, y and z change least from row to row; the usual one in a tie.
    """
    content = np.fromfile(path, dtype=np.uint8, count=_SAMPLE_BYTES)
    content = content[: len(content) // 8 * 8]
    if not len(content) or _plausible_share(content.view("<f4")) > 0.9 or _plausible_share(content.view("<f8")) < 0.99:
        return None
    values, n_bytes = content.view("<f8"), path.stat().st_size
    widths = [n for n in (len(columns), 3, 4, 5, 6, 7) if n_bytes % (8 * n) == 0]
    if not widths:
        return None

    def roughness(n: int) -> float:
        rows = values[: len(values) // n * n].reshape(-1, n)[:, :3]
        return float(np.abs(np.diff(rows, axis=0)).mean()) if len(rows) > 1 else 0.0

    return min(widths, key=roughness)


def _plausible_share(values: NDArray[np.floating[Any]]) -> float:
    """Share of values that are zero or between a micrometre and a thousand kilometres."""
    with np.errstate(invalid="ignore", over="ignore"):
        size = np.abs(values)
        return float(np.mean((size == 0) | ((size > 1e-6) & (size < 1e6))))
