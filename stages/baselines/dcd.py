"""The published density-aware Chamfer distance, DCD, which also weighs by counts; the paper's CDC is different."""

from __future__ import annotations

import numpy as np

from ...schemas.settings import MetricsSettings
from ..arrays import FloatArray
from ..reference import nearest_points
from .interface import Baseline, Baselines


def compare(real: FloatArray, sim: FloatArray, settings: MetricsSettings) -> Baselines:
    """Baseline of `density_aware_chamfer` with `dcd_alpha`, with a note on limited weights."""
    distance = density_aware_chamfer(real, sim, settings.dcd_alpha)
    if distance is None:
        return (Baseline("dcd", None, "the real points have no extent to scale by"),)
    (dcd, n_cut), n_real, n_sim = distance, len(real), len(sim)
    cut = f"{n_real} real and {n_sim} simulated points: {n_cut} of {n_real + n_sim} count weights cut at 1"
    return (Baseline("dcd", dcd, cut if n_cut else None),)


def density_aware_chamfer(real: FloatArray, sim: FloatArray, alpha: float) -> tuple[float, int] | None:
    """The published density-aware Chamfer distance, 0 to 1, and its limited weights; None for real points of no extent.

    DCD = 1/2 (mean_x (1 - w_x exp(-alpha |x - y'|^2)) + mean_y (1 - w_y exp(-alpha |y - x'|^2))), y' the nearest
    simulated point of x (for equal distances the first by x, y, z), w_x = (n / m) / (number of real points whose
    nearest is the same y'), and the other way round (Wu, Pan, Zhang, Wang, Liu and Lin, Density-aware Chamfer distance
    as a comprehensive metric for point cloud completion, NeurIPS 2021, section 3). For equal sizes w is 1 over the
    count. The squared distance and the factor n / m for unequal sizes are those of the authors' code (`calc_dcd`); the
    article writes |x - y'|. With that factor a weight can be above 1, and its term below 0: such weights are limited to
    1 and counted.

    Its authors chose alpha = 1000 for objects of unit size, so both sides are scaled by the diagonal of the real
    object's axis-aligned bounding box. This is not the score that the paper calls CDC (`metrics`).

    Parameters
    ----------
    real, sim : (n, 3), (m, 3) float64, metres, at least one point each
    alpha : per squared unit size
    """
    squared_m2 = float(np.linalg.norm(np.ptp(real, axis=0))) ** 2
    if not squared_m2 or np.isinf(alpha / squared_m2):  # no extent, or its square underflows
        return None
    from_real, n_cut_real = _one_way(real, sim, alpha / squared_m2)
    from_sim, n_cut_sim = _one_way(sim, real, alpha / squared_m2)
    return (from_real + from_sim) / 2, n_cut_real + n_cut_sim


def _one_way(x: FloatArray, y: FloatArray, alpha: float) -> tuple[float, int]:
    """Mean of the terms of x, and number of its weights that were limited."""
    nearest, distance = nearest_points(y, x)
    weight = len(x) / len(y) / np.bincount(nearest, minlength=len(y))[nearest]
    with np.errstate(over="ignore"):  # points at infinity have the term 1
        term = 1 - np.minimum(weight, 1.0) * np.exp(-alpha * distance**2)
    return float(term.mean()), int(np.count_nonzero(weight > 1.0))
