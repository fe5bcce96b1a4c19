"""Normalised Laplacian of a weighted graph, and of the subgraph induced by some nodes."""

from __future__ import annotations

import numpy as np
import scipy

from ..arrays import IndexArray
from .subgraph import Subgraph


def normalised_laplacian(weights: scipy.sparse.csr_matrix) -> scipy.sparse.csr_matrix:
    """L = I - D^-1/2 A D^-1/2 of a symmetric adjacency matrix, (n, n) CSR (paper, equation "norm_lap").

    A node without edges has a zero row and 0 on the diagonal (Chung, Spectral Graph Theory, 1997).

    Parameters
    ----------
    weights : (n, n) CSR float64, symmetric, no negative entry

    Examples
    --------
    >>> normalised_laplacian(scipy.sparse.csr_matrix([[0.0, 4, 0], [4, 0, 0], [0, 0, 0]])).toarray().tolist()
    [[1.0, -1.0, 0.0], [-1.0, 1.0, 0.0], [0.0, 0.0, 0.0]]
    """
    degree = np.asarray(weights.sum(axis=1)).ravel()
    joined = degree > 0
    scale = np.zeros(len(degree))
    scale[joined] = 1.0 / np.sqrt(degree[joined])
    scaled = weights.copy()
    scaled.data *= np.repeat(scale, np.diff(weights.indptr))
    scaled.data *= scale[weights.indices]
    return scipy.sparse.diags_array(joined.astype(float)).tocsr() - scaled


def induced_laplacian(graph: Subgraph, nodes: IndexArray) -> scipy.sparse.csr_matrix:
    """Normalised Laplacian of the subgraph on some nodes, (k, k) CSR float64.

    Degrees are those of the subgraph, so that a node whose neighbours were all left out is isolated.

    Parameters
    ----------
    graph : one object
    nodes : (k,) indices into it; rows and columns of the result are in this order
    """
    return normalised_laplacian(graph.adjacency[nodes][:, nodes])
