"""Findings over the objects of all pairs: the numbers of the paper's section "Real experiments".

Counts and distributions pool the objects of all pairs. Means over pairs are in `stages.summary`.
"""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ...schemas.metric_catalogue import DISTRIBUTED
from ...schemas.results import (
    ClassFindings,
    DensityRatio,
    GroupMean,
    ObjectFindings,
    RangeBand,
    RangeFindings,
    RankCorrelation,
    ScoreDistributions,
    Unmatched,
)
from ...stages.arrays import FloatArray
from ...stages.statistics.findings import BAND_EDGES_M, distribution, quantiles
from ...stages.summary import mean_and_std, median_of

if TYPE_CHECKING:
    import pandas as pd

#: Columns of the frame of objects that the findings use.
FINDINGS_COLUMNS = ("range_m", "band", "label", "n_real", "n_sim", *DISTRIBUTED)
#: The paper: n_sim is from under a quarter to over four times n_real.
SPARSE_RATIO = 0.25
DENSE_RATIO = 4.0


def summarise_objects(objects: pd.DataFrame, n_pairs: int) -> ObjectFindings:
    """Compute distributions, ranges, classes, density ratios and correlation; None for missing values.

    Parameters
    ----------
    objects : of both sides without remnants, with `FINDINGS_COLUMNS`; label is "" if an object has none
    n_pairs : number of pairs, also of those without objects
    """
    is_matched = objects["fate"] == "matched"
    matched = objects[is_matched & (objects["side"] == "real")]
    scores = {name: distribution(matched[name].to_numpy()) for name in DISTRIBUTED}
    return ObjectFindings(
        n_pairs=n_pairs,
        n_matched=len(matched),
        distributions=ScoreDistributions(**scores),
        rank_correlation=rank_correlation(
            matched["cdc"].to_numpy(), matched["r_lambda"].to_numpy()
        ),
        density_ratio=density_ratio((matched["n_sim"] / matched["n_real"]).to_numpy()),
        range_m=RangeFindings(
            median_matched=median_of(matched["range_m"].to_numpy()),
            median_unmatched=median_of(objects.loc[~is_matched, "range_m"].to_numpy()),
            bands=_by_range(objects),
        ),
        classes=_by_class(objects, matched),
    )


def rank_correlation(a: FloatArray, b: FloatArray) -> RankCorrelation:
    """Spearman's rho and Kendall's tau-b of the objects with both scores; None for fewer than 3 or constant scores.

    Equal to those of scipy.stats, whose import takes as long as all else at the end of a run.
    """
    both = ~(np.isnan(a) | np.isnan(b))
    a = a[both]
    b = b[both]
    if len(a) < 3 or np.ptp(a) == 0 or np.ptp(b) == 0:
        return RankCorrelation(n=len(a), spearman=None, kendall=None)
    _, rank_a, n_a = np.unique(a, return_inverse=True, return_counts=True)
    _, rank_b, n_b = np.unique(b, return_inverse=True, return_counts=True)
    mean_ranks_a = (np.cumsum(n_a) - (n_a - 1) / 2)[rank_a]
    mean_ranks_b = (np.cumsum(n_b) - (n_b - 1) / 2)[rank_b]
    _, n_both = np.unique(rank_a * len(n_b) + rank_b, return_counts=True)
    n_pairs, ties_a, ties_b, ties = (_n_pairs(n) for n in (np.array(len(a)), n_a, n_b, n_both))
    n_discordant = _n_inversions(rank_b[np.lexsort((rank_b, rank_a))])
    difference = n_pairs - ties_a - ties_b + ties - 2 * n_discordant
    kendall = difference / np.sqrt(n_pairs - ties_a) / np.sqrt(n_pairs - ties_b)
    return RankCorrelation(
        n=len(a),
        spearman=float(np.corrcoef(mean_ranks_a, mean_ranks_b)[0, 1]),
        kendall=float(np.clip(kendall, -1, 1)),
    )


def _n_pairs(group_sizes: NDArray[np.integer]) -> int:
    """Number of pairs within groups."""
    return int((group_sizes * (group_sizes - 1) // 2).sum())


def _n_inversions(ranks: NDArray[np.integer]) -> int:
    """Number of pairs of a sequence whose first rank is the larger one, bit by bit of the ranks."""
    n_inversions = 0
    for bit in range(int(ranks.max()).bit_length()):
        ordered = ranks[np.argsort(ranks >> bit + 1, kind="stable")]
        group = ordered >> bit + 1
        is_larger = ordered >> bit & 1
        n_larger_before = np.cumsum(is_larger) - is_larger
        n_in_group = n_larger_before - n_larger_before[np.searchsorted(group, group)]
        n_inversions += int(n_in_group[is_larger == 0].sum())
    return n_inversions


def density_ratio(ratio: FloatArray) -> DensityRatio:
    """Quantiles of n_sim / n_real, and the shares below a quarter and above four; None without objects."""
    return DensityRatio(
        n=len(ratio),
        **quantiles(ratio),
        share_below_quarter=float(np.mean(ratio < SPARSE_RATIO)) if len(ratio) else None,
        share_above_four=float(np.mean(ratio > DENSE_RATIO)) if len(ratio) else None,
    )


def _by_range(objects: pd.DataFrame) -> tuple[RangeBand, ...]:
    """Objects not found and extra ones by distance from the sensor on their side; the last band has no end."""
    bands = []
    for i, (low, high) in enumerate(pairwise([*BAND_EDGES_M, None])):
        counts = _unmatched(objects[objects["band"] == i])
        bands.append(RangeBand(from_m=low, to_m=high, **vars(counts)))
    return tuple(bands)


def _by_class(objects: pd.DataFrame, matched: pd.DataFrame) -> tuple[ClassFindings, ...]:
    """Objects not found, extra ones and scores by class, the class with most objects first; () without labels.

    A matched object has the class of its real side. Each score has its mean, standard deviation (n - 1) and number of
    objects.
    """
    sizes = objects[objects["label"] != ""].groupby("label").size()
    rows = []
    for label in sizes.sort_values(ascending=False, kind="stable").index:
        of_class = matched[matched["label"] == label]
        scores = {}
        for name in DISTRIBUTED:
            mean, std = mean_and_std(of_class[name].to_numpy())
            scores[name] = GroupMean(mean=mean, std=std, n=int(of_class[name].count()))
        counts = _unmatched(objects[objects["label"] == label])
        rows.append(
            ClassFindings(label=label, **vars(counts), n_matched=len(of_class), scores=scores)
        )
    return tuple(rows)


def _unmatched(objects: pd.DataFrame) -> Unmatched:
    """Objects of each side, and those of them that the other side lacks."""
    n_real = int((objects["side"] == "real").sum())
    n_sim = len(objects) - n_real
    n_not_found = int((objects["fate"] == "not_found").sum())
    n_extra = int((objects["fate"] == "extra").sum())
    return Unmatched(
        n_real=n_real,
        n_not_found=n_not_found,
        not_found_share=n_not_found / n_real if n_real else None,
        n_sim=n_sim,
        n_extra=n_extra,
        extra_share=n_extra / n_sim if n_sim else None,
    )
