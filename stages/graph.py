"""Graph of the object points: edges and their lengths (paper, section "From Point Clouds to Graphs")."""

from __future__ import annotations

import numpy as np
import scipy
from numpy.typing import NDArray

from ..schemas.errors import StageError
from ..schemas.settings import GraphSettings
from .arrays import BoolArray, FloatArray, IndexArray, IntArray
from .linalg.subgraph import Edges, Subgraph, adjacency
from .thinning import smallest_voxel

#: More pairs of points within tau are rejected: their graph would need about 10 GB.
MAX_CLOSE_PAIRS = 10**8
_SLACK = 1e-9  # relative; the tree's distances may differ from ours in the last bits
_LEAF_SIZE = 32
_TILE_POINTS = 50_000  # affects the memory, not the result
_TILE_PAIRS = 2**18


def graph_of(points: FloatArray, settings: GraphSettings) -> Subgraph:
    """Points as one object, with the graph that they have without any others.

    Parameters
    ----------
    points : (n, 3) float64, metres
    """
    edges = build_graph(points, settings)
    return Subgraph(
        np.arange(len(points), dtype=np.int32), points, adjacency(len(points), edges)
    )


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
    k = min(settings.k, n - 1)
    neighbours, farthest_m = _nearest(points, k, near_m, settings)
    pairs = _pairs_of_neighbours(neighbours)
    if settings.edges == "union":
        # If the k-th neighbour is farther than tau, all points within tau are neighbours already.
        crowded = np.flatnonzero(farthest_m <= near_m * (1 + _SLACK))
        pairs = pairs + _pairs_within(points, crowded, near_m)
    src = np.repeat(np.arange(n, dtype=np.int32), np.diff(pairs.indptr))
    dst = pairs.indices
    length_m = np.empty(len(src), dtype=np.float32)
    is_near = np.empty(len(src), dtype=bool)
    most_m = np.inf if settings.edges == "union" else settings.tau_m
    for start in range(0, len(src), _TILE_PAIRS):
        tile = slice(start, start + _TILE_PAIRS)
        length_m[tile] = distance_m = _distance(points, src[tile], dst[tile])
        is_near[tile] = distance_m <= most_m
    if is_near.all():
        return Edges(src, dst, length_m)
    return Edges(src[is_near], dst[is_near], length_m[is_near])


def _reject_crowd(points: FloatArray, near_m: float, settings: GraphSettings) -> None:
    """Raise a `StageError` if too many pairs of these points are within `near_m`."""
    n_pairs = _n_close_pairs(points, near_m)
    if n_pairs <= MAX_CLOSE_PAIRS:
        return
    voxel_m = smallest_voxel(points, lambda few: _n_close_pairs(few, near_m) <= MAX_CLOSE_PAIRS)
    thin = f"set input.voxel_m={voxel_m:g}, which thins both sides alike, " if voxel_m else ""
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
    points: FloatArray, k: int, near_m: float, settings: GraphSettings
) -> tuple[IntArray, FloatArray]:
    """The k nearest neighbours of each point, (n, k) ascending, and the distance of the farthest in the tree, (n,).

    Raises
    ------
    StageError
        Too many points have all these within `near_m`.
    """
    n = len(points)
    tree = scipy.spatial.cKDTree(points, leafsize=_LEAF_SIZE, balanced_tree=False)
    neighbours = np.empty((n, k), dtype=np.int32)
    farthest_m = np.empty(n)
    is_open = np.empty(n, dtype=bool)
    for start in range(0, n, _TILE_POINTS):
        rows = np.arange(start, min(start + _TILE_POINTS, n))
        distance_m, nearest = tree.query(points[rows], k=min(k + 2, n))
        neighbours[rows] = nearest[:, 1 : k + 1]
        farthest_m[rows] = distance_m[:, k]
        is_open[rows] = nearest[:, 0] != rows  # another point at the same place comes first
        if nearest.shape[1] > k + 1:  # a tie at the k-th place
            is_open[rows] |= distance_m[:, k + 1] <= distance_m[:, k] * (1 + _SLACK)
    _reject_crowd(points[farthest_m <= near_m * (1 + _SLACK)], near_m, settings)
    precedence = np.arange(n)
    if settings.ties == "coordinates":
        precedence = np.argsort(np.lexsort(points.T[::-1]))
    for i in np.flatnonzero(is_open):  # again, from all points within the distance of the k-th
        within_m = farthest_m[i] * (1 + _SLACK)
        ball = np.array(tree.query_ball_point(points[i], within_m), dtype=int)
        ball = ball[ball != i]
        apart_m = _distance(points, np.full(len(ball), i), ball)
        neighbours[i] = ball[np.lexsort((precedence[ball], apart_m))[:k]]
    neighbours.sort(axis=1)
    return neighbours, farthest_m


