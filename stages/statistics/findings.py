"""Findings over the objects of all pairs: the numbers of the paper's section "Real experiments".

Counts and distributions pool the objects of all pairs. Means over pairs are in `summary`.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from ...schemas.metric_catalogue import DISTRIBUTED
from ...schemas.results import (
    ClassFindings,
    DensityRatio,
    Distribution,
    GroupMean,
    ObjectFindings,
    RangeBand,
    RangeFindings,
    RankCorrelation,
    ScoreDistributions,
    Unmatched,
)
from ..arrays import BoolArray, FloatArray, IntArray
from ..summary import mean_and_std, median_of

#: Edges of the range bands, metres; the last band has no end.
BAND_EDGES_M = (0.0, 10.0, 20.0, 30.0, 50.0)
BAND_NAMES = (
    *(f"{low:.0f} to {high:.0f} m" for low, high in pairwise(BAND_EDGES_M)),
    f"over {BAND_EDGES_M[-1]:.0f} m",
)
#: The paper: n_sim is from under a quarter to over four times n_real.
SPARSE_RATIO = 0.25
DENSE_RATIO = 4.0
_QUANTILES = {
    "min": 0.0,
    "q05": 0.05,
    "q25": 0.25,
    "median": 0.5,
    "q75": 0.75,
    "q95": 0.95,
    "max": 1.0,
}


@dataclass(frozen=True)
class Objects:
    """Objects of both sides of all pairs.

    is_real : (n,) True if it is of the real side
    range_m : (n,) distance of the centroid from the sensor
    label : (n,) class, "" if the object has none
    is_matched : (n,) True if the other side has it too
    n_real, n_sim : (n,) points of a matched object on both sides
    cdc, r_lambda, r_gap : (n,) scores of a matched object, NaN for null
    """

    is_real: BoolArray
    range_m: FloatArray
    label: NDArray[np.str_]
    is_matched: BoolArray
    n_real: IntArray
    n_sim: IntArray
    cdc: FloatArray
    r_lambda: FloatArray
    r_gap: FloatArray

    @property
    def matched(self) -> Objects:
        """The matched ones, each once, with the place of the real object."""
        chosen = self.is_matched & self.is_real
        return Objects(**{name: values[chosen] for name, values in vars(self).items()})


def summarise_objects(objects: Objects, n_pairs: int) -> ObjectFindings:
    """Compute distributions, ranges, classes, density ratios and correlation; None for missing values.

    Parameters
    ----------
    objects : of both sides
    n_pairs : number of pairs, also of those without objects
    """
    matched = objects.matched
    return ObjectFindings(
        n_pairs=n_pairs,
        n_matched=len(matched.range_m),
        distributions=ScoreDistributions(
            cdc=distribution(matched.cdc),
            r_lambda=distribution(matched.r_lambda),
            r_gap=distribution(matched.r_gap),
        ),
        rank_correlation=rank_correlation(matched.cdc, matched.r_lambda),
        density_ratio=density_ratio(matched.n_real, matched.n_sim),
        range_m=RangeFindings(
            median_matched=median_of(matched.range_m),
            median_unmatched=median_of(objects.range_m[~objects.is_matched]),
            bands=by_range(objects),
        ),
        classes=by_class(objects),
    )


def distribution(values: FloatArray) -> Distribution:
    """Number, quantiles, mean, standard deviation (n - 1) and coefficient of variation of some values.

    The coefficient of variation is standard deviation / mean: a score that varies more relative to its mean
    distinguishes objects better (the paper, "Real experiments"). NaN is left out; None if too few values remain.

    Examples
    --------
    >>> distribution(np.array([1.0, np.nan, 3.0])).median
    2.0
    """
    known = values[~np.isnan(values)]
    mean, std = mean_and_std(known)
    return Distribution(
        n=len(known),
        **_quantiles(known),
        mean=mean,
        std=std,
        cv=std / mean if mean and std is not None else None,
    )


def rank_correlation(a: FloatArray, b: FloatArray) -> RankCorrelation:
    """Spearman's rho and Kendall's tau-b of the objects with both scores; None for fewer than 3 or constant scores.

    The values of `scipy.stats`, whose import takes a sixth of the memory of a run.
    """
    both = ~(np.isnan(a) | np.isnan(b))
    a = a[both]
    b = b[both]
    n = len(a)
    if n < 3 or np.ptp(a) == 0 or np.ptp(b) == 0:
        return RankCorrelation(n=n, spearman=None, kendall=None)
    places_a, counts_a = np.unique(a, return_inverse=True, return_counts=True)[1:]
    places_b, counts_b = np.unique(b, return_inverse=True, return_counts=True)[1:]
    ranks_a = (np.cumsum(counts_a) - (counts_a - 1) / 2)[places_a]
    ranks_b = (np.cumsum(counts_b) - (counts_b - 1) / 2)[places_b]
    spearman = float(np.corrcoef([ranks_a, ranks_b])[1, 0])
    concordant = _n_inversions(-places_b[np.lexsort((-places_b, places_a))])
    discordant = _n_inversions(places_b[np.lexsort((places_b, places_a))])
    untied_a = np.sqrt(n * (n - 1) // 2 - (counts_a * (counts_a - 1) // 2).sum())
    untied_b = np.sqrt(n * (n - 1) // 2 - (counts_b * (counts_b - 1) // 2).sum())
    tau = np.clip((concordant - discordant) / untied_a / untied_b, -1.0, 1.0)
    return RankCorrelation(n=n, spearman=spearman, kendall=float(tau))


def _n_inversions(values: NDArray[np.intp]) -> int:
    """Number of pairs of values of which the larger one comes first."""
    if len(values) <= 64:  # from here on faster than a sort
        return int(np.triu(values[:, None] > values, 1).sum())
    left, right = np.array_split(values, 2)
    n_not_larger = int(np.searchsorted(np.sort(left), right, side="right").sum())
    return _n_inversions(left) + _n_inversions(right) + len(left) * len(right) - n_not_larger


def density_ratio(n_real: IntArray, n_sim: IntArray) -> DensityRatio:
    """Quantiles of n_sim / n_real, and the shares below a quarter and above four; None without objects."""
    ratio = n_sim / n_real
    return DensityRatio(
        n=len(ratio),
        **_quantiles(ratio),
        share_below_quarter=float(np.mean(ratio < SPARSE_RATIO)) if len(ratio) else None,
        share_above_four=float(np.mean(ratio > DENSE_RATIO)) if len(ratio) else None,
    )


def by_range(objects: Objects) -> tuple[RangeBand, ...]:
    """Objects not found and extra ones by distance from the sensor on their side; the last band has no end."""
    bands = []
    for low, high in pairwise([*BAND_EDGES_M, np.inf]):
        counts = _unmatched(objects, (objects.range_m >= low) & (objects.range_m < high))
        bands.append(RangeBand(from_m=low, to_m=None if high == np.inf else high, **vars(counts)))
    return tuple(bands)


def by_class(objects: Objects) -> tuple[ClassFindings, ...]:
    """Objects not found, extra ones and scores by class, the class with most objects first; () without labels.

    A matched object has the class of its real side. Each score has its mean, standard deviation (n - 1) and number of
    objects.
    """
    labels, counts = np.unique(objects.label, return_counts=True)
    matched = objects.matched
    rows = []
    for label in labels[np.argsort(-counts, kind="stable")].tolist():
        if not label:
            continue
        is_of_class = matched.label == label
        scores = {name: _group_mean(getattr(matched, name)[is_of_class]) for name in DISTRIBUTED}
        rows.append(
            ClassFindings(
                label=label,
                **vars(_unmatched(objects, objects.label == label)),
                n_matched=int(np.count_nonzero(is_of_class)),
                scores=scores,
            )
        )
    return tuple(rows)


def _group_mean(values: FloatArray) -> GroupMean:
    mean, std = mean_and_std(values)
    return GroupMean(mean=mean, std=std, n=int(np.count_nonzero(~np.isnan(values))))


def evenly(n: int, most: int) -> list[int]:
    """Places of at most `most` of n things, evenly over their order, the first and the last among them.

    Examples
    --------
    >>> evenly(9, 3), evenly(2, 3), evenly(0, 3)
    ([0, 4, 8], [0, 1], [])
    """
    return list(map(int, np.unique(np.linspace(0, n - 1, min(n, most)).round())))


def _unmatched(objects: Objects, in_group: BoolArray) -> Unmatched:
    """Objects of each side in a group, and those of them that the other side lacks."""
    in_real = in_group & objects.is_real
    in_sim = in_group & ~objects.is_real
    n_real = int(np.count_nonzero(in_real))
    n_sim = int(np.count_nonzero(in_sim))
    n_not_found = int(np.count_nonzero(in_real & ~objects.is_matched))
    n_extra = int(np.count_nonzero(in_sim & ~objects.is_matched))
    return Unmatched(
        n_real=n_real,
        n_not_found=n_not_found,
        not_found_share=n_not_found / n_real if n_real else None,
        n_sim=n_sim,
        n_extra=n_extra,
        extra_share=n_extra / n_sim if n_sim else None,
    )


def _quantiles(values: FloatArray) -> dict[str, float | None]:
    if not len(values):
        return dict.fromkeys(_QUANTILES)
    return {name: float(np.quantile(values, q)) for name, q in _QUANTILES.items()}
