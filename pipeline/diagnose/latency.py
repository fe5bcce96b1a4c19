"""Latency: a displacement ahead that is proportional to the speed, as of poses or time stamps that are late."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import pairwise

import numpy as np
from scipy import stats

from ...stages.arrays import FloatArray
from ...stages.causes.evidence import PairScans
from ...stages.causes.gain import surface_distance
from ...stages.displacement import PARAMETERS, fit_displacement

AHEAD = "forward"
_LONGEST_S, _FASTEST_M_S, _STEP_M = 0.5, 40.0, 1.5
_LEAST_M_S, _AT_REST_M = 1.0, 0.02


def speed_m_s(scans: PairScans, later: PairScans, duration_s: float) -> float | None:
    """Speed of the real sensor ahead, from its motion until a later scan; None if this is not found.

    The motion is fitted from several starting points, as the fit reaches 1.5 m; that of the least distance counts.
    """
    found = []
    for start_m in np.arange(0.0, _FASTEST_M_S * duration_s, _STEP_M):
        ahead = later.real.points + np.array([start_m, 0.0, 0.0])
        moved = fit_displacement(scans.real.points, ahead, scans.real.is_ground)
        if moved:
            apart_m = surface_distance(scans.real.points, moved.undo(ahead, later.real.is_ground))
            found.append((apart_m, start_m - float(moved.values[PARAMETERS.index(AHEAD)])))
    return min(found)[1] / duration_s if found else None


def follow(times_s: Mapping[str, float], names: Sequence[str]) -> dict[str, tuple[str, float]]:
    """For each pair the next one within half a second, and the seconds until then."""
    timed = sorted((times_s[name], name) for name in names if name in times_s)
    return {a: (b, after - before) for (before, a), (after, b) in pairwise(timed) if 0 < after - before <= _LONGEST_S}


def latency_words(ahead_m: FloatArray, speeds_m_s: FloatArray) -> tuple[str, str] | None:
    """Sentence on the latency that a displacement ahead may be, and the setting to look at; None without known speeds.

    Parameters
    ----------
    ahead_m, speeds_m_s : (n,) by pair; speeds that are unknown are NaN
    """
    is_known = np.isfinite(speeds_m_s)
    ahead_m, speeds_m_s = ahead_m[is_known], speeds_m_s[is_known]
    if not len(speeds_m_s) or abs(speeds_m_s.mean()) < _LEAST_M_S:
        return None
    alone_s = float(ahead_m @ speeds_m_s / (speeds_m_s @ speeds_m_s))
    at_once = f"or {1e3 * alone_s:.0f} ms of latency at {speeds_m_s.mean():.0f} m/s"
    either = at_once, "position of the sensor, or time stamps"
    if len(speeds_m_s) < 4 or np.ptp(speeds_m_s) < _LEAST_M_S:
        return either
    fit = stats.linregress(speeds_m_s, ahead_m)
    reach = float(stats.t.ppf(0.975, len(speeds_m_s) - 2))
    low_s, high_s = fit.slope - reach * fit.stderr, fit.slope + reach * fit.stderr
    if low_s * high_s > 0:
        late = f"{1e3 * fit.slope:.0f} ms of latency ({1e3 * low_s:.0f} to {1e3 * high_s:.0f})"
        grows = f"in proportion to the speed: {late}"
        if abs(fit.intercept) <= reach * fit.intercept_stderr + _AT_REST_M:
            return grows, "poses and time stamps"
        return f"partly {grows}, and {fit.intercept:+.2f} m at rest", "poses and time stamps; position of the sensor"
    if not low_s <= alone_s <= high_s:
        return "at any speed, so no latency", "position of the sensor, T_real_sim"
    return either
