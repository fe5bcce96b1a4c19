"""Earth mover's distance: the smallest mean path of moving one side onto the other, for all points or aligned nodes."""

from __future__ import annotations

import math
import warnings

import numpy as np

from ...schemas.settings import MetricsSettings
from ..arrays import FloatArray
from ..linalg.assignment import assign_nodes
from .interface import Baseline, Baselines, MatchedObject

_MAX_PIVOTS = 10**12  # of the network simplex; far more than it needs, so that it always converges


def compare(matched: MatchedObject, settings: MetricsSettings) -> Baselines:
    """Baselines of all points, of the aligned nodes as given, and of the aligned nodes with both sides centred."""
    n_most = max(len(matched.real.points), len(matched.sim.points))
    exact_m = reason = None
    if n_most > settings.emd_max_points:
        reason = f"{n_most} points, metrics.emd_max_points allows {settings.emd_max_points}"
    elif (exact_m := earth_movers(matched.real.points, matched.sim.points)) is None:
        reason = "the network simplex ended without the optimum"
    real, sim = matched.aligned_points()
    # The alignment is the optimal assignment of the centred nodes, so it is not solved again for these.
    centred_m = aligned_distance(real - real.mean(axis=0), sim - sim.mean(axis=0))
    return (
        Baseline("emd_mean_m", exact_m, reason),
        Baseline("emd_kept_mean_m", aligned_distance(real, sim[assign_nodes(real, sim)])),
        Baseline("emd_centred_mean_m", centred_m),
    )


def earth_movers(a: FloatArray, b: FloatArray) -> float | None:
    """min_F sum_ij F_ij |a_i - b_j|, in metres; exact, for sets of any sizes; None if the solver finds no optimum.

    F_ij >= 0 is the mass moved from a_i to b_j: 1 / n leaves each point of a, 1 / m reaches each of b (Rubner, Tomasi
    and Guibas, The earth mover's distance as a metric for image retrieval, IJCV 2000, with equal weights). For equal
    sizes it is the mean distance under the best one-to-one assignment; the paper's equation "d_EMD" is the sum. Network
    simplex of POT (Bonneel, van de Panne, Paris and Heidrich, Displacement interpolation using Lagrangian mass
    transport, SIGGRAPH Asia 2011), which computes distances on demand instead of storing n m of them. The solver gets
    integer weights, so that the marginals hold without rounding.

    Parameters
    ----------
    a, b : (n, 3), (m, 3) float64, metres, not centred; at least one point each

    Examples
    --------
    >>> earth_movers(np.array([[0.0, 0, 0], [1, 0, 0]]), np.array([[1.0, 0, 2], [0, 0, 2]]))
    2.0
    >>> earth_movers(np.array([[0.0, 0, 0], [1, 0, 0]]), np.array([[1.0, 0, 0]]))
    0.5
    """
    import ot

    n, m = len(a), len(b)
    shares = math.lcm(n, m)  # a point of a has shares / n of them, one of b shares / m
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # the warning is also in the log
        total_m, log = ot.emd2_lazy(
            a,
            b,
            np.full(n, shares / n),
            np.full(m, shares / m),
            metric="euclidean",
            numItermax=_MAX_PIVOTS,
            log=True,
            return_matrix=False,
            center_dual=False,
        )
    return None if log["warning"] else float(total_m) / shares


def aligned_distance(a: FloatArray, b: FloatArray) -> float:
    """mean_i |a_i - b_i| in metres, for rows that are already assigned.

    Parameters
    ----------
    a, b : (n, 3) float64, metres, at least one point
    """
    return float(np.linalg.norm(a - b, axis=1).mean())
