"""NetLSD: difference of the heat diffusion on two graphs over time, from the traces of their heat kernels."""

from __future__ import annotations

import numpy as np
import scipy

from ...schemas.settings import MetricsSettings
from ..arrays import FloatArray
from ..linalg.heat import heat_trace
from ..linalg.laplacian import normalised_laplacian
from .interface import Baseline, Baselines, MatchedObject


def compare(matched: MatchedObject, settings: MetricsSettings) -> Baselines:
    """Baseline of `heat_trace_distance` of the whole object; None if a side has more than `heat_max_nodes`."""
    real, sim = matched.real, matched.sim
    n_most = max(len(real.points), len(sim.points))
    if n_most > settings.heat_max_nodes:
        reason = f"{n_most} points, metrics.heat_max_nodes allows {settings.heat_max_nodes}"
        return (Baseline("netlsd", None, reason),)
    times = np.geomspace(settings.heat_time_min, settings.heat_time_max, settings.heat_times)
    laplacians = normalised_laplacian(real.adjacency), normalised_laplacian(sim.adjacency)
    return (Baseline("netlsd", heat_trace_distance(*laplacians, times)),)


def heat_trace_distance(real: scipy.sparse.csr_matrix, sim: scipy.sparse.csr_matrix, times: FloatArray) -> float:
    """|h(real) - h(sim)|_2, h(t) = tr exp(-tL) / n at the given times; 0 for isospectral graphs.

    Tsitsulin, Mottin, Karras, Bronstein and Mueller, NetLSD: hearing the shape of a graph, KDD 2018, section 4, heat
    kernel, normalised by the empty graph of n nodes as in their code; from all eigenvalues, without interpolation. The
    graphs need no alignment and may differ in size.

    Parameters
    ----------
    real, sim : (n, n), (m, m) CSR float64, normalised Laplacians, at least one node each
    times : (k,) float64, positive; the authors take 250 from 0.01 to 100, log-spaced

    Examples
    --------
    >>> import numpy as np
    >>> edge, apart = scipy.sparse.csr_matrix([[1.0, -1], [-1, 1]]), scipy.sparse.csr_matrix((2, 2))
    >>> round(heat_trace_distance(edge, apart, np.array([0.5])), 6)  # 1 - (1 + 1 / e) / 2
    0.31606
    """
    return float(np.linalg.norm(heat_trace(real, times) - heat_trace(sim, times)))
