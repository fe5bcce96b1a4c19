"""Rays once more: every return compared with every other one."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Hashable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import stats

_REACH, _PHASE_REACH, _CANDIDATES = 0.75, 1.75, 6
_BLOCK = 32
_STEP_DEG = 0.01
_OUTCOMES = ("same", "in_front", "behind", "dropped", "no_surface", "sim_only", "none")

Rays = Mapping[str, NDArray[Any]]  #: columns of table rays; NaN for no range, None for no label
Sensor = Mapping[str, Any]  #: metadata of the stage sensor
Near = list[
    tuple[float, float, int]
]  #: azimuth and rows on to a return of the other side, and its index


def beam_of(point: NDArray[np.float64], sensor: Sensor) -> int:
    """The beam nearest in elevation, seen from where it starts."""
    x, y, z = point.tolist()
    level = max(math.hypot(x, y), 1e-9)
    height = 0.0
    if heights := sensor["origin_height_m"]:
        middle = sum(heights) / len(heights)
        height = heights[
            0 if math.degrees(math.atan2(z - middle, level)) < sensor["block_deg"] else -1
        ]
    elevation = math.degrees(math.atan2(z - height, level))
    beams = sensor["elevation_deg"]
    return min(range(len(beams)), key=lambda beam: abs(beams[beam] - elevation))


def rows_by_elevation(real: Sensor, sim: Sensor) -> NDArray[np.float64]:
    """Row at each hundredth of a degree from -90 to 90: the sum of the steps over the wider distance of beams there."""
    elevation = _STEP_DEG * np.arange(18_001) - 90.0
    wider = np.zeros(18_001)
    for beams in (np.array(sensor["elevation_deg"]) for sensor in (real, sim)):
        wider = np.maximum(
            wider, np.interp(elevation, (beams[:-1] + beams[1:]) / 2, np.diff(beams))
        )
    rows: NDArray[np.float64] = np.cumsum(_STEP_DEG / wider) - _STEP_DEG / wider[0]
    return rows


def place(
    point: NDArray[np.float64], rows: NDArray[np.float64], step: float
) -> tuple[float, float]:
    """Azimuth in cells from -180 degrees on, and row, of a return."""
    x, y, z = point.tolist()
    azimuth = (math.degrees(math.atan2(y, x)) + 180.0) / step % (360.0 / step)
    at = (math.degrees(math.asin(z / math.sqrt(x * x + y * y + z * z))) + 90.0) / _STEP_DEG
    return azimuth, float(np.interp(at, np.arange(len(rows)), rows))


def partners(
    real: NDArray[np.float64], sim: NDArray[np.float64], real_sensor: Sensor, sim_sensor: Sensor
) -> dict[int, int]:
    """Simulated partner of each real return that has one: nearest pairs first, each return once."""
    step = max(real_sensor["azimuth_step_deg"], sim_sensor["azimuth_step_deg"])
    width = 360.0 / step
    rows = rows_by_elevation(real_sensor, sim_sensor)
    a = np.array([place(point, rows, step) for point in real])
    b = np.array([place(point, rows, step) for point in sim])
    beams = [beam_of(point, real_sensor) for point in real]
    azimuths = np.concatenate([b[:, 0] - width, b[:, 0], b[:, 0] + width])
    around = np.argsort(azimuths, kind="stable")
    ascending = azimuths[around]
    near: list[Near] = []
    for one in a:
        first, last = np.searchsorted(ascending, (one[0] - _PHASE_REACH, one[0] + _PHASE_REACH))
        js = around[first:last] % len(b)
        azimuth = ascending[first:last] - one[0]
        upward = b[js, 1] - one[1]
        apart = np.hypot(azimuth, upward)
        order = np.argsort(apart, kind="stable")[:_CANDIDATES]
        near.append(
            [
                (azimuth[i], upward[i], int(js[i]))
                for i in order.tolist()
                if apart[i] <= _PHASE_REACH
            ]
        )
    blocks = list(zip(beams, (a[:, 0] // _BLOCK).astype(int).tolist(), strict=True))
    of_beam, of_block = _phases(beams, near), _phases(blocks, near)
    pairs = []
    for i, candidates in enumerate(near):
        whole = of_beam.get(beams[i], 0.0)
        phase = whole + (of_block.get(blocks[i], 0.0) - whole + 0.5) % 1.0 - 0.5
        pairs += [
            (math.hypot(azimuth - phase, upward), i, j) for azimuth, upward, j in candidates
        ]
    found: dict[int, int] = {}
    taken = set()
    for apart, i, j in sorted(pairs):
        if apart <= _REACH and i not in found and j not in taken:
            found[i] = j
            taken.add(j)
    return found


def _phases(places: Sequence[Hashable], near: Sequence[Near]) -> dict[Hashable, float]:
    """Circular mean, by place, of the azimuth from each return on to the nearest one of the other side."""
    turns: dict[Hashable, list[complex]] = {}
    for key, candidates in zip(places, near, strict=True):
        if candidates:
            angle = 2.0 * math.pi * candidates[0][0]
            turns.setdefault(key, []).append(complex(math.cos(angle), math.sin(angle)))
    return {
        key: math.atan2(sum(own).imag, sum(own).real) / (2.0 * math.pi)
        if abs(sum(own)) > 0.5 * len(own)
        else 0.0
        for key, own in turns.items()
    }


def outcome(real_m: float, sim_m: float, noise_m: float, nearest_m: float = math.inf) -> str:
    """Outcome of a ray, from both ranges, NaN for none, and the distance of the real return to the simulated side."""
    if math.isnan(real_m):
        return "none" if math.isnan(sim_m) else "sim_only"
    if math.isnan(sim_m):
        return "dropped" if nearest_m <= 0.3 else "no_surface"
    if abs(sim_m - real_m) <= max(0.1, 3.0 * noise_m):
        return "same"
    return "in_front" if sim_m < real_m else "behind"


def scores(rays: Rays) -> dict[str, float | None]:
    """Scores of some rays, by column of `pairs`."""
    outcome = rays["outcome"]
    real_m = rays["real_range_m"]
    sim_m = rays["sim_range_m"]
    count = Counter(outcome)
    n = len(outcome) - count["none"]
    n_both = sum(count[name] for name in _OUTCOMES[:3])
    found: dict[str, float | None] = {"n_rays": n}
    found |= {f"rays_{name}": count[name] / n if n else None for name in _OUTCOMES[:-1]}
    for name, hits in (("hit", n_both), ("drop", count["none"])):
        found[f"rays_{name}_f1"] = (
            hits / (hits + (n - n_both) / 2) if hits + n - n_both else None
        )
    names = (
        "bias_m",
        "bias_low_m",
        "bias_high_m",
        "scale",
        "mae_m",
        "medae_m",
        "p90_m",
        "rmse_m",
    )
    if not n_both:
        return found | {f"rays_{name}": None for name in names}
    both = np.isin(outcome, _OUTCOMES[:3])
    errors = np.sort((sim_m - real_m)[both])
    half = 0.98 * math.sqrt(n_both)
    low = max(n_both / 2 - half, 0)
    high = min(n_both / 2 + half, n_both - 1)
    values = (
        np.median(errors),
        errors[int(low)],
        errors[int(high)],
        np.median((sim_m / real_m)[both]) - 1.0,
        abs(errors).mean(),
        *np.quantile(abs(errors), (0.5, 0.9)),
        math.sqrt((errors**2).mean()),
    )
    return found | {
        f"rays_{name}": float(value) for name, value in zip(names, values, strict=True)
    }


def intensity_scores(
    rays: Rays, intensity: Mapping[str, NDArray[Any]], *, has_one_scale: bool
) -> dict[str, float | str | None]:
    """Scores of the intensities, by column of `pairs`, with scipy's ranks, correlation and Wasserstein distance.

    Parameters
    ----------
    intensity : by side, of each ray; NaN for none, and for all rays if the side has no intensity
    """
    label = rays["label"]
    incidence_deg = rays["incidence_deg"]
    found: dict[str, float | str | None] = {}
    notes: list[str] = []
    shares: dict[str, float | None] = {}
    names = sorted({own for own in label if own is not None})
    classes = np.array([np.nan if own is None else float(names.index(own)) for own in label])
    for side, own in intensity.items():
        known = ~np.isnan(own)
        if not known.any():
            notes.append(f"{side}: no intensity")
            continue
        for name, cause, n_groups in (
            ("range", rays[f"{side}_range_m"], 20),
            ("incidence", incidence_deg, 20),
            ("class", classes, 0),
        ):
            shares[name] = found[f"intensity_{side}_by_{name}"] = _eta_squared(
                own[known], cause[known], n_groups
            )
        if known.sum() >= 100 and np.ptp(own[known]) == 0:
            notes.append(f"{side}: constant ({own[known][0]:g})")
        elif (shares["range"] or 0.0) >= 0.97:
            notes.append(f"{side}: a function of range alone")
    found["intensity_note"] = "; ".join(notes) or None
    both = (
        (rays["outcome"] == "same") & ~np.isnan(intensity["real"]) & ~np.isnan(intensity["sim"])
    )
    if both.sum() < 100:
        return found
    real = intensity["real"][both]
    sim = intensity["sim"][both]
    ranks = [(stats.rankdata(own) - 0.5) / len(own) for own in (real, sim)]
    angle = np.nan_to_num(incidence_deg[both], nan=-1.0)
    bins = np.stack(
        [
            np.digitize(rays["real_range_m"][both], (10, 20, 30, 50)),
            np.digitize(angle, (0, 30, 60, 75, 85)),
        ]
    )
    groups = [np.flatnonzero((own == bins.T).all(axis=1)) for own in np.unique(bins, axis=1).T]
    large = [own for own in groups if len(own) >= 10]
    total = sum(
        len(own) * float(stats.wasserstein_distance(ranks[0][own], ranks[1][own]))
        for own in large
    )
    varies = np.ptp(real) > 0 and np.ptp(sim) > 0
    return found | {
        "intensity_rank_corr": float(stats.spearmanr(real, sim)[0]) if varies else None,
        "intensity_rank_distance": total / sum(map(len, large)) if large else None,
        "intensity_ratio": float(sim.mean() / real.mean()) if real.mean() > 0 else None,
        "intensity_rmse": math.sqrt(((sim - real) ** 2).mean()) if has_one_scale else None,
    }


def _eta_squared(
    values: NDArray[np.float64], cause: NDArray[np.float64], n_groups: int
) -> float | None:
    """Sum of squares of ranks between groups over the total: groups of equal cause, or of about equal size."""
    values = values[~np.isnan(cause)]
    cause = cause[~np.isnan(cause)]
    if len(values) < 100 or np.ptp(values) == 0:
        return None
    groups: NDArray[Any] = cause
    if n_groups:
        groups = np.searchsorted(np.quantile(cause, np.arange(1, n_groups) / n_groups), cause)
    ranks = stats.rankdata(values) - (len(values) + 1) / 2
    between = sum(
        (groups == own).sum() * ranks[groups == own].mean() ** 2 for own in np.unique(groups)
    )
    return float(between / (ranks**2).sum())
