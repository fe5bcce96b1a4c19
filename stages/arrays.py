"""Array types of the stages, and the hook for timing the steps of a stage.

A stage reads no clock. It enters `watch("step")` around each step worth timing; the caller decides what that does.
By default it does nothing.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext
from typing import Any

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
Float32Array = NDArray[np.float32]
IntArray = NDArray[np.int32]
IndexArray = NDArray[np.intp]
BoolArray = NDArray[np.bool_]

Watch = Callable[[str], AbstractContextManager[None]]


def transform_of(numbers: Sequence[float] | None) -> FloatArray | None:
    """The rigid motion [R | t] of 12 numbers, row by row, (3, 4); None without numbers."""
    return np.array(numbers, dtype=float).reshape(3, 4) if numbers else None


def moved(points: FloatArray, T: FloatArray | None) -> FloatArray:
    """Points after the motion T = [R | t], R p + t, (n, 3); unchanged if T is None."""
    if T is None:
        return points
    return points @ T[:, :3].T + T[:, 3]


def sums_by_id(values: NDArray[Any], ids: NDArray[np.integer[Any]], n_ids: int) -> FloatArray:
    """Sum of each column over the rows of each id, (n_ids, columns).

    Parameters
    ----------
    values : (n, columns) float64 or bool
    ids : (n,) from 0
    """
    return np.column_stack([np.bincount(ids, column, n_ids) for column in values.T])


def rows_by_id(ids: NDArray[np.integer[Any]], n_ids: int = 0) -> list[IndexArray]:
    """Rows of each id from 0, ascending; negative ids are left out.

    Parameters
    ----------
    ids : (n,)
    n_ids : minimum number of ids

    Examples
    --------
    >>> [rows.tolist() for rows in rows_by_id(np.array([1, -1, 1]), 3)]
    [[], [0, 2], []]
    """
    order = np.argsort(ids, kind="stable")
    n_ids = max(n_ids, int(ids.max(initial=-1)) + 1)
    return np.split(order, np.searchsorted(ids[order], np.arange(n_ids)))[1:]


def sorted_rows(*keys: NDArray[Any]) -> IndexArray:
    """(n,) rows in the order of the first key, (n,), then of the next, then as they are: a faster `np.lexsort`."""
    rank = keys[0]
    for key in (*keys[1:], np.arange(len(rank))):
        _, upper = np.unique(rank, return_inverse=True)
        _, lower = np.unique(key, return_inverse=True)
        rank = upper * len(key) + lower
    return np.argsort(rank)


def azimuths_deg(points: FloatArray) -> FloatArray:
    """Azimuth of each point seen from the origin, (n,), degrees from x towards y, -180 to 180."""
    return np.degrees(np.arctan2(points[:, 1], points[:, 0]))


def level_m(points: FloatArray) -> FloatArray:
    """Horizontal distance of each point from the origin, (n,)."""
    return np.hypot(points[:, 0], points[:, 1])


def slopes_deg(points: FloatArray) -> FloatArray:
    """Elevation of each point seen from the origin, (n,), degrees."""
    return np.degrees(np.arctan2(points[:, 2], level_m(points)))


def unwatched(step: str) -> AbstractContextManager[None]:
    """Do nothing: the default watch."""
    return nullcontext()
