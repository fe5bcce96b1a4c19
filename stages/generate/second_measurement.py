"""A simulated second measurement of a scan by the same beams, as of a perfect simulator."""

from __future__ import annotations

import numpy as np
from numpy.random import Generator

from ..arrays import FloatArray, IndexArray


def remeasure(
    points: FloatArray,
    noise_m: float,
    lost_share: float,
    rng: Generator,
) -> tuple[FloatArray, IndexArray]:
    """A simulated second measurement of the points by the same beams.

    p' = p (1 + e / |p|) with e ~ N(0, noise_m): noise along the ray alone; then each is lost
    independently with the probability `lost_share`. Under one seed the noise of a point is
    proportional to `noise_m`, and points lost at a share are lost at each larger one. Without noise
    the coordinates stay equal to the last bit.

    Parameters
    ----------
    points : (n, 3) float64, metres, sensor at the origin; finite and not zero
    noise_m : standard deviation of the difference of two measured ranges, 0 or more
    lost_share : 0 to 1
    rng : source of all randomness

    Returns
    -------
    points : (m, 3) float64
    rows : (m,) intp, of the input, ascending

    Examples
    --------
    >>> import numpy as np
    >>> again, rows = remeasure(np.array([[3.0, 4.0, 0.0]]), 0.5, 0.0, np.random.default_rng(0))
    >>> bool(np.isclose(again[0, 1] / again[0, 0], 4 / 3)), rows.tolist()
    (True, [0])
    """
    range_m = np.linalg.norm(points, axis=1)
    again = points * (1.0 + noise_m * rng.standard_normal(len(points)) / range_m)[:, None]
    rows = np.flatnonzero(rng.random(len(points)) >= lost_share)
    return again[rows], rows


def fill_gaps(
    points: FloatArray,
    rows: IndexArray,
    n_lost: IndexArray,
) -> tuple[FloatArray, IndexArray]:
    """The returns of lost pulses, evenly spaced in direction and range between two returns of one beam.

    Parameters
    ----------
    points : (n, 3) float64, metres, sensor at the origin
    rows : (g, 2) intp, points before and after each gap
    n_lost : (g,) intp, pulses lost in each gap

    Returns
    -------
    points : (m, 3) float64
    rows : (m,) intp, the nearer end of its gap for each point

    Examples
    --------
    >>> import numpy as np
    >>> filled, rows = fill_gaps(np.array([[4.0, 3, 0], [4, -3, 0]]), np.array([[0, 1]]), np.array([1]))
    >>> filled.tolist(), rows.tolist()
    ([[5.0, 0.0, 0.0]], [1])
    """
    gap = np.repeat(np.arange(len(rows)), n_lost)
    first = np.cumsum(n_lost) - n_lost
    number = np.arange(len(gap)) - np.repeat(first, n_lost)
    share = ((number + 1) / (n_lost[gap] + 1))[:, None]
    range_m = np.linalg.norm(points[rows], axis=2, keepdims=True)
    direction = (points[rows] / range_m)[gap]
    range_m = range_m[gap]
    middle = (1 - share) * direction[:, 0] + share * direction[:, 1]
    middle_m = (1 - share) * range_m[:, 0] + share * range_m[:, 1]
    filled: FloatArray = middle / np.linalg.norm(middle, axis=1)[:, None] * middle_m
    return filled, rows[gap, (share[:, 0] >= 0.5).astype(np.intp)]
