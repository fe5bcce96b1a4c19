"""What the times of the points of a scan say: whether each has one, in seconds, and what time is the scan's own."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from ..arrays import BoolArray, FloatArray

Place = Literal["first", "middle", "last"]

_MOST_MISSING = 0.02
_MOST_ALIKE = 0.25
_TURN_S = (0.01, 2.0)  # 100 to 0.5 turns a second
_UNITS = {"milliseconds": 1e-3, "microseconds": 1e-6, "nanoseconds": 1e-9}
_BINS = 24
_FEWEST_IN_BIN = 20
_FEWEST_POINTS = 500
_ROUND = 0.8
_PLACES: dict[Place, float] = {"first": 0.0, "middle": 0.5, "last": 1.0}
_PLACE_TOLERANCE = 0.1  # of the time that a scan takes


@dataclass(frozen=True)
class StampFacts:
    """What the times of a scan's points say.

    span_s : from the first to the last
    place : of which point the scan's own time is, None where it is none's or there is no such time
    turn : +1 where azimuth rises with time, -1 where it falls, 0 where it cannot be told
    faults : what is wrong with them, one sentence each
    """

    span_s: float
    place: Place | None = None
    turn: int = 0
    faults: tuple[str, ...] = ()


def describe_stamps(times_s: FloatArray, points: FloatArray, stamp_s: float | None = None) -> StampFacts:
    """What the times of the points of one scan say, and what is wrong with them.

    Missing are times that are NaN, or that a quarter of all returns share while others differ (zeros, say). A turn
    takes 0.01 to 2 s. In 24 equal parts of that time a spinning sensor's azimuths lie together: the length of their
    mean unit vector is at least 0.8 in the median, and their directions go one way round; times of other points, or in
    another order, do neither. That is asked only of scans with returns over more than 180 degrees.

    Parameters
    ----------
    times_s : (m,) float64, seconds, counted from anywhere; m is n, else that is the fault
    points : (n, 3) float64, metres, sensor's frame, z up; zero and not finite ones are no returns and left out
    stamp_s : the scan's own time (the header of its message), seconds; times of less than a day count from it
    """
    if len(times_s) != len(points):
        return StampFacts(0.0, faults=(f"{len(times_s)} times for {len(points)} points; one each is wanted",))
    is_return = np.isfinite(points).all(axis=1) & points.any(axis=1)
    points, times = points[is_return], times_s[is_return]
    if not len(points):
        return StampFacts(0.0)
    is_missing = ~np.isfinite(times)
    values, counts = np.unique(times[~is_missing], return_counts=True)
    if len(values) == 1 and not is_missing.any():
        return StampFacts(
            0.0, faults=("all points have one time; what moved while a turn took place cannot be undone",)
        )
    faults = []
    if len(values) > 1 and counts.max() > _MOST_ALIKE * len(times):
        is_missing |= times == values[counts.argmax()]
    if is_missing.mean() > _MOST_MISSING:
        faults.append(
            f"{is_missing.mean():.0%} of the points have no time of their own (NaN, or one value for all these)"
        )
    if (~is_missing).sum() < _FEWEST_POINTS:
        return StampFacts(0.0, faults=tuple(faults))
    points, times = points[~is_missing], times[~is_missing]
    span_s = float(np.ptp(times))
    if not _TURN_S[0] <= span_s <= _TURN_S[1]:
        units = [name for name, unit in _UNITS.items() if _TURN_S[0] <= unit * span_s <= _TURN_S[1]]
        hint = f"are they in {' or '.join(units)}?" if units else "are they in seconds?"
        faults.append(f"times span {span_s:.3g} s, {_TURN_S[0]:g} to {_TURN_S[1]:g} s are usual for a turn; {hint}")
    turn = _turn(points, times)
    if turn is None:
        faults.append("times do not go round with azimuth; are they those of other points?")
    place = None
    if stamp_s is not None and not faults:
        before = stamp_s - times.min() if times.min() > 86_400 else -times.min()
        place = next((name for name, at in _PLACES.items() if abs(before / span_s - at) < _PLACE_TOLERANCE), None)
        if not -_PLACE_TOLERANCE < before / span_s < 1 + _PLACE_TOLERANCE:
            faults.append(
                f"the scan's own time lies {before:+.3f} s after its first point, outside of the {span_s:.3f} s that "
                "its points take; are both of one clock?"
            )
    return StampFacts(span_s, place, turn or 0, tuple(faults))


def stamp_differences(real: StampFacts | None, sim: StampFacts | None) -> list[str]:
    """One sentence for each thing in which the times of the sides differ; nothing where a side has none.

    Parameters
    ----------
    real, sim : of a scan of each side; None where its points have no times
    """
    if real is None or sim is None:
        return []
    found = []
    if real.place and sim.place and real.place != sim.place:
        apart = abs(_PLACES[real.place] - _PLACES[sim.place]) * max(real.span_s, sim.span_s)
        found.append(
            f"the time of a real scan is that of its {real.place} point, of a simulated one that of its {sim.place} "
            f"point: scans of one time were taken {apart:.2g} s apart"
        )
    if real.turn * sim.turn < 0:
        ways = {1: "anticlockwise", -1: "clockwise"}
        found.append(f"by their times, the real sensor turns {ways[real.turn]} and the simulated one {ways[sim.turn]}")
    return found


def _turn(points: FloatArray, times: FloatArray) -> int | None:
    """Which way azimuth goes with time: +1, -1, 0 where too little is seen; None where it goes no way."""
    azimuth = np.arctan2(points[:, 1], points[:, 0])
    start, stop = np.quantile(times, (0.005, 0.995))
    if len(times) < _FEWEST_POINTS or start == stop or len(np.unique(np.floor(azimuth / (np.pi / 6)))) < 7:
        return 0
    part = np.floor((times - start) / (stop - start) * _BINS)
    is_used: BoolArray = (part >= 0) & (part < _BINS)
    number = part[is_used].astype(np.intp)
    count = np.bincount(number, minlength=_BINS)
    mean = np.bincount(number, np.cos(azimuth[is_used]), _BINS) + 1j * np.bincount(
        number, np.sin(azimuth[is_used]), _BINS
    )
    mean = mean[count >= _FEWEST_IN_BIN] / count[count >= _FEWEST_IN_BIN]
    if len(mean) < _BINS / 3:
        return 0
    steps = np.angle(mean[1:] / mean[:-1])
    one_way = float(np.mean(np.sign(steps)))
    if np.median(np.abs(mean)) < _ROUND or abs(one_way) < 0.6:
        return None
    return 1 if one_way > 0 else -1
