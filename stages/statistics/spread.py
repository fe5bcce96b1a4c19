"""How much a score depends on the seed, and how much on the pair: which differences are more than chance."""

from __future__ import annotations

import numpy as np

from ...schemas.results import Spread
from ..arrays import FloatArray
from ..summary import mean_and_std

#: Two values of equal noise differ by more than this many standard deviations in 5 % of the cases: 1.96 sqrt(2).
_STDS_OF_A_DIFFERENCE = 1.959963984540054 * 2**0.5


def spread(values: FloatArray) -> Spread:
    """How a score spreads over seeds within a pair, beside how it spreads over pairs.

    With s the standard deviation over seeds within a pair, pooled over P pairs, a pair's score has the noise s, the
    dataset's mean the noise s / sqrt(P), and the difference of two of them 1.96 sqrt(2) times that (95 %, normal).

    Parameters
    ----------
    values : (pairs, seeds) float64, NaN where a score is null

    Examples
    --------
    >>> import numpy as np
    >>> found = spread(np.array([[1.0, 3.0], [5.0, 7.0]]))
    >>> found.mean, round(found.std_pairs, 6), round(found.std_seeds, 6), round(found.least_pair, 6)
    (4.0, 2.828427, 1.414214, 3.919928)
    """
    of_pairs = [mean_and_std(row) for row in values]
    means = np.array([mean for mean, _ in of_pairs if mean is not None], dtype=np.float64)
    stds = np.array([std for _, std in of_pairs if std is not None], dtype=np.float64)
    mean, std_pairs = mean_and_std(means)
    if not len(stds):
        return Spread(mean=mean, std_pairs=std_pairs, std_seeds=None, least_pair=None, least_dataset=None)
    std_seeds = float(np.sqrt(np.mean(stds**2)))
    least = _STDS_OF_A_DIFFERENCE * std_seeds
    return Spread(
        mean=mean,
        std_pairs=std_pairs,
        std_seeds=std_seeds,
        least_pair=least,
        least_dataset=float(least / np.sqrt(len(means))),
    )
