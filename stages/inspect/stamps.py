"""Checks of the point times of a scan: completeness, unit, and order of the azimuths."""

from __future__ import annotations

import numpy as np

from ..arrays import FloatArray

_MAX_MISSING = 0.02
_MAX_EQUAL_SHARE = 0.25
_FASTEST_S = 0.01  # of a revolution
_SLOWEST_S = 2.0
_UNITS = {"milliseconds": 1e-3, "microseconds": 1e-6, "nanoseconds": 1e-9}
_BINS = 24
_MIN_IN_BIN = 20
_MIN_POINTS = 500
_MIN_CONCENTRATION, _MIN_ONE_WAY = 0.8, 0.6
_LEAST_SPREAD_DEG = 180.0


def check_stamps(times_s: FloatArray, points: FloatArray) -> tuple[float, list[str]]:
    """Duration from the first to the last point of a scan, seconds, and problems of its times, one sentence each.

    A time is missing if it is NaN, or if a quarter of all returns share it while others differ
    (such as 0). A revolution takes 0.01 to 2 s. In each of 24 equal parts of that time the azimuths
    of a spinning sensor are concentrated: the median length of their mean unit vector is at least
    0.8, and their directions proceed in one sense of rotation. Times of other points, or in another
    order, have neither property. This is only checked for scans with returns over more than 180
    degrees.

    Parameters
    ----------
    times_s : (m,) float64, seconds from any origin; m different from n is reported as a problem
    points : (n, 3) float64, metres, sensor's frame, z up; zero and non-finite points are ignored
    """
    if len(times_s) != len(points):
        return 0.0, [f"expected {len(points)} times, one per point, got {len(times_s)}"]
    is_return = np.isfinite(points).all(axis=1) & points.any(axis=1)
    points = points[is_return]
    times = times_s[is_return]
    if not len(points):
        return 0.0, []
    is_missing = ~np.isfinite(times)
    values, counts = np.unique(times[~is_missing], return_counts=True)
    if len(values) == 1 and not is_missing.any():
        return 0.0, ["all points have one time; motion during a revolution cannot be compensated"]
    if len(values) > 1 and counts.max() > _MAX_EQUAL_SHARE * len(times):
        is_missing |= times == values[counts.argmax()]
    faults = []
    if is_missing.mean() > _MAX_MISSING:
        share = f"{is_missing.mean():.0%} of the points have no time"
        faults.append(f"{share} (NaN, or one value for all of them)")
    points = points[~is_missing]
    times = times[~is_missing]
    if len(times) < _MIN_POINTS:
        return 0.0, faults
    span_s = float(np.ptp(times))
    if not _is_revolution(span_s):
        units = [name for name, unit_s in _UNITS.items() if _is_revolution(unit_s * span_s)]
        faults.append(
            f"times span {span_s:.3g} s; a revolution takes {_FASTEST_S:g} to {_SLOWEST_S:g} s; "
            f"are they in {' or '.join(units or ['seconds'])}?"
        )
    if not _follow_azimuth(times, points):
        faults.append("times do not follow the azimuth; do they belong to other points?")
    return span_s, faults


def _is_revolution(span_s: float) -> bool:
    return _FASTEST_S <= span_s <= _SLOWEST_S


def _follow_azimuth(times: FloatArray, points: FloatArray) -> bool:
    """True if the azimuth goes one way with time, or if there are too few returns to see that."""
    azimuth = np.arctan2(points[:, 1], points[:, 0])
    start, stop = np.quantile(times, (0.005, 0.995))
    n_sectors = len(np.unique(np.floor(azimuth / (np.pi / 6))))
    if start == stop or n_sectors * 30.0 <= _LEAST_SPREAD_DEG:
        return True
    part = np.floor((times - start) / (stop - start) * _BINS)
    is_used = (part >= 0) & (part < _BINS)
    number = part[is_used].astype(np.intp)
    count = np.bincount(number, minlength=_BINS)
    cosine = np.bincount(number, np.cos(azimuth[is_used]), _BINS)
    sine = np.bincount(number, np.sin(azimuth[is_used]), _BINS)
    is_full = count >= _MIN_IN_BIN
    mean = (cosine + 1j * sine)[is_full] / count[is_full]
    if len(mean) < _BINS / 3:
        return True
    one_way = abs(float(np.mean(np.sign(np.angle(mean[1:] / mean[:-1])))))
    return float(np.median(np.abs(mean))) >= _MIN_CONCENTRATION and one_way >= _MIN_ONE_WAY
