"""Doubts about the points of a scan, each with what estimates of it cannot be trusted.

Doubts are texts by what a cause may need, see `CauseModel.needs`: `ONE_SWEEP`, `POSITION`, `BEAMS`. Points of the
other two, `MISSES` and `RETURNS`, are left out of the estimates, so that these hold all the same.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from scipy.spatial import cKDTree

from .arrays import BoolArray, FloatArray, IndexArray

MISSES, RETURNS, ONE_SWEEP, POSITION, BEAMS = "misses", "single_returns", "one_sweep", "sensor_position", "beams"
#: Doubts that make `fidpipe check` fail.
SERIOUS = (MISSES, ONE_SWEEP, POSITION)
_SHELL_M, _SHELL_SHARE = 0.1, 0.03
_SAME_DEG, _SAME_SHARE, _NEAREST_M = 0.005, 0.1, 1.0
_BIN_DEG, _MOST_DEG = 0.01, 4.0
_N_SWEEPS = (2, 3, 5, 10)
_FEWEST_ROWS, _SAME_CELLS = 1000, 0.6
_STEADY, _STEADIER = 0.3, 1.4
_FEWEST_GAPS = 500
_NEAR_M, _NEAR_SHARE = 5.0, 0.001
_SAMPLE, _OTHER_RANGE, _CROSSING_SHARE = 3000, 1.1, 0.3


def miss_range(range_m: FloatArray) -> tuple[float, float] | None:
    """Range at which rays without a return are written, and their share; None if there are none.

    It is the farthest one, and more than 3 % of the points lie within 0.1 m of it.

    Examples
    --------
    >>> miss_range(np.concatenate([np.linspace(3, 60, 700), np.full(300, 80.0)]))
    (80.0, 0.3)
    >>> miss_range(np.linspace(3, 60, 700)) is None
    True
    """
    farthest_m = float(range_m.max())
    is_miss = range_m > farthest_m - _SHELL_M
    share = float(is_miss.mean())
    if share < _SHELL_SHARE:
        return None
    return float(np.median(range_m[is_miss])), share


def is_miss(range_m: FloatArray, miss_range_m: float | None) -> BoolArray:
    """(n,) True for rays without a return, which are written at a range."""
    if miss_range_m is None:
        return np.zeros(len(range_m), dtype=np.bool_)
    return np.abs(range_m - miss_range_m) <= _SHELL_M


def misses_text(share: float, miss_range_m: float) -> str:
    """The doubt, with the setting that drops the points."""
    limit_m = np.floor(10 * (miss_range_m - _SHELL_M)) / 10
    return (
        f"{share:.0%} of the points lie at {miss_range_m:.1f} m: rays without a return? "
        f"input.max_range_m={limit_m:g} drops them"
    )


def later_returns(beam: IndexArray, azimuth_deg: FloatArray, range_m: FloatArray) -> BoolArray:
    """(n,) True for returns that follow another one of the same beam and direction, beyond 1 m.

    Parameters
    ----------
    beam, azimuth_deg, range_m : (n,) of returns sorted by beam, azimuth
    """
    is_far = np.minimum(range_m[1:], range_m[:-1]) > _NEAREST_M
    is_same = is_far & (np.diff(beam) == 0) & (np.diff(azimuth_deg) < _SAME_DEG)
    return np.concatenate([[False], is_same])


def returns_text(is_later: BoolArray) -> str | None:
    """The doubt that rays have several returns; None if few have."""
    share = float(is_later.mean())
    if share < _SAME_SHARE:
        return None
    return (
        f"{share:.0%} of the points are second returns of a ray (dual return, or written twice): only first ones count"
    )


def sweep_parts(points: FloatArray) -> list[tuple[int, IndexArray]]:
    """Numbers of sweeps that a scan may hold one after the other, each with the rows of the first.

    The first and the last rows have the same directions, which they do not have in a single sweep in the order of
    azimuths or beams.

    Parameters
    ----------
    points : (n, 3) float64, in the order of the file
    """
    cell = _direction_cells(points)
    parts = []
    for n_sweeps in _N_SWEEPS:
        n_rows = len(points) // n_sweeps
        if n_rows < _FEWEST_ROWS:
            break
        first = np.unique(cell[:n_rows])
        last = np.unique(cell[-n_rows:])
        n_both = len(np.intersect1d(first, last, assume_unique=True))
        if n_both > _SAME_CELLS * max(len(first), len(last)):
            parts.append((n_sweeps, np.arange(n_rows)))
    return parts


def _direction_cells(points: FloatArray) -> IndexArray:
    """(n,) number of the direction of each point, in cells of 2 degrees."""
    azimuth_deg = np.degrees(np.arctan2(points[:, 1], points[:, 0]))
    slope_deg = np.degrees(np.arctan2(points[:, 2], np.hypot(points[:, 0], points[:, 1])))
    return ((slope_deg + 90.0) // 2.0 * 181 + (azimuth_deg + 180.0) // 2.0).astype(np.intp)


def steadiness(gap_deg: FloatArray) -> float:
    """Share of the gaps from a return to the next of its beam that have the usual length.

    Parameters
    ----------
    gap_deg : (n,) float64, NaN without a next return
    """
    gap_deg = gap_deg[(gap_deg > _SAME_DEG) & (gap_deg < _MOST_DEG)]
    if len(gap_deg) < _FEWEST_GAPS:
        return 0.0
    n_by_gap = np.bincount((gap_deg / _BIN_DEG).astype(np.intp), minlength=3)
    return float(np.convolve(n_by_gap, np.ones(3)).max() / len(gap_deg))


def is_one_of_sweeps(steady: float, steady_in_all: float) -> bool:
    """True if beams fire at steady steps in the first part of a scan, and not in all of it."""
    return steady > _STEADY and steady > _STEADIER * steady_in_all


def sweeps_text(n_sweeps: int) -> str:
    """The doubt that a scan holds several sweeps."""
    return (
        f"the scan holds {n_sweeps} sweeps, or scans of {n_sweeps} sensors, one after the other: {n_sweeps} times the "
        "firings per beam and direction; expected one"
    )


def position_text(points: FloatArray) -> str | None:
    """The doubt that points without recognisable beams are not in the frame of their sensor.

    From elsewhere than the sensor surfaces are seen behind each other: neighbouring directions have different ranges.

    Parameters
    ----------
    points : (n, 3) float64, metres
    """
    range_m = np.linalg.norm(points, axis=1)
    if float((range_m < _NEAR_M).mean()) < _NEAR_SHARE:
        why = f"nothing within {_NEAR_M:g} m of the origin"
    else:
        rays = points / range_m[:, None]
        rows = np.random.default_rng(0).permutation(len(points))[:_SAMPLE]
        _, near = cKDTree(rays).query(rays[rows], k=2)
        ratio = range_m[near[:, 1]] / range_m[rows]
        crossing = float(((ratio > _OTHER_RANGE) | (ratio < 1 / _OTHER_RANGE)).mean())
        if crossing < _CROSSING_SHARE:
            return None
        why = "surfaces are behind each other, seen from the origin"
    return f"the points are not in the sensor's frame: {why}, beams not recognised; set input.sensor_position"


def doubt_lines(doubts: Mapping[str, str], *, serious: bool) -> list[str]:
    """The doubts that make the check fail, or the others."""
    return [text for need, text in doubts.items() if (need in SERIOUS) == serious]
