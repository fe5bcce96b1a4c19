"""All eigenvalues, and the spectral norm, of sparse symmetric matrices."""

from __future__ import annotations

import numpy as np
import scipy

from ..arrays import FloatArray
from .band_reduction import reduce_to_band, scipy_kernels

#: From this many nodes on the detour over a band is the faster way.
BANDED_FROM_NODES = 1400
BAND_WIDTH = 32  #: affects the time, not the result
_DENSE_NORM_NODES = 64


def eigenvalues(symmetric: scipy.sparse.csr_matrix) -> FloatArray:
    """All eigenvalues in ascending order, (n,) float64, to working precision.

    Small matrices go to LAPACK's dense solver; large ones are first reduced to a narrow band. Both ways are backward
    stable and agree to rounding. Without the BLAS routines of the band reduction the dense solver is used for all.

    Parameters
    ----------
    symmetric : (n, n) CSR float64, n at least 1
    """
    kernels = scipy_kernels() if symmetric.shape[0] >= BANDED_FROM_NODES else None
    if kernels is None:
        dense = symmetric.toarray(order="F")
        return scipy.linalg.eigvalsh(dense, overwrite_a=True, check_finite=False)
    band = reduce_to_band(symmetric, BAND_WIDTH, kernels)
    return scipy.linalg.eigvals_banded(
        band, lower=True, overwrite_a_band=True, check_finite=False
    )


def spectral_norm(symmetric: scipy.sparse.csr_matrix) -> float:
    """Largest absolute eigenvalue, by Lanczos iteration to machine precision; 0 for a matrix of zeros.

    ARPACK treats eigenvalues below eps^(2/3) as if they were of that size. So the matrix is scaled by the power of two
    that makes its largest entry about 1: no digit is lost even for small entries.

    Parameters
    ----------
    symmetric : (n, n) CSR float64
    """
    if symmetric.count_nonzero() == 0:
        return 0.0
    if symmetric.shape[0] > _DENSE_NORM_NODES:
        exponent = np.frexp(abs(symmetric.data).max())[1]
        scaled = symmetric * np.ldexp(1.0, -exponent)
        start = np.random.default_rng(0).standard_normal(symmetric.shape[0])
        try:
            values = scipy.sparse.linalg.eigsh(scaled, 1, v0=start, return_eigenvectors=False)
            return float(np.ldexp(abs(values[0]), exponent))
        except scipy.sparse.linalg.ArpackNoConvergence:
            pass  # at a crowded edge of the spectrum; the dense solver always converges
    return float(np.max(np.abs(scipy.linalg.eigvalsh(symmetric.toarray(), check_finite=False))))
