"""How differently heat spreads on two graphs: heat-trace signatures (NetLSD), and the bounded diffusion change r_H.

Leaves to others: which graphs (`baselines`), Laplacians (`laplacian`), eigenvalues and norms (`spectrum`).
"""

from __future__ import annotations

import numpy as np
from scipy import sparse
from scipy.linalg import eigh
from scipy.sparse.linalg import ArpackNoConvergence, LinearOperator, eigsh

from ..arrays import FloatArray
from ..linalg.spectrum import eigenvalues, spectral_norm

_DENSE_NODES = 64


def heat_trace_distance(real: sparse.csr_matrix, sim: sparse.csr_matrix, times: FloatArray) -> float:
    """|h(real) - h(sim)|_2, h(t) = tr exp(-tL) / n over the given times; 0 for isospectral graphs.

    Tsitsulin, Mottin, Karras, Bronstein and Mueller, NetLSD: hearing the shape of a graph, KDD 2018, section 4, heat
    kernel, normalised by the empty graph of n nodes as in their code; from all eigenvalues, nothing is interpolated.
    Needs no alignment and no equal sizes.

    Parameters
    ----------
    real, sim : (n, n), (m, m) CSR float64, normalised Laplacians
    times : (k,) float64, positive; the authors take 250 from 0.01 to 100, log-spaced

    Examples
    --------
    >>> import numpy as np
    >>> from scipy import sparse
    >>> edge, apart = sparse.csr_matrix([[1.0, -1], [-1, 1]]), sparse.csr_matrix((2, 2))
    >>> round(heat_trace_distance(edge, apart, np.array([0.5])), 6)  # 1 - (1 + 1 / e) / 2
    0.31606
    """
    traces = []
    for laplacian in (real, sim):
        spectrum = eigenvalues(laplacian)
        traces.append(np.array([np.exp(-t * spectrum).mean() for t in times]))
    return float(np.linalg.norm(traces[0] - traces[1]))


def diffusion_change(real: sparse.csr_matrix, sim: sparse.csr_matrix, t: float, identical_change: float) -> float:
    """r_H = |dH_t|_2 / (t |dL|_2), dH_t = exp(-t L_sim) - exp(-t L_real), 0 to 1.

    "Bounded diffusion change" in the source of the paper (equation "rH", commented out there). The bound holds because
    exp(-t .) changes by no more than t |dL| between matrices without negative eigenvalues (Duhamel's formula). The
    norms are largest absolute eigenvalues by Lanczos iteration; that of dH_t is applied to vectors as a power series.
    Where |dL| is at most `identical_change` the result is 0, as for r_lambda.

    Parameters
    ----------
    real, sim : (n, n) CSR float64, normalised Laplacians, nodes aligned
    t : diffusion time
    identical_change : see above
    """
    change = spectral_norm(sim - real)
    if change <= identical_change:
        return 0.0
    return min(1.0, _heat_change(real, sim, t) / (t * change))


def _heat_change(real: sparse.csr_matrix, sim: sparse.csr_matrix, t: float) -> float:
    """|exp(-t sim) - exp(-t real)|_2."""
    n = real.shape[0]
    if n <= _DENSE_NODES:
        return float(np.linalg.norm(_dense_heat(sim, t) - _dense_heat(real, t), 2))
    similarities = [sparse.eye_array(n, format="csr") - laplacian for laplacian in (real, sim)]
    n_terms = _terms_of_heat(t)

    def apply(vector: FloatArray) -> FloatArray:
        kernel_real, kernel_sim = (_heat_of(similarity, vector.ravel(), t, n_terms) for similarity in similarities)
        return kernel_sim - kernel_real

    start = np.random.default_rng(0).standard_normal(n)
    operator = LinearOperator((n, n), matvec=apply, dtype=np.float64)
    try:
        return float(abs(eigsh(operator, k=1, which="LM", v0=start, return_eigenvectors=False)[0]))
    except ArpackNoConvergence:  # a crowded edge of the spectrum; the dense way always ends
        return float(np.linalg.norm(_dense_heat(sim, t) - _dense_heat(real, t), 2))


def _heat_of(similarity: sparse.csr_matrix, vector: FloatArray, t: float, n_terms: int) -> FloatArray:
    """exp(-tL) v = e^-t sum_k t^k / k! S^k v with S = I - L; |S| <= 1, so that no term outgrows its weight."""
    term = vector * np.exp(-t)
    total = term.copy()
    for k in range(1, n_terms):
        term = similarity @ term * (t / k)
        total += term
    return np.asarray(total)


def _terms_of_heat(t: float) -> int:
    """How many terms until the weights e^-t t^k / k! are below the rounding of their sum, which is 1."""
    k, weight = 0, float(np.exp(-t))
    while k <= t or weight > np.finfo(np.float64).eps:
        k += 1
        weight *= t / k
    return k


def _dense_heat(laplacian: sparse.csr_matrix, t: float) -> FloatArray:
    values, vectors = eigh(laplacian.toarray(), check_finite=False)
    heat: FloatArray = (vectors * np.exp(-t * values)) @ vectors.T
    return heat
