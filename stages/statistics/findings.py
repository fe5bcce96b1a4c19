"""Bands of range, and the distribution of a score."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from ...schemas.results import Distribution
from ..arrays import FloatArray
from ..summary import mean_and_std

#: Edges of the range bands, metres; the last band has no end.
BAND_EDGES_M = (0.0, 10.0, 20.0, 30.0, 50.0)
BAND_NAMES = (
    *(f"{low:.0f} to {high:.0f} m" for low, high in pairwise(BAND_EDGES_M)),
    f"over {BAND_EDGES_M[-1]:.0f} m",
)
_QUANTILES = {
    "min": 0.0,
    "q05": 0.05,
    "q25": 0.25,
    "median": 0.5,
    "q75": 0.75,
    "q95": 0.95,
    "max": 1.0,
}


def distribution(values: FloatArray) -> Distribution:
    """Number, quantiles, mean, standard deviation (n - 1) and coefficient of variation of some values.

    The coefficient of variation is standard deviation / mean: a score that varies more relative to its mean
    distinguishes objects better (the paper, "Real experiments"). NaN is left out; None if too few values remain.

    Examples
    --------
    >>> distribution(np.array([1.0, np.nan, 3.0])).median
    2.0
    """
    known = values[~np.isnan(values)]
    mean, std = mean_and_std(known)
    quantiles = {}
    for name, share in _QUANTILES.items():
        quantiles[name] = float(np.quantile(known, share)) if len(known) else None
    cv = std / mean if mean and std is not None else None
    return Distribution(n=len(known), **quantiles, mean=mean, std=std, cv=cv)


def evenly(n: int, most: int) -> list[int]:
    """Places of at most `most` of n things, evenly over their order, the first and the last among them.

    Examples
    --------
    >>> evenly(9, 3), evenly(2, 3), evenly(0, 3)
    ([0, 4, 8], [0, 1], [])
    """
    return np.linspace(0, n - 1, min(n, most)).astype(int).tolist()
