"""Rays once more: every return compared with every other one."""

from __future__ import annotations

import math
from bisect import bisect_left
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy import stats

from ..arrays import FloatArray

_REACH, _PHASE_REACH, _CANDIDATES = 0.75, 1.75, 6
_BLOCK = 32
_STEP_DEG = 0.01


@dataclass(frozen=True)
class Sensor:
    """Elevations of the beams, azimuth step, heights at which the beams of the two blocks start, and their limit."""

    beams: Sequence[float]
    step: float
    heights: Sequence[float] = ()
    block: float = -90.0

    def beam_of(self, point: FloatArray) -> int:
        """The beam nearest in elevation, seen from where it starts."""
        x, y, z = point.tolist()
        level = max(math.hypot(x, y), 1e-9)
        height = 0.0
        if self.heights:
            middle = sum(self.heights) / len(self.heights)
            height = self.heights[0 if math.degrees(math.atan2(z - middle, level)) < self.block else -1]
        elevation = math.degrees(math.atan2(z - height, level))
        return min(range(len(self.beams)), key=lambda beam: abs(self.beams[beam] - elevation))


def rows_by_elevation(real: Sensor, sim: Sensor) -> list[float]:
    """Row at each hundredth of a degree from -90 to 90: the sum of the steps over the wider distance of beams there."""

    def apart(beams: Sequence[float], elevation: float) -> float:
        middles = [(a + b) / 2 for a, b in pairwise(beams)]
        gaps = [b - a for a, b in pairwise(beams)]
        if elevation <= middles[0]:
            return gaps[0]
        if elevation >= middles[-1]:
            return gaps[-1]
        i = next(i for i, middle in enumerate(middles) if middle > elevation) - 1
        share = (elevation - middles[i]) / (middles[i + 1] - middles[i])
        return gaps[i] + share * (gaps[i + 1] - gaps[i])

    total, rows = 0.0, []
    for i in range(18_001):
        elevation = -90.0 + _STEP_DEG * i
        wider = max(apart(real.beams, elevation), apart(sim.beams, elevation))
        total += _STEP_DEG / wider if i else 0.0
        rows.append(total)
    return rows


def place(point: FloatArray, rows: Sequence[float], step: float) -> tuple[float, float]:
    """Azimuth in cells from -180 degrees on, and row, of a return."""
    x, y, z = point.tolist()
    azimuth = (math.degrees(math.atan2(y, x)) + 180.0) / step % (360.0 / step)
    at = (math.degrees(math.asin(z / math.sqrt(x * x + y * y + z * z))) + 90.0) / _STEP_DEG
    i = min(int(at), len(rows) - 2)
    return azimuth, rows[i] + (at - i) * (rows[i + 1] - rows[i])


