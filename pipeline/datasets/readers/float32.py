"""Raw rows of little-endian float32: KITTI `.bin` (x y z intensity) and nuScenes `.pcd.bin` (and ring)."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ....schemas.errors import ScanError
from ....stages.arrays import FloatArray
from .scan import Scan, scan_from_columns

_SAMPLE_BYTES = 8 * 3 * 4 * 5 * 7 * 100
_WIDTHS = range(3, 11)
_FEWEST_ROWS = 100
_SETTINGS = "input.columns, or of one side alone in input.real_columns or input.sim_columns"
_MIN_GAIN = 0.15  # powers of ten; a wrong width has 0.3 and more
_MAX_TIE = 0.05  # between a width and its multiples


def read(path: Path, columns: tuple[str, ...]) -> Scan:
    """The scan in a file of rows of these columns.

    Raises
    ------
    ScanError
        The file's length is not a multiple of the row length, or x, y or z is not among the
        columns.
    """
    if _is_float64(path):
        raise ScanError(
            f"{path}: expected float32, got float64; convert it: "
            "np.fromfile(file, '<f8').astype('<f4').tofile(file)"
        )
    n_bytes = path.stat().st_size
    if n_bytes % (4 * len(columns)):
        raise ScanError(
            f"{path}: expected a multiple of {4 * len(columns)} bytes ({len(columns)} float32 "
            f"columns: {' '.join(columns)}), got {n_bytes}; the file is truncated, or has other "
            f"columns: name them in {_SETTINGS}"
        )
    rows = np.fromfile(path, dtype="<f4").reshape(-1, len(columns))
    return scan_from_columns(path, {name: rows[:, i] for i, name in enumerate(columns)})


def check_width(path: Path, columns: tuple[str, ...]) -> None:
    """Raise `ScanError` if the values of a file belong to rows of another width than that of the usual columns.

    Columns of the right width hold one quantity each, and spread less than those of a wrong one,
    which mix them. Of a width and its multiples the smallest is right.
    """
    values = np.fromfile(path, dtype="<f4", count=_SAMPLE_BYTES // 16)
    if len(values) < _FEWEST_ROWS * max(_WIDTHS) or _plausible_share(values) < 0.5:
        return
    values = np.where(np.isfinite(values), values, 0).astype(np.float64)
    n_values = path.stat().st_size // 4
    spreads = {n: _spread(values, n) for n in _WIDTHS if n_values % n == 0}
    least = min(spreads.values())
    n_columns = next(n for n, spread in spreads.items() if spread < least + _MAX_TIE)
    if spreads[len(columns)] - spreads[n_columns] > _MIN_GAIN:
        raise ScanError(
            f"{path}: the values do not fit {len(columns)} float32 columns ({' '.join(columns)}), "
            f"but {n_columns}: name these in {_SETTINGS}"
        )


def _is_float64(path: Path) -> bool:
    """True if the values are plausible only as float64.

    The lower half of a float64 is noise when it is read as float32: of all magnitudes, NaN among
    them.
    """
    values = np.fromfile(path, dtype="<f8", count=_SAMPLE_BYTES // 8)
    if not len(values) or _plausible_share(values.view("<f4")) > 0.9:
        return False
    return _plausible_share(values) >= 0.99


def _spread(values: FloatArray, n_columns: int) -> float:
    """Mean over the columns of the decimal logarithm of the range of their middle 90 %, at least 0.01."""
    rows = values[: len(values) // n_columns * n_columns].reshape(-1, n_columns)
    low, high = np.percentile(rows, [5, 95], axis=0)
    return float(np.log10(np.maximum(high - low, 0.01)).mean())


def _plausible_share(values: NDArray[np.floating[Any]]) -> float:
    """Share of values that are zero or between a micrometre and a thousand kilometres."""
    with np.errstate(invalid="ignore", over="ignore"):
        size = np.abs(values)
        return float(np.mean((size == 0) | ((size > 1e-6) & (size < 1e6))))
