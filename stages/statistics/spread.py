"""Spread of a score over seeds and over pairs, and the smallest difference beyond chance."""

from __future__ import annotations

import numpy as np

from ...schemas.record import Spread
from ..arrays import FloatArray
from ..summary import mean_and_std
from .comparison import CONFIDENCE


def spread(values: FloatArray) -> Spread:
    """Spread of a score over seeds within a pair, and over pairs.

    With s the standard deviation over seeds within a pair, pooled over P pairs, a pair's score has the noise s, and the
    dataset's mean the noise s / sqrt(P). The difference of two of them is smaller than t sqrt(2) times that in 95 % of
    the cases: the repeatability limit (ISO 5725-6, section 4.1.4), with Student's t of as many degrees of freedom as s
    was estimated with (seeds minus one, summed over the pairs) instead of 1.96, which is only valid for a known s.

    Parameters
    ----------
    values : (pairs, seeds) float64, NaN for null

    Examples
    --------
    >>> import numpy as np
    >>> found = spread(np.array([[1.0, 3.0], [5.0, 7.0]]))
    >>> found.mean, round(found.std_pairs, 6), round(found.std_seeds, 6), round(found.least_pair, 6)
    (4.0, 2.828427, 1.414214, 8.605305)
    """
    from scipy.stats import t as student_t

    rows = [row[~np.isnan(row)] for row in values]
    means = np.array([row.mean() for row in rows if len(row)], dtype=float)
    mean, std_pairs = mean_and_std(means)
    repeats = [row for row in rows if len(row) > 1]
    degrees = sum(len(row) - 1 for row in repeats)
    std_seeds = least = least_dataset = None
    if degrees:
        squares = sum(np.var(row, ddof=1) * (len(row) - 1) for row in repeats)
        std_seeds = float(np.sqrt(squares / degrees))
        least = float(student_t.isf((1 - CONFIDENCE) / 2, degrees)) * 2**0.5 * std_seeds
        least_dataset = float(least / np.sqrt(len(means)))
    return Spread(
        mean=mean,
        std_pairs=std_pairs,
        std_seeds=std_seeds,
        least_pair=least,
        least_dataset=least_dataset,
    )
