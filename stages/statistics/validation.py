"""Distance of two distributions of a score, in the unit of the score."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..arrays import FloatArray


@dataclass(frozen=True)
class DoubleValidation:
    """Double validation metric of a score, in its unit; None if a side has no value.

    bias : positive if the simulation's values are larger
    area : area between the distributions after removing the bias, 0 for equal shapes
    n_real, n_sim : number of values
    """

    bias: float | None
    area: float | None
    n_real: int
    n_sim: int


def area_validation_metric(real: FloatArray, sim: FloatArray) -> float | None:
    """Area between two empirical distribution functions, in the unit of the values; None without values, 0 at best.

    d = integral |F_real(x) - F_sim(x)| dx (Ferson and Oberkampf, Validation of imprecise probability models, Int. J.
    Reliability and Safety 2009), which is the Wasserstein distance of order 1. If one distribution is nowhere above the
    other it is the difference of the means.

    Parameters
    ----------
    real, sim : (n,), (m,) float64; NaN are left out

    Examples
    --------
    >>> area_validation_metric(np.array([0.0, 1.0]), np.array([1.0, 4.0]))
    2.0
    """
    from scipy import stats

    real = real[~np.isnan(real)]
    sim = sim[~np.isnan(sim)]
    return float(stats.wasserstein_distance(real, sim)) if len(real) and len(sim) else None


def double_validation_metric(real: FloatArray, sim: FloatArray) -> DoubleValidation:
    """Signed bias of the simulated values, and the area between both distributions without it.

    bias = mean(sim) - mean(real) = integral (F_real(x) - F_sim(x)) dx
    area = integral |F_real(x) - F_sim(x + bias)| dx

    The area validation metric in two parts, which distinguishes a model with an offset from one with another scatter
    (Rosenberger, Metrics for Specification, Validation, and Uncertainty Prediction for Credibility in
    Simulation of Active Perception Sensor Systems, dissertation, TU Darmstadt 2023; applied by Elster et al., Appl.
    Sci. 13, 11405, 2023). Implemented from their text, not from their equations: the mean as measure of the bias and
    its sign are fidpipe's interpretation. Two samples of one distribution also have an area above 0; it decreases with
    the square root of their sizes.

    Parameters
    ----------
    real, sim : (n,), (m,) float64; NaN are left out

    Examples
    --------
    >>> found = double_validation_metric(np.array([0.0, 1.0]), np.array([1.0, 4.0]))
    >>> found.bias, found.area
    (2.0, 1.0)
    """
    real = real[~np.isnan(real)]
    sim = sim[~np.isnan(sim)]
    if not len(real) or not len(sim):
        return DoubleValidation(None, None, len(real), len(sim))
    bias = float(sim.mean() - real.mean())
    return DoubleValidation(bias, area_validation_metric(real, sim - bias), len(real), len(sim))
