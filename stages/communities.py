"""Partition of the points into objects: Louvain communities of the graph.

Paper, section "Object-Level Decomposition via Communities".
"""

from __future__ import annotations

import numpy as np
import scipy
from numpy.typing import NDArray

from ..schemas.settings import CommunitySettings
from .arrays import IntArray
from .linalg.subgraph import Edges, connected_nodes, upper_half

#: Smallest gain of modularity for another pass over a level, and for another level; of scikit-network.
TOLERANCE_OPTIMISATION = 1e-3
_TOLERANCE_AGGREGATION = 1e-7


def find_communities(
    n_nodes: int,
    edges: Edges,
    settings: CommunitySettings,
    *,
    order: IntArray | None = None,
) -> IntArray:
    """Community of each node, (n,) int32, that maximise modularity by Louvain's method; ids as of `canonical_ids`.

    Q = 1/2m sum_ij (A_ij - k_i k_j / 2m) delta(c_i, c_j), with A the edge lengths as stored (float32), k the weighted
    degrees, 2m their sum (Newman, PNAS 2006; Blondel et al., J. Stat. Mech. 2008). Both backends visit the nodes
    in a random order that `seed` fixes. Nodes without edges form separate communities. If no edge has a length (no
    edges, or all below 1e-45 m, the limit of float32) the communities are the connected components of the graph.

    Parameters
    ----------
    n_nodes : number of nodes
    edges : undirected, by node index
    settings : backend and seed
    order : (n,) int32, nodes in the order of the visits; by default a random order from the seed

    Examples
    --------
    >>> import numpy as np
    >>> ends = np.array([0, 2], np.int32), np.array([1, 3], np.int32)
    >>> find_communities(4, Edges(*ends, np.ones(2, np.float32)), CommunitySettings()).tolist()
    [0, 0, 1, 1]
    """
    if not edges.length_m.any():
        return canonical_ids(connected_nodes(n_nodes, edges.src, edges.dst), order)
    find = _scikit_network if settings.backend == "scikit-network" else _python_louvain
    return canonical_ids(find(n_nodes, edges, settings.seed, order), order)


def canonical_ids(labels: NDArray[np.integer], order: IntArray | None = None) -> IntArray:
    """Partition with ids by size descending, for equal sizes by smallest node, (n,) int32.

    Parameters
    ----------
    labels : (n,), any numbers
    order : (n,) int32, nodes in the order that defines the smallest one; by default ascending
    """
    order = np.arange(len(labels), dtype=np.int32) if order is None else order
    _, first, dense, size = np.unique(
        labels[order],
        return_index=True,
        return_inverse=True,
        return_counts=True,
    )
    new_id = np.argsort(np.lexsort((first, -size)))
    canonical = np.empty(len(labels), dtype=np.int32)
    canonical[order] = new_id[dense]
    return canonical


def _scikit_network(n_nodes: int, edges: Edges, seed: int, order: IntArray | None) -> IntArray:
    """Louvain in the node order of `shuffle_nodes=True`, but sorting the shuffled matrix costs a quarter."""
    if order is None:
        order = np.random.RandomState(seed).permutation(n_nodes).astype(np.int32)
    place = np.argsort(order).astype(np.int32)
    return _louvain(_shuffled_adjacency(n_nodes, edges, order, place))[place]


def _louvain(adjacency: scipy.sparse.csr_matrix) -> IntArray:
    """Community of each node: `sknetwork.clustering.Louvain` with its kernel, in a third of its memory.

    All numbers are those of the class, which makes three more copies of the matrix, and one of its
    indices in 64 bits.

    Parameters
    ----------
    adjacency : symmetric, sorted; overwritten
    """
    from sknetwork.clustering.louvain_core import optimize_core

    weights = adjacency @ np.ones(adjacency.shape[0])
    weights /= weights.sum()
    adjacency.data /= adjacency.data.sum()
    community = np.arange(adjacency.shape[0])
    while True:
        n = adjacency.shape[0]
        of_node = weights.astype(np.float32)
        labels, gain = optimize_core(
            np.arange(n, dtype=adjacency.indices.dtype),
            adjacency.indices,
            adjacency.indptr,
            adjacency.data.astype(np.float32),
            of_node,
            of_node.copy(),
            of_node.copy(),
            of_node.copy(),
            np.zeros(n, dtype=np.float32),
            adjacency.diagonal().astype(np.float32),
            1.0,
            TOLERANCE_OPTIMISATION,
        )
        _, labels = np.unique(labels, return_inverse=True)
        community = labels[community]
        starts = np.arange(n + 1, dtype=np.int32)
        membership = scipy.sparse.csr_matrix(
            (np.ones(n, bool), labels.astype(np.int32), starts)
        )
        adjacency = membership.T.tocsr() @ (adjacency @ membership)
        weights = membership.T @ weights
        if adjacency.shape[0] == 1 or gain <= _TOLERANCE_AGGREGATION:
            return community.astype(np.int32)


def _shuffled_adjacency(
    n_nodes: int,
    edges: Edges,
    order: IntArray,
    place: IntArray,
) -> scipy.sparse.csr_matrix:
    """Adjacency matrix with node order[i] in row i = place[order[i]]; a transposition sorts it in linear time."""
    half = upper_half(n_nodes, edges)[order]
    half.indices = place[half.indices]
    half.has_sorted_indices = False
    half = half.T.tocsr()
    adjacency = half + half.T.tocsr()
    adjacency.data = adjacency.data.astype(float)
    return adjacency


def _python_louvain(n_nodes: int, edges: Edges, seed: int, order: IntArray | None) -> IntArray:
    """Louvain with nodes and edges in ascending order by default; the seed fixes the library's order of visits."""
    import community
    import networkx

    place = np.arange(n_nodes) if order is None else np.argsort(order)
    ends = np.sort([place[edges.src], place[edges.dst]], axis=0)
    first = np.lexsort(ends[::-1])
    src, dst = ends[:, first]
    graph = networkx.Graph()
    graph.add_nodes_from(range(n_nodes))
    weight = edges.length_m[first].astype(float)
    graph.add_weighted_edges_from(zip(src.tolist(), dst.tolist(), weight.tolist(), strict=True))
    community_by_node = community.best_partition(graph, random_state=seed)
    return np.array([community_by_node[node] for node in place.tolist()], dtype=np.int32)
