"""F-score of a reconstruction: share of the points with a partner nearby."""

from __future__ import annotations

import numpy as np

from ...schemas.settings import MetricsSettings
from ..arrays import FloatArray
from ..coverage import nearest_distances
from .interface import Baseline, Baselines


def compare(real: FloatArray, sim: FloatArray, settings: MetricsSettings) -> Baselines:
    """Baseline of `f_score` at `f_score_distance_m`."""
    return (Baseline("f_score", f_score(real, sim, settings.f_score_distance_m)),)


def f_score(real: FloatArray, sim: FloatArray, distance_m: float) -> float:
    """2 P R / (P + R), 1 best, 0 without near points (Knapitsch et al., Tanks and Temples, ACM TOG 2017, section 4).

    Precision P is the share of simulated points nearer than `distance_m` to a real one, recall R the share of real
    points nearer than that to a simulated one.

    Parameters
    ----------
    real, sim : (n, 3), (m, 3) float64, metres, not centred, at least one point each
    distance_m : points at this distance or farther have no partner

    Examples
    --------
    >>> import numpy as np
    >>> f_score(np.array([[0.0, 0, 0], [9, 0, 0]]), np.array([[0.1, 0, 0], [0, 9, 0]]), 0.2)
    0.5
    """
    to_sim, to_real = nearest_distances(real, sim)
    recall, precision = float(np.mean(to_sim < distance_m)), float(np.mean(to_real < distance_m))
    return 2 * precision * recall / (precision + recall) if precision + recall else 0.0
