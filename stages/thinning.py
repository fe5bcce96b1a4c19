"""Downsampling of a cloud to the first point of each voxel."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from .arrays import BoolArray, FloatArray

#: Edges of voxels that are proposed for clouds with too many points, metres.
VOXELS_M = (0.05, 0.1, 0.2, 0.4, 0.8)


def repeats_earlier_row(rows: FloatArray) -> BoolArray:
    """True for rows that are equal to an earlier row, (n,) bool.

    Parameters
    ----------
    rows : (n, columns) float64
    """
    order = np.lexsort(rows.T)  # stable, so that of equal rows the first comes first
    in_order = rows[order]
    repeats = np.zeros(len(rows), dtype=bool)
    is_equal = in_order[1:] == in_order[:-1]
    repeats[order[1:]] = is_equal.all(axis=1)
    return repeats


def shares_voxel(points: FloatArray, voxel_m: float) -> BoolArray:
    """True for points in the voxel of an earlier point, (n,) bool.

    Parameters
    ----------
    points : (n, 3) float64, metres
    voxel_m : edge of a voxel; one voxel has a corner at the origin
    """
    return repeats_earlier_row(np.floor(points / voxel_m))


def smallest_voxel(points: FloatArray, fits: Callable[[FloatArray], bool]) -> float | None:
    """The smallest of `VOXELS_M` that leaves few enough points; None if each leaves too many.

    Parameters
    ----------
    points : (n, 3) float64, metres
    fits : returns True if these points are few enough

    Examples
    --------
    >>> line = np.array([[0.01 * i, 0, 0] for i in range(100)])
    >>> smallest_voxel(line, lambda points: len(points) <= 10)
    0.1
    """
    for voxel_m in VOXELS_M:
        thinned = points[~shares_voxel(points, voxel_m)]
        if fits(thinned):
            return voxel_m
    return None
