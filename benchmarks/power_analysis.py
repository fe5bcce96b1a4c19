"""Effect size of a score's change over pairs, power of the paired t-test, and the number of pairs that it takes."""

from __future__ import annotations

import numpy as np
from scipy import stats
from scipy.special import gammaln

from fidpipe.stages.arrays import FloatArray

SIGNIFICANCE = 0.05
POWER = 0.8
_MOST_PAIRS = 10**9


def paired_t(change: FloatArray) -> float | None:
    """The mean of a score's change over pairs, in standard errors: Student's t with one degree less than pairs.

    t = mean / (std / sqrt(n)), std with n - 1. It is infinite where all pairs change alike, 0 where none changes, None
    for fewer than two pairs. |t| above 2.78 of 5 pairs, or 2.26 of 10, is seen at 5 %, two-sided.

    Parameters
    ----------
    change : (n,) float64, of each pair; NaN are left out

    Examples
    --------
    >>> paired_t(np.array([1.0, 3.0]))
    2.0
    """
    own = change[~np.isnan(change)]
    if len(own) < 2:
        return None
    mean, error = float(own.mean()), float(own.std(ddof=1) / np.sqrt(len(own)))
    if not error:
        return float(np.copysign(np.inf, mean)) if mean else 0.0
    return mean / error


def effect_size(change: FloatArray) -> float | None:
    """The mean of a score's change over pairs, in standard deviations of the pairs' changes, without small-sample bias.

    d = J mean / std with J = gamma(f / 2) / (sqrt(f / 2) gamma((f - 1) / 2)), f = n - 1 (Hedges, Distribution theory
    for Glass's estimator of effect size, J. Educ. Stat. 1981): few pairs make an effect look larger, 5 of them by a
    quarter. None for fewer than three pairs; infinite where all pairs change alike, 0 where none changes.

    Parameters
    ----------
    change : (n,) float64, of each pair; NaN are left out
    """
    own = change[~np.isnan(change)]
    t = paired_t(own)
    degrees = len(own) - 1
    if t is None or degrees < 2:
        return None
    correction = np.exp(gammaln(degrees / 2) - gammaln((degrees - 1) / 2)) / np.sqrt(
        degrees / 2
    )
    return float(correction * t / np.sqrt(len(own)))


def power(effect: float, n_pairs: int) -> float:
    """How often a mean change of some size is seen: the power of the two-sided paired t-test at 5 %.

    P(|T| > t_crit), T noncentral t with f = n - 1 degrees of freedom and noncentrality d sqrt(n) (Cohen, Statistical
    Power Analysis for the Behavioral Sciences, 2nd edition 1988, chapter 2); computed as P(F > t_crit^2) with F = T^2,
    noncentral F with 1 and f degrees and noncentrality d^2 n. It is 5 % where there is no effect.

    Parameters
    ----------
    effect : d, mean change over its standard deviation over pairs, of either sign, finite
    n_pairs : independent pairs, at least 2

    Examples
    --------
    >>> round(power(0.0, 10), 9), round(power(1.0, 10), 3)
    (0.05, 0.803)
    """
    if n_pairs < 2:
        raise ValueError(f"power of {n_pairs} pairs: expected at least 2")
    critical = stats.t.isf(SIGNIFICANCE / 2, n_pairs - 1)
    return float(1 - stats.ncf.cdf(critical**2, 1, n_pairs - 1, effect**2 * n_pairs))


def pairs_needed(effect: float) -> int | None:
    """The least number of independent pairs with which an effect is seen in 80 % of the cases; None for no effect.

    The least n with `power` of 0.8 or more. The search begins at (z_0.025 + z_0.2)^2 / d^2, what a known standard
    deviation would want, and takes a few steps up. None also for effects that want more than 10^9 pairs.

    Parameters
    ----------
    effect : d, mean change over its standard deviation over pairs, of either sign; an infinite one is seen with 2

    Examples
    --------
    >>> [pairs_needed(effect) for effect in (0.0, 0.5, -1.0, 2.0)]
    [None, 34, 10, 5]
    """
    if np.isinf(effect):
        return 2
    wanted = stats.norm.isf(SIGNIFICANCE / 2) + stats.norm.isf(1 - POWER)
    if abs(effect) * np.sqrt(_MOST_PAIRS) <= wanted:
        return None
    n_pairs = max(2, int(np.ceil((wanted / effect) ** 2)))
    while power(effect, n_pairs) < POWER:
        n_pairs += 1
    return n_pairs
