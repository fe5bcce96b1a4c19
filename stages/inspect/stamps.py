"""Checks of the point times of a scan: completeness, unit, and relation to the time of the scan."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from ..arrays import BoolArray, FloatArray

Place = Literal["first", "middle", "last"]

_MAX_MISSING = 0.02
_MAX_EQUAL_SHARE = 0.25
_FASTEST_S = 0.01  # of a revolution
_SLOWEST_S = 2.0
_UNITS = {"milliseconds": 1e-3, "microseconds": 1e-6, "nanoseconds": 1e-9}
_BINS = 24
_MIN_IN_BIN = 20
_MIN_POINTS = 500
_MIN_CONCENTRATION = 0.8
_PLACES: dict[Place, float] = {"first": 0.0, "middle": 0.5, "last": 1.0}
_PLACE_TOLERANCE = 0.1  # share of the duration of a scan
_DAY_S = 86_400


@dataclass(frozen=True)
class StampCheck:
    """Result of the checks of point times.

    span_s : duration from the first to the last point
    place : point to which the scan's own time belongs; None if none, or if the scan has no time
    rotation : +1 if azimuth increases with time, -1 if it decreases, 0 if unknown
    faults : problems, one sentence each
    """

    span_s: float
    place: Place | None = None
    rotation: int = 0
    faults: tuple[str, ...] = ()


def describe_stamps(
    times_s: FloatArray,
    points: FloatArray,
    stamp_s: float | None = None,
) -> StampCheck:
    """Check the point times of one scan.

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
    stamp_s : time of the scan (the header of its message), seconds; times below one day are
        relative to it
    """
    if len(times_s) != len(points):
        return StampCheck(
            0.0,
            faults=(f"expected {len(points)} times, one per point, got {len(times_s)}",),
        )
    is_return = np.isfinite(points).all(axis=1) & points.any(axis=1)
    points = points[is_return]
    times = times_s[is_return]
    if not len(points):
        return StampCheck(0.0)
    is_missing = ~np.isfinite(times)
    values, counts = np.unique(times[~is_missing], return_counts=True)
    if len(values) == 1 and not is_missing.any():
        return StampCheck(
            0.0,
            faults=("all points have one time; motion during a revolution cannot be compensated",),
        )
    faults = []
    if len(values) > 1 and counts.max() > _MAX_EQUAL_SHARE * len(times):
        is_missing |= times == values[counts.argmax()]
    if is_missing.mean() > _MAX_MISSING:
        faults.append(
            f"{is_missing.mean():.0%} of the points have no time (NaN, or one value for all of them)",
        )
    if (~is_missing).sum() < _MIN_POINTS:
        return StampCheck(0.0, faults=tuple(faults))
    points = points[~is_missing]
    times = times[~is_missing]
    span_s = float(np.ptp(times))
    if not _is_revolution(span_s):
        units = [name for name, unit_s in _UNITS.items() if _is_revolution(unit_s * span_s)] or [
            "seconds"
        ]
        faults.append(
            f"times span {span_s:.3g} s; a revolution takes {_FASTEST_S:g} to {_SLOWEST_S:g} s; "
            f"are they in {' or '.join(units)}?"
        )
    rotation = _rotation(points, times)
    if rotation is None:
        faults.append("times do not follow the azimuth; do they belong to other points?")
    if stamp_s is None or faults:
        return StampCheck(span_s, None, rotation or 0, tuple(faults))
    after_s = -times.min()
    if times.min() > _DAY_S:
        after_s += stamp_s
    share = after_s / span_s
    if not -_PLACE_TOLERANCE < share < 1 + _PLACE_TOLERANCE:
        faults.append(
            f"the scan's own time is {after_s:+.3f} s after its first point, outside of the "
            f"{span_s:.3f} s of its points; are both from one clock?"
        )
    places = [name for name, at in _PLACES.items() if abs(share - at) < _PLACE_TOLERANCE]
    return StampCheck(span_s, places[0] if places else None, rotation or 0, tuple(faults))


def stamp_differences(real: StampCheck | None, sim: StampCheck | None) -> list[str]:
    """Describe each difference between the times of the sides in one sentence; empty if a side has no times.

    Parameters
    ----------
    real, sim : checks of a scan of each side; None if its points have no times
    """
    if real is None or sim is None:
        return []
    lines = []
    if real.place and sim.place and real.place != sim.place:
        apart = abs(_PLACES[real.place] - _PLACES[sim.place]) * max(real.span_s, sim.span_s)
        lines.append(
            f"the time of a real scan is that of its {real.place} point, the time of a simulated "
            f"scan that of its {sim.place} point: scans with the same time are {apart:.2g} s apart"
        )
    if real.rotation * sim.rotation < 0:
        ways = {1: "anticlockwise", -1: "clockwise"}
        lines.append(
            f"by the times, the real sensor rotates {ways[real.rotation]} and the simulated one {ways[sim.rotation]}",
        )
    return lines


def _is_revolution(span_s: float) -> bool:
    return _FASTEST_S <= span_s <= _SLOWEST_S


def _rotation(points: FloatArray, times: FloatArray) -> int | None:
    """Sense of rotation by time: +1, -1, 0 if there are too few returns; None if there is no rotation."""
    azimuth = np.arctan2(points[:, 1], points[:, 0])
    start, stop = np.quantile(times, (0.005, 0.995))
    if (
        len(times) < _MIN_POINTS
        or start == stop
        or len(
            np.unique(np.floor(azimuth / (np.pi / 6))),
        )
        < 7
    ):
        return 0
    part = np.floor((times - start) / (stop - start) * _BINS)
    is_used: BoolArray = (part >= 0) & (part < _BINS)
    number = part[is_used].astype(np.intp)
    azimuth = azimuth[is_used]
    count = np.bincount(number, minlength=_BINS)
    total = np.bincount(
        number,
        np.cos(azimuth),
        _BINS,
    ) + 1j * np.bincount(number, np.sin(azimuth), _BINS)
    is_full = count >= _MIN_IN_BIN
    mean = total[is_full] / count[is_full]
    if len(mean) < _BINS / 3:
        return 0
    steps = np.angle(mean[1:] / mean[:-1])
    one_way = float(np.mean(np.sign(steps)))
    if np.median(np.abs(mean)) < _MIN_CONCENTRATION or abs(one_way) < 0.6:
        return None
    return 1 if one_way > 0 else -1