def _pairs_of_neighbours(neighbours: IntArray) -> scipy.sparse.csr_matrix:
    """Pairs of points of which either is a neighbour of the other, (n, n) CSR bool, smaller index in the row.

    Parameters
    ----------
    neighbours : (n, k), ascending in each row
    """
    is_later = neighbours > np.arange(len(neighbours))[:, None]
    return _matrix_of(neighbours, is_later) + _matrix_of(neighbours, ~is_later).T.tocsr()


def _matrix_of(neighbours: IntArray, is_chosen: BoolArray) -> scipy.sparse.csr_matrix:
    """Some neighbours of each point, (n, n) CSR bool."""
    n = len(neighbours)
    starts = np.append(0, np.cumsum(np.count_nonzero(is_chosen, axis=1)))
    ends = neighbours[is_chosen]
    return scipy.sparse.csr_matrix((np.ones(len(ends), bool), ends, starts), shape=(n, n))


def _pairs_within(
    points: FloatArray, chosen: IndexArray, tau_m: float
) -> scipy.sparse.csr_matrix:
    """Pairs of chosen points at most tau apart, (n, n) CSR bool, smaller index in the row.

    The points are taken in tiles along the longest axis, each with those that follow within tau.
    """
    n = len(points)
    along = points[chosen, np.argmax(np.ptp(points, axis=0))]
    chosen = chosen[np.argsort(along, kind="stable")]
    along = np.sort(along)
    all_src = [np.empty(0, dtype=np.int32)]
    all_dst = [np.empty(0, dtype=np.int32)]
    for start in range(0, len(chosen), _TILE_POINTS):
        end = min(start + _TILE_POINTS, len(chosen))
        last = np.searchsorted(along, along[end - 1] + tau_m * (1 + _SLACK), side="right")
        tile = chosen[start:last]
        tree = scipy.spatial.cKDTree(points[tile])
        first, second = tree.query_pairs(tau_m * (1 + _SLACK), output_type="ndarray").T
        is_of_tile = first < end - start
        src = tile[first[is_of_tile]]
        dst = tile[second[is_of_tile]]
        is_near = _distance(points, src, dst) <= tau_m
        ends = src[is_near].astype(np.int32), dst[is_near].astype(np.int32)
        all_src.append(np.minimum(*ends))
        all_dst.append(np.maximum(*ends))
    src, dst = np.concatenate(all_src), np.concatenate(all_dst)
    del all_src, all_dst
    is_pair = np.ones(len(src), dtype=bool)
    pairs = scipy.sparse.coo_matrix((is_pair, (src, dst)), shape=(n, n)).tocsr()
    pairs.sort_indices()
    return pairs


def _distance(
    points: FloatArray, src: NDArray[np.integer], dst: NDArray[np.integer]
) -> FloatArray:
    """|x_src - x_dst| in a fixed order of operations, so that ties are exact; symmetric to the last bit."""
    squared = np.zeros(len(src))
    for axis in points.T:
        along = np.ascontiguousarray(axis)
        step = along.take(src) - along.take(dst)
        step *= step
        squared += step
    return np.sqrt(squared, out=squared)
