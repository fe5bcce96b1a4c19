"""Findings over the objects of all pairs: the numbers of the paper's section "Real experiments".

Counts and distributions pool the objects of all pairs. Means over pairs are in `stages.summary`.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING

import numpy as np

from ...schemas.columns import SIDES
from ...schemas.metric_catalogue import DISTRIBUTED
from ...schemas.results import DensityRatio, Findings, GroupMean, ObjectGroup, RankCorrelation
from ...stages.arrays import FloatArray
from ...stages.statistics.findings import BAND_NAMES, distribution, quantiles
from ...stages.summary import mean_and_std, median_of

if TYPE_CHECKING:
    import pandas as pd

#: Columns of the frame of objects that the findings use.
FINDINGS_COLUMNS = ("range_m", "band", "label", "covered_0p3m", "n_real", "n_sim", *DISTRIBUTED)
#: The paper: n_sim is from under a quarter to over four times n_real.
SPARSE_RATIO = 0.25
DENSE_RATIO = 4.0


def summarise_objects(objects: pd.DataFrame, places: Mapping[str, int]) -> Findings:
    """Compute distributions, density ratios, correlation and groups; None for missing values.

    Parameters
    ----------
    objects : of both sides without remnants, with `FINDINGS_COLUMNS`; label is "" if an object has none
    places : by pair, the number of its place
    """
    is_matched = objects["fate"] == "matched"
    matched = objects[is_matched & (objects["side"] == "real")]
    return Findings(
        n_matched=len(matched),
        distributions={name: distribution(matched[name].to_numpy()) for name in DISTRIBUTED},
        rank_correlation=rank_correlation(
            matched["cdc"].to_numpy(), matched["r_lambda"].to_numpy()
        ),
        density_ratio=density_ratio((matched["n_sim"] / matched["n_real"]).to_numpy()),
        median_matched_m=median_of(matched["range_m"].to_numpy()),
        median_unmatched_m=median_of(objects.loc[~is_matched, "range_m"].to_numpy()),
        groups=tuple(_groups(objects)),
        n_places=len(set(places.values())),
        places=dict(places),
    )


def rank_correlation(a: FloatArray, b: FloatArray) -> RankCorrelation:
    """Spearman's rho and Kendall's tau-b of the objects with both scores; None for fewer than 3 or constant scores."""
    from scipy.stats import kendalltau, spearmanr  # takes long to load

    both = ~(np.isnan(a) | np.isnan(b))
    a = a[both]
    b = b[both]
    if len(a) < 3 or np.ptp(a) == 0 or np.ptp(b) == 0:
        return RankCorrelation(n=len(a), spearman=None, kendall=None)
    spearman = float(spearmanr(a, b).statistic)
    return RankCorrelation(n=len(a), spearman=spearman, kendall=float(kendalltau(a, b).statistic))


def density_ratio(ratio: FloatArray) -> DensityRatio:
    """Quantiles of n_sim / n_real, and the shares below a quarter and above four; None without objects."""
    return DensityRatio(
        n=len(ratio),
        **quantiles(ratio),
        share_below_quarter=float(np.mean(ratio < SPARSE_RATIO)) if len(ratio) else None,
        share_above_four=float(np.mean(ratio > DENSE_RATIO)) if len(ratio) else None,
    )


def _groups(objects: pd.DataFrame) -> Iterator[ObjectGroup]:
    """The objects by range, then by class, the class with most objects first."""
    for band, name in enumerate(BAND_NAMES):
        yield _group("range", name, objects[objects["band"] == band])
    sizes = objects[objects["label"] != ""].groupby("label").size()
    for label in sizes.sort_values(ascending=False, kind="stable").index:
        yield _group("class", label, objects[objects["label"] == label])


def _group(by: str, name: str, objects: pd.DataFrame) -> ObjectGroup:
    real, sim = [objects[objects["side"] == side] for side in SIDES]
    matched = real[real["fate"] == "matched"]
    scores = {}
    for score in DISTRIBUTED:
        mean, std = mean_and_std(matched[score].to_numpy())
        scores[score] = GroupMean(mean=mean, std=std, n=int(matched[score].count()))
    return ObjectGroup(
        by=by,
        name=name,
        n_real=len(real),
        n_not_found=len(real) - len(matched),
        n_sim=len(sim),
        n_extra=int((sim["fate"] == "extra").sum()),
        n_real_points=int(real["n_points"].sum()),
        missing_share=_uncovered_share(real),
        n_sim_points=int(sim["n_points"].sum()),
        invented_share=_uncovered_share(sim),
        scores=scores,
    )


def _uncovered_share(objects: pd.DataFrame) -> float | None:
    """Share of the points of some objects without a counterpart within 0.3 m; None without points."""
    n_points = objects["n_points"]
    n_uncovered = (n_points * (1 - objects["covered_0p3m"].fillna(0.0))).sum()
    return float(n_uncovered / n_points.sum()) if n_points.any() else None
