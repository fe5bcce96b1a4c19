"""All eigenvalues, and the spectral norm, of sparse symmetric matrices.

Leaves to others: which matrices (`laplacian`), what their spectra say (`metrics`), how a large one becomes a narrow
band (`banding`).
"""

from __future__ import annotations

import numpy as np
from scipy import sparse
from scipy.linalg import eigvals_banded, eigvalsh
from scipy.sparse.linalg import ArpackNoConvergence, eigsh

from ..arrays import FloatArray
from . import band_reduction as banding

_BANDED_NODES = 1400  # from here the detour over a band is the faster way
_BAND_WIDTH = 32
_DENSE_NORM_NODES = 64


def eigenvalues(symmetric: sparse.csr_matrix) -> FloatArray:
    """All eigenvalues in ascending order, (n,) float64, to working precision.

    Parameters
    ----------
    symmetric : (n, n) CSR float64
    """
    if symmetric.shape[0] < _BANDED_NODES or not banding.is_available():
        found: FloatArray = eigvalsh(symmetric.toarray(order="F"), overwrite_a=True, check_finite=False)
    else:
        band = banding.reduce_to_band(symmetric, _BAND_WIDTH)
        found = eigvals_banded(band, lower=True, overwrite_a_band=True, check_finite=False)
    return found


def spectral_norm(symmetric: sparse.csr_matrix) -> float:
    """The largest absolute eigenvalue, by Lanczos iteration to machine precision.

    Parameters
    ----------
    symmetric : (n, n) CSR float64
    """
    n = symmetric.shape[0]
    if symmetric.count_nonzero() == 0:
        return 0.0
    if n > _DENSE_NORM_NODES:
        start = np.random.default_rng(0).standard_normal(n)
        try:
            return float(abs(eigsh(symmetric, k=1, which="LM", v0=start, return_eigenvectors=False)[0]))
        except ArpackNoConvergence:
            pass  # a crowded edge of the spectrum; the dense way always ends
    return float(np.max(np.abs(eigvalsh(symmetric.toarray(), check_finite=False))))
