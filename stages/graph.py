"""Graph of the object points: edges and their lengths (paper, section "From Point Clouds to Graphs")."""

from __future__ import annotations

import numpy as np
import scipy
from numpy.typing import NDArray

from ..schemas.errors import StageError
from ..schemas.settings import GraphSettings
from .arrays import FloatArray, IndexArray, IntArray
from .linalg.subgraph import Edges
from .thinning import smallest_voxel

#: More pairs of points within tau are rejected: their graph would need about 10 GB.
MAX_CLOSE_PAIRS = 10**8
_SLACK = 1e-9  # relative; the tree's distances may differ from ours in the last bits
_LEAF_SIZE = 32

Arcs = tuple[NDArray[np.integer], NDArray[np.integer]]  #: the two ends of each arc


def build_graph(points: FloatArray, settings: GraphSettings) -> Edges:
    """Edges between near points, weighted by distance.

    (i, j) is an edge if j is among the k nearest neighbours of i or i among those of j (ties at the k-th distance go
    to the smaller index, or with `ties = "coordinates"` to the first point by x, y, z, independent of row order), or if
    |x_i - x_j| <= tau; with `edges = "intersection"` both must hold.
    A_ij = |x_i - x_j|_2, rounded to float32 (paper, equation "main_graph": a distance, not a similarity).

    Parameters
    ----------
    points : (n, 3) float64, metres, finite; fewer than two have no edges
    settings : k (limited to n - 1), tau_m, edges, ties

    Raises
    ------
    StageError
        More than 10^8 pairs of points are within tau, or, with `edges = "intersection"`, at the same place (below
        1e-162 m, the limit of float64).

    Examples
    --------
    >>> import numpy as np
    >>> line = np.array([[0.0, 0, 0], [1, 0, 0], [3, 0, 0]])
    >>> edges = build_graph(line, GraphSettings(k=1))
    >>> edges.src.tolist(), edges.dst.tolist(), edges.length_m.tolist()
    ([0, 1], [1, 2], [1.0, 2.0])
    """
    n = len(points)
    if n < 2:
        empty = np.empty(0, dtype=np.int32)
        return Edges(empty, empty, np.empty(0, dtype=np.float32))
    near_m = settings.tau_m if settings.edges == "union" else 0.0
    if np.linalg.norm(np.ptp(points, axis=0)) <= near_m:  # a tree would compare all with all
        _reject_crowd(points, near_m, settings)
    tree = scipy.spatial.cKDTree(points, leafsize=_LEAF_SIZE)
    k = min(settings.k, n - 1)
    precedence = np.arange(n)
    if settings.ties == "coordinates":
        precedence = np.argsort(np.lexsort(points.T[::-1]))
    distance, nearest = tree.query(points, k=min(k + 2, n))
    # If the k-th neighbour is farther than tau, all points within tau are neighbours already.
    crowded = np.flatnonzero(distance[:, k] <= near_m * (1 + _SLACK))
    _reject_crowd(points[crowded], near_m, settings)
    neighbours = _nearest(tree, points, k, distance, nearest, precedence)
    arcs: list[Arcs] = [(np.repeat(np.arange(n), k), neighbours.ravel())]
    if settings.edges == "union":
        near, other = _within(points[crowded], settings.tau_m)
        arcs.append((crowded[near], crowded[other]))
    src, dst = _unique_pairs(arcs, n)
    length_m = _distance(points, src, dst)
    edges = Edges(src.astype(np.int32), dst.astype(np.int32), length_m.astype(np.float32))
    if settings.edges == "union":
        return edges
    is_near = length_m <= settings.tau_m
    return Edges(edges.src[is_near], edges.dst[is_near], edges.length_m[is_near])


def _reject_crowd(points: FloatArray, near_m: float, settings: GraphSettings) -> None:
    """Raise a `StageError` if too many pairs of these points are within `near_m`."""
    n_pairs = _n_close_pairs(points, near_m)
    if n_pairs <= MAX_CLOSE_PAIRS:
        return
    voxel_m = smallest_voxel(points, lambda few: _n_close_pairs(few, near_m) <= MAX_CLOSE_PAIRS)
    thin = "" if voxel_m is None else f"set input.voxel_m={voxel_m:g}, which thins both sides alike, "
    raise StageError(
        f"expected at most {MAX_CLOSE_PAIRS} pairs of points within {near_m:g} m of each other, "
        f"got {n_pairs}; {thin}lower graph.tau_m (now {settings.tau_m:g}), or raise input.min_range_m"
    )


def _n_close_pairs(points: FloatArray, near_m: float) -> int:
    """Number of pairs of points within `near_m`, or of all pairs if there are few."""
    n = len(points)
    n_all = n * (n - 1) // 2
    if n_all <= MAX_CLOSE_PAIRS:
        return n_all
    tree = scipy.spatial.cKDTree(points, leafsize=_LEAF_SIZE)
    return (int(tree.count_neighbors(tree, near_m * (1 + _SLACK))) - n) // 2


def _nearest(
    tree: scipy.spatial.cKDTree,
    points: FloatArray,
    k: int,
    distance: FloatArray,
    nearest: IndexArray,
    precedence: IndexArray,
) -> IntArray:
    """The k nearest neighbours of each point, (n, k), ties by smaller precedence, from the answer of the tree."""
    neighbours = nearest[:, 1 : k + 1].astype(np.int32)
    is_open = nearest[:, 0] != np.arange(len(points))  # another point at the same place comes first
    if nearest.shape[1] > k + 1:
        is_open |= distance[:, k + 1] <= distance[:, k] * (1 + _SLACK)  # a tie at the k-th place
    for i in np.flatnonzero(is_open):  # again, from all points within the distance of the k-th
        within_m = distance[i, k] * (1 + _SLACK)
        ball = np.array(tree.query_ball_point(points[i], within_m), dtype=np.intp)
        ball = ball[ball != i]
        apart_m = _distance(points, np.full(len(ball), i), ball)
        neighbours[i] = ball[np.lexsort((precedence[ball], apart_m))[:k]]
    return neighbours


def _within(points: FloatArray, tau_m: float) -> IndexArray:
    """Pairs of points at most tau apart, (2, m)."""
    if len(points) < 2:
        return np.empty((2, 0), dtype=np.intp)
    tree = scipy.spatial.cKDTree(points)
    src, dst = tree.query_pairs(tau_m * (1 + _SLACK), output_type="ndarray").T
    inside = _distance(points, src, dst) <= tau_m
    return np.array([src[inside], dst[inside]])


def _unique_pairs(arcs: list[Arcs], n: int) -> tuple[IndexArray, IndexArray]:
    """Pairs of nodes with an arc in either direction in any list, smaller index first, ascending, each once."""
    codes = np.concatenate([np.minimum(a, b, dtype=np.int64) for a, b in arcs])
    codes *= n
    codes += np.concatenate([np.maximum(a, b) for a, b in arcs])
    codes.sort()
    codes = codes[np.append(True, codes[1:] != codes[:-1])]
    src = np.repeat(np.arange(n), np.diff(np.searchsorted(codes, np.arange(n + 1) * n)))
    return src, codes - src * n


def _distance(points: FloatArray, src: NDArray[np.integer], dst: NDArray[np.integer]) -> FloatArray:
    """|x_src - x_dst| in a fixed order of operations, so that ties are exact; symmetric to the last bit."""
    squared = np.zeros(len(src))
    for axis in points.T:
        along = np.ascontiguousarray(axis)
        step = along[src] - along[dst]
        step *= step
        squared += step
    return np.sqrt(squared, out=squared)
