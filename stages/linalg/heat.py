"""Row sums of the heat kernel exp(-tL) of a graph.

With S = I - L, the normalised adjacency matrix, exp(-tL) v = e^-t sum_k t^k / k! S^k v. No eigenvalue of S is larger
than 1, so that no term outgrows its weight; the exponential itself, a dense matrix, is never formed for many nodes.
"""

from __future__ import annotations

import numpy as np
import scipy

from ..arrays import FloatArray


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
