"""Graphs in memory: edges, adjacency matrix, connected components, and the subgraph of one object."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

from ..arrays import Float32Array, FloatArray, IndexArray, IntArray, rows_by_id

_NEAREST = 16  #: neighbours by which `connected_points` links most points at once


@dataclass(frozen=True)
class Edges:
    """Edges of an undirected graph, each once, sorted by (src, dst).

    src, dst : (m,) int32, node indices, src < dst
    length_m : (m,) float32, the weight
    """

    src: IntArray
    dst: IntArray
    length_m: Float32Array


@dataclass(frozen=True)
class Subgraph:
    """Points of one object and the edges among them.

    point_ids : (n,) int32, ascending
    points : (n, 3) float64, metres
    adjacency : (n, n) CSR float64, symmetric, edge lengths
    """

    point_ids: IntArray
    points: FloatArray
    adjacency: scipy.sparse.csr_matrix


def adjacency(n_nodes: int, edges: Edges) -> scipy.sparse.csr_matrix:
    """Symmetric weighted adjacency matrix, (n, n) CSR float64 with sorted indices; all zero without edges."""
    half = upper_half(n_nodes, edges).astype(float)
    return half + half.T.tocsr()


def upper_half(n_nodes: int, edges: Edges) -> scipy.sparse.csr_matrix:
    """Part of the adjacency matrix above its diagonal, (n, n) CSR float32."""
    starts = np.searchsorted(edges.src, np.arange(n_nodes + 1))
    return scipy.sparse.csr_matrix(
        (edges.length_m, edges.dst, starts), shape=(n_nodes, n_nodes)
    )


def connected_nodes(
    n_nodes: int, src: NDArray[np.integer], dst: NDArray[np.integer]
) -> IndexArray:
    """Connected component of each node, (n,), numbered from 0.

    Parameters
    ----------
    src, dst : (m,), nodes of each edge

    Examples
    --------
    >>> import numpy as np
    >>> connected_nodes(3, np.array([0]), np.array([2])).tolist()
    [0, 1, 0]
    """
    is_linked = np.ones(len(src), dtype=bool)
    graph = scipy.sparse.coo_matrix((is_linked, (src, dst)), shape=(n_nodes, n_nodes))
    return scipy.sparse.csgraph.connected_components(graph, directed=False)[1]


def connected_points(points: FloatArray, link_m: float) -> IndexArray:
    """Connected component of each point, (n,), in any numbering, with points at most `link_m` apart linked.

    Links to the 16 nearest neighbours give nearly all components. A link that is still missing joins two points that
    both have more neighbours than these. Components of such points are numbered; for each bit of the numbers, those
    with a 0 are linked to the nearest point with a 1, until no link is left. Memory is O(n), however dense the points.

    Parameters
    ----------
    points : (n, 3) float64, metres
    link_m : inclusive

    Examples
    --------
    >>> import numpy as np
    >>> connected_points(np.array([[0.0, 0, 0], [9, 0, 0], [0.5, 0, 0]]), 0.6).tolist()
    [0, 1, 0]
    """
    n = len(points)
    if not n:
        return np.empty(0, dtype=int)
    bound = link_m * (1 + 1e-9)  # scipy's is exclusive
    k = np.arange(1, min(n, _NEAREST + 1) + 1)  # the point itself is the first
    distance_m, nearest = scipy.spatial.cKDTree(points).query(
        points, k, distance_upper_bound=bound
    )
    is_linked = distance_m <= link_m
    labels = connected_nodes(n, np.nonzero(is_linked)[0], nearest[is_linked])
    dense = np.flatnonzero(is_linked[:, -1])
    n_before = -1
    while True:
        components, numbers = np.unique(labels[dense], return_inverse=True)
        if len(components) in (n_before, 0, 1):
            return labels
        n_before = len(components)
        for bit in range((n_before - 1).bit_length()):
            is_one = (numbers >> bit) % 2 == 1
            zeros = dense[~is_one]
            ones = dense[is_one]
            tree = scipy.spatial.cKDTree(points[ones])
            distance_m, nearest = tree.query(points[zeros], distance_upper_bound=bound)
            is_linked = distance_m <= link_m
            src = labels[zeros[is_linked]]
            dst = labels[ones[nearest[is_linked]]]
            labels = connected_nodes(n, src, dst)[labels]


def split_by_community(
    point_ids: IntArray,
    points: FloatArray,
    edges: Edges,
    labels: IntArray,
    wanted: Iterable[int],
) -> dict[int, Subgraph]:
    """The induced subgraph of each requested community, by community id; edges between communities are in none.

    Parameters
    ----------
    point_ids : (n,) int32, ascending, of the nodes
    points : (n, 3) float64, metres
    edges : by node index
    labels : (n,) int32, community of each node
    wanted : community ids

    Examples
    --------
    >>> import numpy as np
    >>> ids, lengths = np.arange(3, dtype=np.int32), np.ones(2, dtype=np.float32)
    >>> path = Edges(src=ids[:2], dst=ids[1:], length_m=lengths)
    >>> split_by_community(ids, np.zeros((3, 3)), path, np.array([0, 0, 1]), [0])[0].adjacency.toarray().tolist()
    [[0.0, 1.0], [1.0, 0.0]]
    """
    nodes_of = rows_by_id(labels)
    of_src = labels[edges.src]
    edges_of = rows_by_id(np.where(of_src == labels[edges.dst], of_src, -1), len(nodes_of))
    index_inside = np.empty(len(labels), dtype=np.int32)
    subgraphs = {}
    for community in wanted:
        nodes = nodes_of[community]
        rows = edges_of[community]
        index_inside[nodes] = np.arange(len(nodes), dtype=np.int32)
        src = index_inside[edges.src[rows]]
        dst = index_inside[edges.dst[rows]]
        weights = adjacency(len(nodes), Edges(src, dst, edges.length_m[rows]))
        subgraphs[community] = Subgraph(point_ids[nodes], points[nodes], weights)
    return subgraphs
