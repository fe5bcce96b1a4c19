"""Coverage: share of each side's surface that the other side has, regardless of the objects."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .arrays import BoolArray, FloatArray, IntArray, rows_by_id, sums_by_id
from .linalg.nearest import search_tree

#: A point is covered if the other side has a point within this distance.
COVERAGE_DISTANCES_M = (0.1, 0.3, 1.0)


@dataclass(frozen=True)
class Coverage:
    """Covered share of several sets of points; NaN for a set without points.

    n_points : (c,) int32
    covered : (c, 3) float64, share of the points at most 0.1, 0.3 and 1.0 m from the other side
    median_distance_m : (c,) float64, median distance to the other side
    road_share : (c,) float64, share of the points that are road to the other side; NaN if unknown
    """

    n_points: IntArray
    covered: FloatArray
    median_distance_m: FloatArray
    road_share: FloatArray


def nearest_distances(real: FloatArray, sim: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Distance of each real point to the nearest simulated one, (n,), and the other way round, (m,); metres.

    Parameters
    ----------
    real, sim : (n, 3), (m, 3) float64, metres, at least one point each
    """
    to_sim, _ = search_tree(sim).query(real)
    to_real, _ = search_tree(real).query(sim)
    return to_sim, to_real


def below_cut(
    points: FloatArray, axis: FloatArray, threshold_m: float | None
) -> BoolArray | None:
    """True for points of a side below the other side's ground threshold, (n,) bool; None if that side has no threshold.

    p . axis < threshold. Road that one side's cut removed and the other's kept remains as objects (defined by fidpipe).

    Parameters
    ----------
    points : (n, 3) float64, metres, object points
    axis, threshold_m : (3,) and metres, cut of the other side; see `ground.GroundResult`

    Examples
    --------
    >>> import numpy as np
    >>> below_cut(np.array([[5.0, 0.0, -1.7], [5.0, 0.0, 0.4]]), np.array([0.0, 0.0, 1.0]), -1.4).tolist()
    [True, False]
    """
    return None if threshold_m is None else points @ axis < threshold_m


def cover(
    distance_m: FloatArray,
    labels: IntArray,
    n_ids: int = 0,
    is_road: BoolArray | None = None,
) -> Coverage:
    """Coverage of each object of a side, by id.

    covered_r = |{p : min_q |p - q| <= r}| / n, p of the object, q any object point of the other side (defined by
    fidpipe).

    Parameters
    ----------
    distance_m : (n,) float64, distance of each point to the other side
    labels : (n,) int32, object of each point, ids from 0; -1 for none
    n_ids : minimum number of ids
    is_road : (n,) bool, points that are road to the other side, see `below_cut`; None if unknown

    Examples
    --------
    >>> import numpy as np
    >>> cover(np.array([0.05, 0.5]), np.zeros(2, dtype=np.int32)).covered.tolist()
    [[0.5, 0.5, 1.0]]
    """
    inside = labels >= 0
    distance_m = distance_m[inside]
    labels = labels[inside]
    n_points = np.bincount(labels, minlength=n_ids).astype(np.int32)
    road = np.full(len(n_points), np.nan)
    is_near = distance_m[:, None] <= np.array(COVERAGE_DISTANCES_M)
    with np.errstate(invalid="ignore"):
        if is_road is not None:
            road = np.bincount(labels, is_road[inside], len(n_points)) / n_points
        shares = sums_by_id(is_near, labels, len(n_points)) / n_points[:, None]
    median_m = np.full(len(n_points), np.nan)
    for i, rows in enumerate(rows_by_id(labels, n_ids)):
        if len(rows):
            median_m[i] = np.median(distance_m[rows])
    return Coverage(n_points, shares, median_m, road)
