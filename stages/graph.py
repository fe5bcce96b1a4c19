"""Decides which object points are joined, and how long each edge is (paper, section "From Point Clouds to Graphs").

Leaves to others: what is made of the graph (`communities`, `laplacian`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from ..schemas.settings import GraphSettings
from .arrays import Float32Array, FloatArray, IndexArray, IntArray

_SLACK = 1e-9  # relative; candidates are looked for a little too far out, then judged by one exact formula
_SPARE = 4  # neighbours beyond the k-th that are looked at, so that ties there are seen


@dataclass(frozen=True)
class Edges:
    """Edges of an undirected graph, each once, sorted by (src, dst).

    src, dst : (m,) int32, node indices, src < dst
    length_m : (m,) float32, the weight
    """

    src: IntArray
    dst: IntArray
    length_m: Float32Array


def build_graph(points: FloatArray, settings: GraphSettings) -> Edges:
    """Edges between near points, weighted by distance.

    (i, j) is an edge if j is among the k nearest neighbours of i or i among those of j (ties at the k-th distance go
    to the smaller index), or if |x_i - x_j| <= tau; with `edges = "intersection"` both must hold.
    A_ij = |x_i - x_j|_2, rounded to float32 (paper, equation "main_graph": a distance, not a similarity).

    Parameters
    ----------
    points : (n, 3) float64, metres, finite
    settings : k, tau_m, edges

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
    tree = cKDTree(points)
    knn = _pairs_once(*_nearest(tree, points, min(settings.k, n - 1)), n)
    if settings.edges == "union":
        pairs = np.union1d(knn, _pairs_once(*_within(tree, points, settings.tau_m), n))
        src, dst = np.divmod(pairs, n)
        length_m = _distance(points, src, dst)
    else:
        src, dst = np.divmod(knn, n)
        length_m = _distance(points, src, dst)
        inside = length_m <= settings.tau_m
        src, dst, length_m = src[inside], dst[inside], length_m[inside]
    return Edges(src.astype(np.int32), dst.astype(np.int32), length_m.astype(np.float32))


def _nearest(tree: cKDTree, points: FloatArray, k: int) -> tuple[IndexArray, IndexArray]:
    """The directed pairs (i, j) where j is one of the k nearest neighbours of i, ties by smaller j."""
    n = len(points)
    width = min(k + 1 + _SPARE, n)
    _, found = tree.query(points, k=width)
    rows = np.repeat(np.arange(n), width)
    columns = found.ravel().astype(np.intp)
    distance = _distance(points, rows, columns).reshape(n, width)
    distance[rows.reshape(n, width) == found] = -1.0  # the point itself comes first and is cut off
    order = np.lexsort((found, distance))
    neighbours = np.take_along_axis(found, order, axis=1)
    distance = np.take_along_axis(distance, order, axis=1)
    chosen = neighbours[:, 1 : k + 1]
    if width < n:
        # A tie that reaches the edge of what was looked at may hide a smaller index beyond it.
        for i in np.flatnonzero(distance[:, -1] <= distance[:, k] * (1 + _SLACK)):
            chosen[i] = _nearest_of_one(tree, points, int(i), float(distance[i, k]), k)
    return np.repeat(np.arange(n), k), chosen.ravel().astype(np.intp)


def _nearest_of_one(tree: cKDTree, points: FloatArray, i: int, radius: float, k: int) -> IndexArray:
    ball = np.array(tree.query_ball_point(points[i], radius * (1 + _SLACK)), dtype=np.intp)
    ball = ball[ball != i]
    distance = _distance(points, np.full(len(ball), i), ball)
    nearest: IndexArray = ball[np.lexsort((ball, distance))[:k]]
    return nearest


def _within(tree: cKDTree, points: FloatArray, tau_m: float) -> tuple[IndexArray, IndexArray]:
    """The pairs (i, j) at most tau apart."""
    pairs = tree.query_pairs(tau_m * (1 + _SLACK), output_type="ndarray")
    src, dst = pairs[:, 0], pairs[:, 1]
    inside = _distance(points, src, dst) <= tau_m
    return src[inside], dst[inside]


def _distance(points: FloatArray, src: IndexArray, dst: IndexArray) -> FloatArray:
    """|x_src - x_dst|, always by the same order of operations, so that ties are ties; symmetric to the last bit."""
    d = points[src] - points[dst]
    d *= d
    distance: FloatArray = np.sqrt((d[:, 0] + d[:, 1]) + d[:, 2])
    return distance


def _pairs_once(src: IndexArray, dst: IndexArray, n: int) -> IndexArray:
    """Sorted codes low * n + high of undirected pairs, each once."""
    return np.unique(np.minimum(src, dst) * n + np.maximum(src, dst))
