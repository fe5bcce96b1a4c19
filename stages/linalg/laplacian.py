"""The normalised graph Laplacian, and the part of a graph that belongs to one object.

Shared by `selection` and `metrics`.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from scipy import sparse

from ..arrays import FloatArray, IndexArray, IntArray
from ..communities import adjacency
from ..graph import Edges


@dataclass(frozen=True)
class Subgraph:
    """One object: its points and the edges among them.

    point_ids : (n,) int32, ascending
    points : (n, 3) float64, metres
    adjacency : (n, n) CSR float64, symmetric, edge lengths
    """

    point_ids: IntArray
    points: FloatArray
    adjacency: sparse.csr_matrix


def split_by_community(
    point_ids: IntArray, points: FloatArray, edges: Edges, labels: IntArray, wanted: Iterable[int]
) -> dict[int, Subgraph]:
    """The induced subgraph of each wanted community, by community id.

    Parameters
    ----------
    point_ids : (n,) int32, ascending, of the nodes
    points : (n, 3) float64, metres
    edges : by node index
    labels : (n,) int32, community of each node
    wanted : community ids
    """
    inside = np.flatnonzero(labels[edges.src] == labels[edges.dst])
    by_community = inside[np.argsort(labels[edges.src[inside]], kind="stable")]
    edge_ends = np.searchsorted(labels[edges.src[by_community]], np.arange(int(labels.max()) + 2))
    nodes_in_order = np.argsort(labels, kind="stable")
    node_ends = np.searchsorted(labels[nodes_in_order], np.arange(int(labels.max()) + 2))
    index_inside = np.empty(len(labels), dtype=np.int32)
    subgraphs = {}
    for community in wanted:
        nodes = nodes_in_order[node_ends[community] : node_ends[community + 1]]
        own = by_community[edge_ends[community] : edge_ends[community + 1]]
        index_inside[nodes] = np.arange(len(nodes), dtype=np.int32)
        own_edges = Edges(index_inside[edges.src[own]], index_inside[edges.dst[own]], edges.length_m[own])
        subgraphs[community] = Subgraph(point_ids[nodes], points[nodes], adjacency(len(nodes), own_edges))
    return subgraphs


def normalised_laplacian(weights: sparse.csr_matrix) -> sparse.csr_matrix:
    """L = I - D^-1/2 A D^-1/2 of a symmetric adjacency matrix (paper, equation "norm_lap").

    A node without edges has a zero row and 0 on the diagonal (Chung, Spectral Graph Theory, 1997).

    Parameters
    ----------
    weights : (n, n) CSR float64, symmetric, no negative entry

    Examples
    --------
    >>> from scipy import sparse
    >>> normalised_laplacian(sparse.csr_matrix([[0.0, 4, 0], [4, 0, 0], [0, 0, 0]])).toarray().tolist()
    [[1.0, -1.0, 0.0], [-1.0, 1.0, 0.0], [0.0, 0.0, 0.0]]
    """
    degree = np.asarray(weights.sum(axis=1)).ravel()
    joined = degree > 0
    scale = np.zeros(len(degree))
    scale[joined] = 1.0 / np.sqrt(degree[joined])
    scaled = weights.copy()
    scaled.data *= np.repeat(scale, np.diff(weights.indptr))
    scaled.data *= scale[weights.indices]
    return sparse.diags_array(joined.astype(np.float64)).tocsr() - scaled


def induced_laplacian(graph: Subgraph, nodes: IndexArray) -> sparse.csr_matrix:
    """The normalised Laplacian of the subgraph on `nodes`, rows and columns in that order."""
    return normalised_laplacian(graph.adjacency[nodes][:, nodes])
