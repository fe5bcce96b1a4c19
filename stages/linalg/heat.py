"""The heat kernel exp(-tL) of a graph: row sums, and the change between two graphs.

With S = I - L, the normalised adjacency matrix, exp(-tL) v = e^-t sum_k t^k / k! S^k v. No eigenvalue of S is larger
than 1, so that no term outgrows its weight; the exponential itself, a dense matrix, is never formed for many nodes.
"""

from __future__ import annotations

from itertools import count

import numpy as np
import scipy

from ..arrays import FloatArray
from .spectrum import lanczos_norm

_DENSE_NODES = 64  # up to here the dense kernel is the faster one


def heat_row_sums(laplacian: scipy.sparse.csr_matrix, t: float) -> FloatArray:
    """Row sums exp(-tL) 1 of the heat kernel, (n,) float64 (paper, equations "heat" and "influence").

    S has no negative entry and neither has the vector of ones, so that no term of the series cancels another; terms
    are added until they are below the rounding of the sum. An isolated node (L_ii = 0) has the sum 1.

    Parameters
    ----------
    laplacian : (n, n) CSR float64, normalised Laplacian
    t : diffusion time, above 0, at most 100

    Examples
    --------
    >>> heat_row_sums(scipy.sparse.csr_matrix([[1.0, -1, 0], [-1, 1, 0], [0, 0, 0]]), 1.0).round(12).tolist()
    [1.0, 1.0, 1.0]
    """
    n = laplacian.shape[0]
    similarity = scipy.sparse.eye_array(n, format="csr") - laplacian
    term = np.full(n, np.exp(-t))
    total = term.copy()
    k = 0
    while k <= t or term.max() > np.finfo(np.float64).eps * total.min():
        k += 1
        term = similarity @ term * (t / k)
        total += term
    return total


def heat_change(real: scipy.sparse.csr_matrix, sim: scipy.sparse.csr_matrix, t: float) -> float:
    """|exp(-t L_sim) - exp(-t L_real)|_2, the spectral norm of the change of the heat kernel.

    The largest absolute eigenvalue by Lanczos iteration, the change being applied to vectors; up to 64 nodes, and
    if the iteration does not converge, from dense kernels.

    Parameters
    ----------
    real, sim : (n, n) CSR float64, normalised Laplacians, nodes aligned, n at least 1
    t : diffusion time
    """
    n = real.shape[0]
    if n <= _DENSE_NODES:
        return _dense_change(real, sim, t)
    similarity_real = scipy.sparse.eye_array(n, format="csr") - real
    similarity_sim = scipy.sparse.eye_array(n, format="csr") - sim

    def apply(vector: FloatArray) -> FloatArray:
        heat_real = _heat(similarity_real, vector.ravel(), t)
        heat_sim = _heat(similarity_sim, vector.ravel(), t)
        return heat_sim - heat_real

    change = scipy.sparse.linalg.LinearOperator((n, n), matvec=apply, dtype=np.float64)
    norm = lanczos_norm(change)
    return _dense_change(real, sim, t) if norm is None else norm


def _heat(similarity: scipy.sparse.csr_matrix, vector: FloatArray, t: float) -> FloatArray:
    """exp(-tL) v with S = I - L, by its series up to weights e^-t t^k / k! below the rounding of their sum, 1."""
    weight = float(np.exp(-t))
    term = vector * weight
    total = term.copy()
    for k in count(1):
        weight *= t / k
        if k > t and weight <= np.finfo(np.float64).eps:
            break
        term = similarity @ term * (t / k)
        total += term
    return np.asarray(total)


def _dense_change(real: scipy.sparse.csr_matrix, sim: scipy.sparse.csr_matrix, t: float) -> float:
    return float(np.linalg.norm(_dense_heat(sim, t) - _dense_heat(real, t), 2))


def _dense_heat(laplacian: scipy.sparse.csr_matrix, t: float) -> FloatArray:
    values, vectors = scipy.linalg.eigh(laplacian.toarray(), check_finite=False)
    return (vectors * np.exp(-t * values)) @ vectors.T
