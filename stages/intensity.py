"""Intensity of both sides, on the rays of stage rays. Scales differ between vendors, so most scores use ranks."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..schemas.columns import SIDES
from ..schemas.results import Number
from .arrays import BoolArray, FloatArray, IndexArray
from .rays import INCIDENCE_EDGES_DEG, RANGE_EDGES_M, SAME, Rays

#: Least number of returns from which a score is computed; of a bin of range and incidence.
LEAST_RETURNS, _LEAST_OF_BIN = 100, 10
#: An intensity is a function of range alone if groups of equal range explain this share of the variance of its ranks.
OF_RANGE = 0.97
_GROUPS = 20


def score_intensity(
    rays: Rays, intensity: Sequence[FloatArray | None], labels: IndexArray, *, has_one_scale: bool = False
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
    notes, values = [], []
    is_compared = rays.outcome == SAME
    returns = (rays.real_row, rays.real_range_m), (rays.sim_row, rays.sim_range_m)
    for side, own, (rows, range_m) in zip(SIDES, intensity, returns, strict=True):
        if own is None:
            notes.append(f"{side}: no intensity")
            continue
        found = np.where(rows >= 0, own[rows], np.nan)
        is_known = ~np.isnan(found)
        groups = _equal_counts(range_m, is_known), _equal_counts(rays.incidence_deg, is_known), labels
        for cause, group in zip(("range", "incidence", "class"), groups, strict=True):
            scores[f"intensity_{side}_by_{cause}"] = explained_share(found, np.where(is_known, group, -1))
        if law := intensity_law(found[is_known], range_m[is_known]):
            notes.append(f"{side}: {law}")
        is_compared &= is_known
        values.append(found)
    if len(values) == len(SIDES) and is_compared.sum() >= LEAST_RETURNS:
        real, sim = (own[is_compared] for own in values)
        ranks = mean_ranks(real), mean_ranks(sim)
        incidence_deg = np.nan_to_num(rays.incidence_deg, nan=-1.0)
        bins = [np.digitize(rays.real_range_m, RANGE_EDGES_M), np.digitize(incidence_deg, INCIDENCE_EDGES_DEG)]
        scores |= {
            "intensity_rank_corr": float(np.corrcoef(*ranks)[0, 1]) if min(map(np.ptp, ranks)) else None,
            "intensity_rank_distance": _rank_distance(*ranks, np.ravel_multi_index(bins, (16, 16))[is_compared]),
            "intensity_ratio": float(sim.mean() / real.mean()) if real.mean() > 0 else None,
            "intensity_rmse": float(np.sqrt(((sim - real) ** 2).mean())) if has_one_scale else None,
        }
    return scores | {"intensity_note": "; ".join(notes) or None}


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
    share = explained_share(intensity, _equal_counts(range_m, np.ones(len(range_m), dtype=np.bool_)))
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
    intensity, groups = intensity[groups >= 0], groups[groups >= 0]
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
    _, ids, counts = np.unique(values, return_inverse=True, return_counts=True)
    return ((np.cumsum(counts) - counts / 2) / len(values))[ids]


def _equal_counts(values: FloatArray, is_chosen: BoolArray) -> IndexArray:
    """(n,) number of the group, of twenty with about equal counts; -1 if not chosen or NaN."""
    groups = np.full(len(values), -1, dtype=np.intp)
    is_known = is_chosen & ~np.isnan(values)
    known = values[is_known]
    if len(known):
        groups[is_known] = np.searchsorted(np.quantile(known, np.arange(1, _GROUPS) / _GROUPS), known)
    return groups


def _rank_distance(real: FloatArray, sim: FloatArray, bins: IndexArray) -> float | None:
    """Mean over rays of the Wasserstein distance between the ranks of both sides in the ray's bin."""
    total, n_rays = 0.0, 0
    for number in np.unique(bins):
        own = bins == number
        if (n := int(own.sum())) >= _LEAST_OF_BIN:
            total += float(np.abs(np.sort(real[own]) - np.sort(sim[own])).sum())
            n_rays += n
    return total / n_rays if n_rays else None
