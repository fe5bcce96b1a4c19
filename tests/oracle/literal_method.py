"""Literal implementation of the method, slow and obvious: loops, all distances, dense matrices.

`test_oracle.py` and `recompute.py` compare runs with it, other tests single stages. It imports nothing from fidpipe,
so that agreement confirms the definition, not an implementation.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Callable, Iterable, Mapping, Sequence
from statistics import median
from types import MappingProxyType
from typing import Any

import numpy as np
import scipy.linalg
from numpy.typing import NDArray
from scipy import sparse
from scipy.optimize import linear_sum_assignment

Settings = Mapping[str, Any]  #: one group of the settings, by name
_MAX_TILT_DEG = 10
_ALIKE = 1e-9
_NEAR_M, _WINDOW_M, _STEP_M, _DEPTH_M = 30, 0.1, 0.05, 1
_CELL_M, _FEWEST_CELLS = 0.5, 20
IDENTICAL_CHANGE = 1e-5
_ROS_AXES: dict[str, Callable[[float, float, float], list[float]]] = {
    "ros": lambda forward, left, up: [forward, left, up],
    "carla": lambda forward, right, up: [forward, -right, up],
    "nuscenes": lambda right, forward, up: [forward, -right, up],
    "kitti-cam": lambda right, down, forward: [forward, -right, -down],
}
#: Columns of `describe`.
PLACE = ("n_points", "cx", "cy", "cz", "range_m", "extent_x", "extent_y", "extent_z")
SHAPE = ("linearity", "planarity", "scattering")
#: Scores of `spectral`.
SPECTRAL = (
    *("r_lambda", "r_gap", "max_eigenvalue_shift", "laplacian_change"),
    *("eigenspectrum_distance", "gap_real", "gap_sim"),
)


def clean(
    points: NDArray[np.float64], settings: Settings, frame: str, T: NDArray[np.float64] | None
) -> tuple[list[int], NDArray[np.float64]]:
    """Rows and coordinates, (m, 3), of the points that are measurements, in the real sensor's frame.

    Parameters
    ----------
    points : (n, 3) float64, metres, the scan's own frame
    settings : of the group input
    frame : frame of the scan: "ros", "carla", "nuscenes" or "kitti-cam"
    T : (3, 4) float64, maps that frame into the real sensor's, after conversion to x forward, y left, z up
    """
    exclude_box = settings["exclude_box"]
    include_box = settings["include_box"]
    range_of = {}
    for p in map(tuple, points.tolist()):
        if all(map(math.isfinite, p)) and p != (0, 0, 0):
            range_of[p] = math.sqrt(p[0] * p[0] + p[1] * p[1] + p[2] * p[2])
    miss_range_m = _miss_range(list(range_of.values()))
    seen = set()
    voxels = set()
    rows = []
    kept = []
    for i, p in enumerate(points.tolist()):
        if tuple(p) not in range_of or tuple(p) in seen:
            continue
        seen.add(tuple(p))
        range_m = range_of[tuple(p)]
        if miss_range_m is not None and abs(range_m - miss_range_m) <= 0.1:
            continue
        if not settings["min_range_m"] <= range_m <= settings["max_range_m"]:
            continue
        if exclude_box and all(exclude_box[a] <= p[a] <= exclude_box[a + 3] for a in range(3)):
            continue
        q = _ROS_AXES[frame](*p)
        if T is not None:
            q = [T[r, 0] * q[0] + T[r, 1] * q[1] + T[r, 2] * q[2] + T[r, 3] for r in range(3)]
        if include_box and not all(
            include_box[a] <= q[a] <= include_box[a + 3] for a in range(3)
        ):
            continue
        if settings["voxel_m"]:
            voxel = tuple(math.floor(c / settings["voxel_m"]) for c in q)
            if voxel in voxels:
                continue
            voxels.add(voxel)
        rows.append(i)
        kept.append(q)
    return rows, np.array(kept).reshape(-1, 3)


def _miss_range(ranges_m: list[float]) -> float | None:
    """Range at which rays without a return are written: 3 to 95 % of at least 500 points are at the farthest range."""
    if len(ranges_m) < 500 or max(ranges_m) - min(ranges_m) < 5.0:
        return None
    farthest_m = max(ranges_m)
    farthest = [range_m for range_m in ranges_m if range_m > farthest_m - 0.1]
    before = [range_m for range_m in ranges_m if farthest_m - 0.6 < range_m <= farthest_m - 0.1]
    if not 0.03 <= len(farthest) / len(ranges_m) <= 0.95 or len(farthest) < 2 * len(before):
        return None
    return float(np.median(farthest))


Cut = dict[
    str, Any
]  #: axis (3,), tilt_deg, peak_m, threshold_m, loss and iterations of a ground cut


def ground(
    points: NDArray[np.float64], settings: Settings, default_axis: NDArray[np.float64]
) -> tuple[Cut, NDArray[np.float64], bool]:
    """The PCA Z-cut of a scan, heights of its points along the axis (n,), and False if another axis has the same right.

    Parameters
    ----------
    points : (n, 3) float64, metres, cleaned
    settings : of the group ground
    default_axis : (3,) axis if the points have the same variance along two axes
    """
    scale = float(np.ptp(points, axis=0).max()) or 1.0  # squares of 1e-200 m would be 0
    values, vectors = np.linalg.eigh(np.cov(((points - points.mean(axis=0)) / scale).T))
    chosen = max(range(3), key=lambda i: abs(vectors[2, i]))
    is_unique = (
        min(abs(values[i] - values[chosen]) for i in range(3) if i != chosen)
        > _ALIKE * values[2]
    )
    axis = vectors[:, chosen] if is_unique else default_axis
    axis = axis if axis[2] > 0 else -axis
    tilt_deg = math.degrees(math.acos(min(1.0, axis[2])))
    if tilt_deg > _MAX_TILT_DEG:
        axis = np.array([0.0, 0.0, 1.0])
    height = np.array([float(p @ axis) for p in points])
    near = [
        h
        for h, p in zip(height.tolist(), points.tolist(), strict=True)
        if math.hypot(*p) <= _NEAR_M
    ]
    peak = _median_of_fullest_window(near or height.tolist())
    z = peak + settings["prior_m"]
    iterations = 0
    loss = settings["loss"]
    lost = variance_loss(points, height, z, peak, loss)
    while lost > settings["max_variance_loss"] and z > peak + 1e-9:
        z = max(z - _STEP_M, peak)
        iterations += 1
        lost = variance_loss(points, height, z, peak, loss)
    cut = {
        "axis": axis,
        "tilt_deg": tilt_deg,
        "peak_m": peak,
        "threshold_m": z,
        "loss": lost,
        "iterations": iterations,
    }
    return cut, height, bool(is_unique)


def _median_of_fullest_window(heights: Sequence[float]) -> float:
    """Median of the most heights that are within 0.1 m."""
    ascending = sorted(heights)
    ends = [bisect_right(ascending, h + _WINDOW_M) for h in ascending]
    start = max(range(len(ends)), key=lambda i: ends[i] - i)
    return median(ascending[start : ends[start]])


def road_offset(
    real: NDArray[np.float64], sim: NDArray[np.float64], axis: NDArray[np.float64]
) -> float | None:
    """Height of the simulated road above the real one: the median of the fullest 0.1 m of the cells' differences.

    Parameters
    ----------
    real, sim : (n, 3), (m, 3) float64, metres, cleaned
    axis : (3,) axis of heights of the real side
    """
    heights: tuple[dict[tuple[int, int], list[float]], ...] = ({}, {})
    for cells, points in zip(heights, (real, sim), strict=True):
        for p in points.tolist():
            if math.hypot(*p) <= _NEAR_M:
                cell = (math.floor(p[0] / _CELL_M), math.floor(p[1] / _CELL_M))
                cells.setdefault(cell, []).append(sum(axis[i] * p[i] for i in range(3)))
    above = [
        median(own) - median(heights[0][cell])
        for cell, own in heights[1].items()
        if cell in heights[0]
    ]
    return _median_of_fullest_window(above) if len(above) >= _FEWEST_CELLS else None


def variance_loss(
    points: NDArray[np.float64],
    height: NDArray[np.float64],
    threshold_m: float,
    peak_m: float,
    loss: str,
) -> float:
    """Share of the variance that is lost with the points below a threshold, by the definition that `loss` selects.

    Parameters
    ----------
    points, height : (n, 3) and (n,) float64, metres
    """
    removed = height < threshold_m
    if loss == "total":
        whole = float(np.trace(np.cov(points.T, bias=True)))
        kept = (
            float(np.trace(np.cov(points[~removed].T, bias=True))) if not removed.all() else 0.0
        )
        return abs(kept - whole) / whole if whole > 0 else 0.0
    counted = [h for h in height[removed].tolist() if h > peak_m - _DEPTH_M]
    whole = float(np.var(height) * len(height))
    if whole <= len(height) * 1e-18:
        return 0.0  # a perfect plane
    return float(np.var(counted) * len(counted)) / whole if counted else 0.0


def distances(points: NDArray[np.float64], place: NDArray[np.float64]) -> NDArray[np.float64]:
    """Distance of each point from one place, (n,) metres: sqrt(dx^2 + dy^2 + dz^2).

    Parameters
    ----------
    points, place : (n, 3), (3,) float64, metres
    """
    dx, dy, dz = (points - place).T
    apart: NDArray[np.float64] = np.sqrt(dx * dx + dy * dy + dz * dz)
    return apart


def nearest(points: NDArray[np.float64], i: int, k: int, ties: str = "point_id") -> list[int]:
    """The k nearest neighbours of point i, nearest first; for equal distances the first by index or by x, y, z.

    Parameters
    ----------
    points : (n, 3) float64, metres
    ties : "point_id" or "coordinates", as in the settings of the graph
    """
    apart = distances(points, points[i])
    apart[i] = np.inf
    k = min(k, len(points) - 1)
    if k < 1:
        return []
    candidates = np.flatnonzero(apart <= np.partition(apart, k - 1)[k - 1]).tolist()
    tie = points.tolist() if ties == "coordinates" else None
    candidates.sort(key=lambda j: (apart[j], tie[j] if tie else j))
    return candidates[:k]


def edges(
    points: NDArray[np.float64], k: int, tau_m: float, rule: str, ties: str
) -> list[tuple[int, int]]:
    """Edges of the graph, each as its smaller and larger index: nearest neighbours, and points within tau.

    Parameters
    ----------
    points : (n, 3) float64, metres
    rule : "union" if either suffices, "intersection" if both are needed
    ties : see `nearest`
    """
    linked = set()
    for i in range(len(points)):
        neighbours = set(nearest(points, i, k, ties))
        within = set(np.flatnonzero(distances(points, points[i]) <= tau_m).tolist()) - {i}
        chosen = neighbours | within if rule == "union" else neighbours & within
        linked |= {(min(i, j), max(i, j)) for j in chosen}
    return sorted(linked)


def louvain(
    n_nodes: int,
    src: NDArray[np.intp],
    dst: NDArray[np.intp],
    length_m: NDArray[np.float64],
    order: NDArray[np.intp],
) -> list[int]:
    """Communities by scikit-network's Louvain with nodes visited in a given order.

    Parameters
    ----------
    src, dst, length_m : (m,) both ends of each edge by node, and its length
    order : (n,) nodes in the order of the visits
    """
    from sknetwork.clustering import Louvain

    place = np.argsort(order)
    ends = np.concatenate([place[src], place[dst]]), np.concatenate([place[dst], place[src]])
    A = sparse.coo_matrix(
        (np.concatenate([length_m, length_m]), ends), shape=(n_nodes, n_nodes)
    ).tocsr()
    A.eliminate_zeros()
    found = Louvain(
        resolution=1, tol_optimization=1e-3, tol_aggregation=1e-7, shuffle_nodes=False
    ).fit_predict(A)
    labels: list[int] = found[place].tolist()
    return labels


def best_merge_gain(
    labels: NDArray[np.intp],
    src: NDArray[np.intp],
    dst: NDArray[np.intp],
    length_m: NDArray[np.float64],
) -> float:
    """Largest gain of Q by merging two communities that are connected by an edge; -inf without such communities.

    dQ = 2 (w_cd / 2m - k_c k_d / (2m)^2), w_cd the length of all edges between c and d, k their degrees, 2m the sum of
    these. Louvain's method ends when it finds no such gain.

    Parameters
    ----------
    labels : (n,) community of each node
    src, dst, length_m : (m,) both ends of each edge by node, and its length
    """
    a = labels[src]
    b = labels[dst]
    ends = np.concatenate([a, b]), np.concatenate([b, a])
    between = sparse.coo_array((np.concatenate([length_m, length_m]), ends)).tocsr()
    degree = between.sum(axis=1)
    c, d, w = sparse.find(between)
    gain = 2 * (w / degree.sum() - degree[c] * degree[d] / degree.sum() ** 2)
    return float(gain[c != d].max(initial=-math.inf))


def canonical(
    labels: Sequence[int] | NDArray[np.intp], order: Iterable[int] | None = None
) -> list[int]:
    """Renumber communities by size, largest first, then by the first of their nodes in an order; -1 is kept."""
    members: dict[int, list[int]] = {}
    for node in range(len(labels)) if order is None else order:
        if labels[node] >= 0:
            members.setdefault(int(labels[node]), []).append(node)
    # of equal sizes the first stays first
    ranked = sorted(members.values(), key=len, reverse=True)
    new = {node: i for i, nodes in enumerate(ranked) for node in nodes}
    return [new.get(node, -1) for node in range(len(labels))]


def describe(points: NDArray[np.float64]) -> dict[str, float]:
    """Size, place and shape of the points of one community, by column of `objects`.

    Parameters
    ----------
    points : (n, 3) float64, metres, at least one
    """
    centroid = points.sum(axis=0) / len(points)
    sizes = np.linalg.svd(points - centroid, compute_uv=False)
    l1, l2, l3 = [*(sizes / (sizes[0] or 1.0)) ** 2, 0.0, 0.0][:3]
    shape = ((l1 - l2) / l1, (l2 - l3) / l1, l3 / l1) if l1 > 0 else (0.0, 0.0, 0.0)
    extent = points.max(axis=0) - points.min(axis=0)
    about = (len(points), *centroid, math.hypot(*centroid), *extent, *shape)
    return dict(zip((*PLACE, *SHAPE), about, strict=True))


Matches = list[tuple[int, int, float]]  #: real id, simulated id, distance of their centroids


def match_greedy(
    real: NDArray[np.float64],
    sim: NDArray[np.float64],
    delta_m: float,
    stored: Mapping[int, int] = MappingProxyType({}),
    rounding_m: float = 0,
) -> Matches:
    """Algorithm 1: each real object takes the nearest centroid that is free, if it is nearer than delta.

    Parameters
    ----------
    real, sim : (a, 3), (b, 3) float64, metres, centroids by id
    stored : matches that are accepted if they are as near as the nearest, and as delta, up to `rounding_m`
    """
    used = set()
    pairs = []
    for i, p in enumerate(real):
        free = {j: math.dist(p, q) for j, q in enumerate(sim) if j not in used}
        if not free:
            break
        j = min(free, key=lambda j: (free[j], j))
        own = stored.get(i)
        if own in free and free[own] <= free[j] + rounding_m:
            j = own
        if free[j] < delta_m + (-rounding_m if own is None else rounding_m):
            used.add(j)
            pairs.append((i, j, free[j]))
    return pairs


def laplacian(A: NDArray[np.float64]) -> NDArray[np.float64]:
    """I - D^-1/2 A D^-1/2, (n, n); zero rows for isolated nodes.

    Parameters
    ----------
    A : (n, n) float64, edge lengths
    """
    degree = A.sum(axis=1)
    joined = degree > 0
    scale = np.sqrt(np.outer(degree, degree))
    return np.diag(joined.astype(float)) - np.divide(
        A, scale, out=np.zeros_like(A), where=scale > 0
    )


def influence(L: NDArray[np.float64], t: float) -> NDArray[np.float64]:
    """Row sums of the dense heat kernel, (n,), not rounded.

    Parameters
    ----------
    L : (n, n) float64, normalised Laplacian
    """
    sums: NDArray[np.float64] = scipy.linalg.expm(-t * L).sum(axis=1)
    return sums


def least_total(cost: NDArray[np.float64]) -> float:
    """Lower bound of the total cost of any one-to-one assignment; equal to the minimum up to rounding.

    For any v, sum_i min_j (c_ij - v_j) + sum_j v_j is at most any total (linear programming duality). The best v are
    the lengths of shortest exchange paths (Bellman-Ford) from an assignment that scipy finds. If that were not optimal,
    the result would still be a lower bound, below the optimal cost.

    Parameters
    ----------
    cost : (n, n) float64
    """
    n = len(cost)
    chosen = linear_sum_assignment(cost)[1]
    moved = cost[:, chosen]
    step = moved - moved[np.arange(n), np.arange(n)][:, None]
    price = np.zeros(n)
    for _ in range(n):
        shorter = np.minimum(price, (price[:, None] + step).min(axis=0))
        if np.array_equal(shorter, price):
            break
        price = shorter
    return float((moved - price).min(axis=1).sum() + price.sum())


def nearest_distances(xs: NDArray[np.float64], ys: NDArray[np.float64]) -> NDArray[np.float64]:
    """Distance of each x to the nearest y, (n,) metres, from all distances.

    Parameters
    ----------
    xs, ys : (n, 3), (m, 3) float64, metres
    """
    return np.array([distances(ys, x).min() for x in xs])


def cdc(real: NDArray[np.float64], sim: NDArray[np.float64]) -> float:
    """CDC by the paper's equation.

    Parameters
    ----------
    real, sim : (n, 3), (m, 3) float64, metres
    """

    def one_way(xs: NDArray[np.float64], ys: NDArray[np.float64]) -> float:
        return math.fsum(
            1 - math.exp(-(d**2)) for d in nearest_distances(xs, ys).tolist()
        ) / len(xs)

    return one_way(real, sim) + one_way(sim, real)


def alignment_rms(real: NDArray[np.float64], sim: NDArray[np.float64]) -> float:
    """Root mean square distance of aligned nodes, both sides centred, metres.

    Parameters
    ----------
    real, sim : (n, 3) float64, metres, row by row aligned
    """
    apart = (real - real.mean(axis=0)) - (sim - sim.mean(axis=0))
    return math.sqrt(sum(x * x for row in apart.tolist() for x in row) / len(apart))


def spectral(L_real: NDArray[np.float64], L_sim: NDArray[np.float64]) -> dict[str, float]:
    """r_lambda, r_gap and their components, from LAPACK's dense eigenvalues.

    Parameters
    ----------
    L_real, L_sim : (n, n) float64, normalised Laplacians, nodes aligned, n at least 3
    """
    a, b = np.linalg.eigvalsh(L_real), np.linalg.eigvalsh(L_sim)
    change = float(abs(np.linalg.eigvalsh(L_sim - L_real)).max())
    shift = float(max(abs(b - a)))
    gap_real, gap_sim = float(a[1] - a[0]), float(b[1] - b[0])
    is_identical = change <= IDENTICAL_CHANGE
    return {
        "r_lambda": 0.0 if is_identical else min(1.0, shift / change),
        "r_gap": 0.0 if is_identical else min(0.5, abs(gap_sim - gap_real) / (2 * change)),
        "max_eigenvalue_shift": shift,
        "laplacian_change": change,
        "eigenspectrum_distance": math.sqrt(sum((b - a) ** 2)),
        "gap_real": gap_real,
        "gap_sim": gap_sim,
    }
