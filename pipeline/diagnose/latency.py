"""Latency: a displacement ahead that is proportional to the speed, as of poses or time stamps that are late."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import pairwise

import numpy as np
from scipy import stats
from scipy.spatial import cKDTree

from ...schemas.cause_catalogue import PARAMETERS
from ...schemas.results import Cause
from ...stages.arrays import FloatArray
from ...stages.causes.distance import surface_distance
from ...stages.displacement import fit_displacement
from ...stages.pieces import CutScan
from ..jobs.points_job import cut_scan
from ..results.causes import read_causes
from ..results.finished import FinishedRun

AHEAD = "forward"
#: Most pairs whose speed is fitted, evenly over the run.
_MOST_PAIRS = 20
_LONGEST_S, _FASTEST_M_S, _STEP_M = 0.5, 40.0, 1.5
_LEAST_M_S = 1.0


def latency_note(run: FinishedRun, causes: Sequence[Cause]) -> str:
    """Note on the cause `forward` as a latency; "" if it is not named, or if no speed is known."""
    if AHEAD not in {cause.name for cause in causes}:
        return ""
    following = follow(run.record.times_s, run.select())
    names = list(following)[:: len(following) // _MOST_PAIRS + 1]
    if not names:
        return ""
    speeds_m_s = []
    for name in names:
        later, duration_s = following[name]
        speeds_m_s.append(speed_m_s(_real_scan(run, name), _real_scan(run, later), duration_s))
    ahead_m = read_causes(run.store, names)[AHEAD]["amount"]
    words = latency_words(ahead_m.to_numpy(), np.array(speeds_m_s))
    return f"{AHEAD}: {words}" if words else ""


def _real_scan(run: FinishedRun, pair_id: str) -> CutScan:
    return cut_scan(run.store.read_table("ground", pair_id, "real"))


def follow(times_s: Mapping[str, float], names: Sequence[str]) -> dict[str, tuple[str, float]]:
    """For each pair the next one within half a second, and the seconds until then."""
    timed = sorted((times_s[name], name) for name in names if name in times_s)
    return {
        a: (b, after - before)
        for (before, a), (after, b) in pairwise(timed)
        if 0 < after - before <= _LONGEST_S
    }


def speed_m_s(scan: CutScan, later: CutScan, duration_s: float) -> float:
    """Speed of the real sensor ahead, from its motion until a later scan; NaN if this is not found.

    The motion is fitted from several starting points, as the fit reaches 1.5 m; that of the least distance counts.
    """
    tree = cKDTree(scan.points)
    fits = []
    for start_m in np.arange(0.0, _FASTEST_M_S * duration_s, _STEP_M):
        ahead = later.points + np.array([start_m, 0.0, 0.0])
        moved = fit_displacement(tree, cKDTree(ahead), scan.is_ground)
        if moved is not None:
            apart_m = surface_distance(tree, cKDTree(moved.undo(ahead, later.is_ground)))
            fits.append((apart_m, start_m - float(moved.values[PARAMETERS.index(AHEAD)])))
    return min(fits)[1] / duration_s if fits else np.nan


def latency_words(ahead_m: FloatArray, speeds_m_s: FloatArray) -> str:
    """The latency that a displacement ahead may be; "" without known speeds.

    Parameters
    ----------
    ahead_m, speeds_m_s : (n,) by pair; NaN if unknown
    """
    is_known = np.isfinite(speeds_m_s) & np.isfinite(ahead_m)
    ahead_m = ahead_m[is_known]
    speeds_m_s = speeds_m_s[is_known]
    if not len(speeds_m_s) or abs(speeds_m_s.mean()) < _LEAST_M_S:
        return ""
    alone_s = float(ahead_m @ speeds_m_s / (speeds_m_s @ speeds_m_s))
    either = f"or {1e3 * alone_s:.0f} ms of latency at {speeds_m_s.mean():.0f} m/s"
    if len(speeds_m_s) < 4 or np.ptp(speeds_m_s) < _LEAST_M_S:
        return either
    fit = stats.linregress(speeds_m_s, ahead_m)
    reach = float(stats.t.ppf(0.975, len(speeds_m_s) - 2))
    low_s = fit.slope - reach * fit.stderr
    high_s = fit.slope + reach * fit.stderr
    if low_s * high_s > 0:
        return (
            f"grows with the speed: {1e3 * fit.slope:.0f} ms of latency ({1e3 * low_s:.0f} to "
            f"{1e3 * high_s:.0f}), and {fit.intercept:+.2f} m at rest; see poses and time stamps"
        )
    if not low_s <= alone_s <= high_s:
        return "the same at any speed, so no latency"
    return either
