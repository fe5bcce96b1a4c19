"""Distance of two distributions of a score, in the unit of the score."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..arrays import FloatArray


class DoubleValidation(NamedTuple):
    """Double validation metric of a score, in its unit; None if a side has no value.

    bias : positive if the simulation's values are larger
    area : area between the distributions after removing the bias, 0 for equal shapes
    """

    bias: float | None
    area: float | None


def double_validation_metric(real: FloatArray, sim: FloatArray) -> DoubleValidation:
    """Signed bias of the simulated values, and the area between both distributions without it.

    bias = mean(sim) - mean(real) = integral (F_real(x) - F_sim(x)) dx
    area = integral |F_real(x) - F_sim(x + bias)| dx, the Wasserstein distance of order 1

    The area validation metric (Ferson and Oberkampf, Validation of imprecise probability models, Int. J. Reliability
    and Safety 2009) in two parts, which distinguishes a model with an offset from one with another scatter
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
    from scipy import stats

    real = real[~np.isnan(real)]
    sim = sim[~np.isnan(sim)]
    if not len(real) or not len(sim):
        return DoubleValidation(None, None)
    bias = float(sim.mean() - real.mean())
    area = float(stats.wasserstein_distance(real, sim - bias))
    return DoubleValidation(bias, area)