def partners(real: FloatArray, sim: FloatArray, real_sensor: Sensor, sim_sensor: Sensor) -> dict[int, int]:
    """Simulated partner of each real return that has one: nearest pairs first, each return once."""
    step = max(real_sensor.step, sim_sensor.step)
    width, rows = 360.0 / step, rows_by_elevation(real_sensor, sim_sensor)
    a = np.array([place(point, rows, step) for point in real])
    b = np.array([place(point, rows, step) for point in sim])
    beams = [real_sensor.beam_of(point) for point in real]
    around = np.argsort(np.concatenate([b[:, 0] - width, b[:, 0], b[:, 0] + width]), kind="stable")
    ascending = np.concatenate([b[:, 0] - width, b[:, 0], b[:, 0] + width])[around]
    near: list[list[tuple[float, float, int]]] = []
    for one in a:
        first, last = np.searchsorted(ascending, (one[0] - _PHASE_REACH, one[0] + _PHASE_REACH))
        js = around[first:last] % len(b)
        azimuth, upward = ascending[first:last] - one[0], b[js, 1] - one[1]
        apart = np.hypot(azimuth, upward)
        order = np.argsort(apart, kind="stable")[:_CANDIDATES]
        near.append([(azimuth[i], upward[i], int(js[i])) for i in order.tolist() if apart[i] <= _PHASE_REACH])
    places = list(zip(beams, (a[:, 0] // _BLOCK).astype(int).tolist(), strict=True))
    of_beam = _phases(dict(enumerate(beams)), near)
    of_block = _phases(dict(enumerate(places)), near)
    pairs = []
    for i, candidates in enumerate(near):
        whole = of_beam.get(beams[i], 0.0)
        phase = whole + (of_block.get(places[i], 0.0) - whole + 0.5) % 1.0 - 0.5
        pairs += [(math.hypot(azimuth - phase, upward), i, j) for azimuth, upward, j in candidates]
    found: dict[int, int] = {}
    taken = set()
    for apart, i, j in sorted(pairs):
        if apart <= _REACH and i not in found and j not in taken:
            found[i] = j
            taken.add(j)
    return found


def _phases(places: dict[int, object], near: Sequence[Sequence[tuple[float, float, int]]]) -> dict[object, float]:
    """Circular mean, by place, of the azimuth from each return on to the nearest one of the other side."""
    turns: dict[object, list[complex]] = {}
    for i, key in places.items():
        if near[i]:
            angle = 2.0 * math.pi * near[i][0][0]
            turns.setdefault(key, []).append(complex(math.cos(angle), math.sin(angle)))
    return {
        key: math.atan2(sum(own).imag, sum(own).real) / (2.0 * math.pi) if abs(sum(own)) > 0.5 * len(own) else 0.0
        for key, own in turns.items()
    }


def outcome(real_m: float | None, sim_m: float | None, noise_m: float, nearest_m: float | None) -> str:
    """Outcome of a ray, from the ranges of both sides and the distance of the real return to the simulated side."""
    if real_m is None:
        return "none" if sim_m is None else "sim_only"
    if sim_m is None:
        return "dropped" if nearest_m is not None and nearest_m <= 0.3 else "no_surface"
    if abs(sim_m - real_m) <= max(0.1, 3.0 * noise_m):
        return "same"
    return "in_front" if sim_m < real_m else "behind"


def scores(rays: Sequence[tuple[str, float, float]]) -> dict[str, float | None]:
    """Scores of some rays, by column of `pairs`.

    Parameters
    ----------
    rays : outcome, real and simulated range (NaN for none) of each
    """
    count = {name: sum(1 for own, _, _ in rays if own == name) for name in _OUTCOMES}
    n = sum(count[name] for name in _OUTCOMES if name != "none")
    both = [(real, sim) for own, real, sim in rays if own in _OUTCOMES[:3]]
    single = n - len(both)
    found: dict[str, float | None] = {"n_rays": n}
    for name in _OUTCOMES[:-1]:
        found[f"rays_{name}"] = count[name] / n if n else None
    for name, hits in (("hit", len(both)), ("drop", count["none"])):
        found[f"rays_{name}_f1"] = hits / (hits + single / 2) if hits + single else None
    errors = sorted(sim - real for real, sim in both)
    size = len(errors)
    names = ("bias_m", "bias_low_m", "bias_high_m", "scale", "mae_m", "medae_m", "p90_m", "rmse_m")
    if not size:
        return found | {f"rays_{name}": None for name in names}
    absolute = sorted(abs(error) for error in errors)
    low, high = (min(max(size / 2 + sign * 0.98 * math.sqrt(size), 0), size - 1) for sign in (-1, 1))
    values = (
        _quantile(errors, 0.5),
        errors[int(low)],
        errors[int(high)],
        _quantile(sorted(sim / real for real, sim in both), 0.5) - 1.0,
        math.fsum(absolute) / size,
        _quantile(absolute, 0.5),
        _quantile(absolute, 0.9),
        math.sqrt(math.fsum(error * error for error in errors) / size),
    )
    return found | {f"rays_{name}": value for name, value in zip(names, values, strict=True)}


def intensity_scores(
    outcome: Sequence[str],
    intensity: dict[str, FloatArray],
    range_m: dict[str, FloatArray],
    incidence_deg: FloatArray,
    label: Sequence[str | None],
    *,
    has_one_scale: bool,
) -> dict[str, float | str | None]:
    """Scores of the intensities, by column of `pairs`, with scipy's ranks, correlation and Wasserstein distance.

    Parameters
    ----------
    intensity, range_m : by side, of each ray; NaN for none, and for all rays if the side has no intensity
    """
    found: dict[str, float | str | None] = {}
    notes = []
    names = sorted({own for own in label if own is not None})
    classes = np.array([np.nan if own is None else float(names.index(own)) for own in label])
    for side, own in intensity.items():
        known = ~np.isnan(own)
        if not known.any():
            notes.append(f"{side}: no intensity")
            continue
        by_range = _eta_squared(own[known], range_m[side][known], n_groups=20)
        found[f"intensity_{side}_by_range"] = by_range
        found[f"intensity_{side}_by_incidence"] = _eta_squared(own[known], incidence_deg[known], n_groups=20)
        found[f"intensity_{side}_by_class"] = _eta_squared(own[known], classes[known])
        if known.sum() >= 100 and len(set(own[known].tolist())) == 1:
            notes.append(f"{side}: constant ({own[known][0]:g})")
        elif by_range is not None and by_range >= 0.97:
            notes.append(f"{side}: a function of range alone")
    found["intensity_note"] = "; ".join(notes) or None
    real, sim = intensity["real"], intensity["sim"]
    both = np.array([own == "same" for own in outcome], dtype=bool) & ~np.isnan(real) & ~np.isnan(sim)
    if both.sum() < 100:
        return found
    ranks = [(stats.rankdata(own[both]) - 0.5) / both.sum() for own in (real, sim)]
    bins: dict[tuple[int, int], list[int]] = {}
    for i, (distance, angle) in enumerate(zip(range_m["real"][both], incidence_deg[both], strict=True)):
        band = sum(distance >= edge for edge in (10, 20, 30, 50))
        bins.setdefault(
            (band, -1 if math.isnan(angle) else sum(angle >= edge for edge in (30, 60, 75, 85))), []
        ).append(i)
    large = [own for own in bins.values() if len(own) >= 10]
    total = sum(len(own) * float(stats.wasserstein_distance(ranks[0][own], ranks[1][own])) for own in large)
    varies = all(len(set(own.tolist())) > 1 for own in ranks)
    mean = math.fsum(real[both]) / both.sum()
    return found | {
        "intensity_rank_corr": float(stats.spearmanr(real[both], sim[both])[0]) if varies else None,
        "intensity_rank_distance": total / sum(map(len, large)) if large else None,
        "intensity_ratio": math.fsum(sim[both]) / both.sum() / mean if mean > 0 else None,
        "intensity_rmse": math.sqrt(math.fsum((sim - real)[both] ** 2) / both.sum()) if has_one_scale else None,
    }


def _eta_squared(values: FloatArray, cause: FloatArray, n_groups: int = 0) -> float | None:
    """Sum of squares of ranks between groups over the total: groups of equal cause, or of about equal size."""
    values, cause = values[~np.isnan(cause)], cause[~np.isnan(cause)]
    if len(values) < 100 or len(set(values.tolist())) == 1:
        return None
    ascending = sorted(cause.tolist())
    edges = [_quantile(ascending, i / n_groups) for i in range(1, n_groups)]
    groups = np.array([bisect_left(edges, one) for one in cause.tolist()]) if edges else cause
    ranks = stats.rankdata(values)
    between = sum(
        (groups == own).sum() * (ranks[groups == own].mean() - ranks.mean()) ** 2 for own in set(groups.tolist())
    )
    return float(between / ((ranks - ranks.mean()) ** 2).sum())


_OUTCOMES = ("same", "in_front", "behind", "dropped", "no_surface", "sim_only", "none")


def _quantile(ascending: Sequence[float], share: float) -> float:
    """Linear between the two values next to a place."""
    at = share * (len(ascending) - 1)
    i = min(int(at), len(ascending) - 2) if len(ascending) > 1 else 0
    above = ascending[min(i + 1, len(ascending) - 1)]
    return ascending[i] + (at - i) * (above - ascending[i])
