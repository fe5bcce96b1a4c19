"""Intensity of both sides, on the rays of stage rays. Scales differ between vendors, so most scores use ranks."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..schemas.columns import SIDES
from ..schemas.results import Number
from .arrays import FloatArray, IndexArray
from .rays import INCIDENCE_EDGES_DEG, RANGE_EDGES_M, SAME, Rays

#: Least number of returns from which a score is computed; of a bin of range and incidence.
LEAST_RETURNS = 100
_LEAST_OF_BIN = 10
#: An intensity is a function of range alone if groups of equal range explain this share of the variance of its ranks.
OF_RANGE = 0.97
_GROUPS = 20


def score_intensity(
    rays: Rays,
    intensity: Sequence[FloatArray | None],
    labels: IndexArray,
    *,
    has_one_scale: bool = False,
) -> dict[str, Number | str]:
    """Scores of the intensities of a pair, by column of `pairs`; None if a side has none, or too few rays.

    `intensity_rank_corr` is Spearman's correlation over rays of the outcome *same*. `intensity_rank_distance` is the
    Wasserstein distance between the ranks of both sides (0 to 1 over these rays) in each bin of range and incidence,
    averaged over the rays. `intensity_ratio` is the mean of the simulated side over that of the real side, and
    `intensity_rmse` the root mean square difference. By range, incidence and class: `explained_share` of all returns
    of a side.

    Parameters
    ----------
    intensity : by point of the real and the simulated side, as `rays` numbers them; None if a side has none
    labels : (n,) class of each ray, -1 if unknown
    has_one_scale : True if the intensities of both sides have one scale, so that their differences mean something
    """
    scores: dict[str, Number | str] = {}
    notes = []
    of_rays = []
    is_compared = rays.outcome == SAME
    returns = ((rays.real_row, rays.real_range_m), (rays.sim_row, rays.sim_range_m))
    for side, values, (rows, range_m) in zip(SIDES, intensity, returns, strict=True):
        if values is None:
            notes.append(f"{side}: no intensity")
            continue
        of_ray = np.where(rows >= 0, values[rows], np.nan)
        is_known = ~np.isnan(of_ray)
        groups = {
            "range": _equal_counts(np.where(is_known, range_m, np.nan)),
            "incidence": _equal_counts(np.where(is_known, rays.incidence_deg, np.nan)),
            "class": np.where(is_known, labels, -1),
        }
        for cause, group in groups.items():
            scores[f"intensity_{side}_by_{cause}"] = explained_share(of_ray, group)
        law = intensity_law(of_ray[is_known], range_m[is_known])
        if law:
            notes.append(f"{side}: {law}")
        is_compared &= is_known
        of_rays.append(of_ray)
    if len(of_rays) == len(SIDES) and is_compared.sum() >= LEAST_RETURNS:
        real, sim = of_rays
        bins = _bins_of(rays)[is_compared]
        scores |= _compare(real[is_compared], sim[is_compared], bins, has_one_scale)
    return scores | {"intensity_note": "; ".join(notes) or None}


def _bins_of(rays: Rays) -> IndexArray:
    """(n,) bin of range and incidence of each ray."""
    incidence_deg = np.nan_to_num(rays.incidence_deg, nan=-1.0)
    range_bin = np.digitize(rays.real_range_m, RANGE_EDGES_M)
    incidence_bin = np.digitize(incidence_deg, INCIDENCE_EDGES_DEG)
    return range_bin * (len(INCIDENCE_EDGES_DEG) + 1) + incidence_bin


def _compare(
    real: FloatArray,
    sim: FloatArray,
    bins: IndexArray,
    has_one_scale: bool,
) -> dict[str, Number | str]:
    """Scores of the intensities that both sides have, by column of `pairs`."""
    real_ranks = mean_ranks(real)
    sim_ranks = mean_ranks(sim)
    correlation = ratio = rmse = None
    if np.ptp(real_ranks) and np.ptp(sim_ranks):
        correlation = float(np.corrcoef(real_ranks, sim_ranks)[0, 1])
    if real.mean() > 0:
        ratio = float(sim.mean() / real.mean())
    if has_one_scale:
        rmse = float(np.sqrt(((sim - real) ** 2).mean()))
    return {
        "intensity_rank_corr": correlation,
        "intensity_rank_distance": _rank_distance(real_ranks, sim_ranks, bins),
        "intensity_ratio": ratio,
        "intensity_rmse": rmse,
    }


def intensity_law(intensity: FloatArray, range_m: FloatArray) -> str:
    """`constant (0.3)`, `a function of range alone`, or "" if it is neither, or there are too few returns.

    Parameters
    ----------
    intensity, range_m : (n,) float64
    """
    if len(intensity) < LEAST_RETURNS:
        return ""
    if np.ptp(intensity) == 0:
        return f"constant ({intensity[0]:g})"
    share = explained_share(intensity, _equal_counts(range_m))
    return "a function of range alone" if share is not None and share >= OF_RANGE else ""


def explained_share(intensity: FloatArray, groups: IndexArray) -> float | None:
    """Share of the variance of the intensity's ranks that groups explain (eta squared).

    None if it is constant, or fewer than 100 returns have a group.

    Parameters
    ----------
    groups : (n,) number of the group of each return; -1 for none

    Examples
    --------
    >>> import numpy as np
    >>> explained_share(np.repeat([10.0, 20.0], 100), np.repeat([0, 1], 100))
    1.0
    """
    intensity = intensity[groups >= 0]
    groups = groups[groups >= 0]
    if len(intensity) < LEAST_RETURNS or np.ptp(intensity) == 0:
        return None
    ranks = mean_ranks(intensity) - 0.5
    counts = np.bincount(groups)
    sums = np.bincount(groups, ranks)[counts > 0]
    return float((sums**2 / counts[counts > 0]).sum() / (ranks**2).sum())


def mean_ranks(values: FloatArray) -> FloatArray:
    """(n,) ranks between 0 and 1 with mean 0.5; equal values share the mean of their ranks.

    Examples
    --------
    >>> mean_ranks(np.array([3.0, 5.0, 3.0, 9.0])).tolist()
    [0.25, 0.625, 0.25, 0.875]
    """
    from scipy.stats import rankdata  # takes long to load

    return (rankdata(values) - 0.5) / len(values)


def _equal_counts(values: FloatArray) -> IndexArray:
    """(n,) number of the group, of twenty with about equal counts; -1 for NaN."""
    groups = np.full(len(values), -1, dtype=int)
    is_known = ~np.isnan(values)
    known = values[is_known]
    if len(known):
        limits = np.quantile(known, np.arange(1, _GROUPS) / _GROUPS)
        groups[is_known] = np.searchsorted(limits, known)
    return groups


def _rank_distance(real: FloatArray, sim: FloatArray, bins: IndexArray) -> float | None:
    """Mean over rays of the Wasserstein distance between the ranks of both sides in the ray's bin."""
    total = 0.0
    n_rays = 0
    for number in np.unique(bins):
        is_in = bins == number
        n = int(is_in.sum())
        if n >= _LEAST_OF_BIN:
            total += float(np.abs(np.sort(real[is_in]) - np.sort(sim[is_in])).sum())
            n_rays += n
    return total / n_rays if n_rays else None
