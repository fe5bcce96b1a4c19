"""The paper's claims about real and simulated scans, checked on the objects of a run.

Each claim of the paper's section "Real experiments" (and of its remarks on density and classes) that a number can check
is one row: claim, the paper's value, the value here with its interval, the rule, the verdict. The rules are in
`claim_rules`. Left out are claims that are read off pictures, those of the perturbation experiment (`sweep_claims`),
and that r_lambda is larger than r_gap, which no data can deny: r_gap is at most half of r_lambda by its definition.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...schemas.metric_catalogue import metric_of
from ..arrays import BoolArray, FloatArray, IntArray
from ..statistics.comparison import blocks_of
from ..statistics.findings import (
    DENSE_RATIO,
    SPARSE_RATIO,
    MatchedObjects,
    SideObjects,
    chain_apart,
    peak_density,
    std_by_pair,
)
from .claim_rules import (
    Claim,
    Interval,
    Sample,
    above_zero,
    complementary,
    in_most_pairs,
    in_some_pairs,
    near,
    order,
    over_pairs,
    share_order,
)
from .paper_values import MEDIAN_UNMATCHED_RANGE_M, N_MATCHED, N_PAIRS

#: "Consistently" across scans: in at least this share of them.
CONSISTENT_SHARE = 0.9
#: The smallest CDC of the paper's data.
LEAST_CDC = 0.4

_COPY = -1
_ALL = slice(None)
_FOLIAGE = ("tree", "vegetation")


def check_run_claims(
    real: SideObjects,
    sim: SideObjects,
    matched: MatchedObjects,
    contents: Sequence[str],
    real_scans: Sequence[str],
    timestamps_s: Sequence[float | None],
) -> list[Claim]:
    """All claims with their verdicts; `not decided`, with the reason, if there are too few data or none.

    Parameters
    ----------
    real, sim, matched : the objects of all pairs
    contents : by pair, a hash of all inputs of its scores: a copy of an earlier pair is left out
    real_scans : by pair, a hash of its real scan: pairs of one real scan count as one
    timestamps_s : by pair, time of the scan, None if unknown: scans within 10 s count as one
    """
    first: dict[str, int] = {}
    kept = [i for i, content in enumerate(contents) if first.setdefault(content, i) == i]
    blocks = np.full(len(contents), _COPY, dtype=np.int32)
    blocks[kept] = blocks_of([real_scans[i] for i in kept], [timestamps_s[i] for i in kept])
    data = _RunObjects(real, sim, matched, blocks)
    apart = [kept[i] for i in chain_apart([timestamps_s[i] for i in kept])]
    parts = (_means, _unmatched, _extremes, _distributions, lambda own: _within_scans(own, apart), _classes)
    return [claim for part in parts for claim in part(data)]


@dataclass(frozen=True)
class _RunObjects:
    """The objects of all pairs; `blocks` is the independent pair of each pair, or -1 for a copy."""

    real: SideObjects
    sim: SideObjects
    matched: MatchedObjects
    blocks: IntArray

    def sample(self, values: NDArray[Any], pair: IntArray, name: str = "") -> Sample:
        """Values with the independent pairs that they come from, without NaN and copies."""
        block = self.blocks[pair]
        known = (block != _COPY) & ~np.isnan(values.astype(np.float64))
        return Sample(values[known], block[known], name)

    def matches(self, values: NDArray[Any], name: str = "", chosen: BoolArray | slice = _ALL) -> Sample:
        """Values of the matched objects, or of some of them."""
        return self.sample(values[chosen], self.matched.pair[chosen], name)

    def of_pairs(self, values: NDArray[Any], name: str = "") -> Sample:
        """Values of the pairs themselves."""
        return self.sample(values, np.arange(len(self.blocks), dtype=np.int32), name)

    def pair_means(self, scores: FloatArray, name: str = "") -> Sample:
        """The mean of a score over the matched objects of each pair."""
        known = ~np.isnan(scores)
        n, total = (
            np.bincount(self.matched.pair[known], weights, len(self.blocks)) for weights in (None, scores[known])
        )
        return self.of_pairs(np.divide(total, n, out=np.full(len(n), np.nan), where=n > 0), name)

    def unmatched(self, side: SideObjects, name: str, chosen: BoolArray) -> Sample:
        """Sample of objects of a side: True if the other side lacks them."""
        return self.sample(~side.is_matched[chosen], side.pair[chosen], name)

    def unmatched_sides(self) -> Iterator[tuple[SideObjects, str, str]]:
        """Both sides with the paper's words for an unmatched object and for the side."""
        yield self.real, "missing", "real"
        yield self.sim, "hallucinated", "simulated"


def _means(data: _RunObjects) -> Iterator[Claim]:
    n_pairs = len(data.blocks)
    n_matched, n_real, n_sim = (
        np.bincount(objects.pair, minlength=n_pairs) for objects in (data.matched, data.real, data.sim)
    )
    rates = np.divide(n_matched, np.maximum(n_real, n_sim), out=np.full(n_pairs, np.nan), where=n_real + n_sim > 0)
    for column, values in (
        ("match_rate", data.of_pairs(rates)),
        *((f"{name}_mean", data.pair_means(getattr(data.matched, name))) for name in ("cdc", "r_lambda", "r_gap")),
    ):
        metric = metric_of(column)
        if (paper := metric.paper) is not None:
            bounds, interval = (paper.mean - paper.std, paper.mean + paper.std), over_pairs(np.mean, values)
            yield near(f"mean {metric.heading} over pairs", "mean over pairs", bounds, interval, paper=f"{paper}")
    claim = f"matched objects per pair (the paper: {N_MATCHED:,} in {N_PAIRS})"
    yield _near_paper(claim, "mean over pairs", N_MATCHED / N_PAIRS, over_pairs(np.mean, data.of_pairs(n_matched)))


def _unmatched(data: _RunObjects) -> Iterator[Claim]:
    real, sim = data.real, data.sim
    both_m, pair = np.concatenate([real.range_m, sim.range_m]), np.concatenate([real.pair, sim.pair])
    is_unmatched = ~np.concatenate([real.is_matched, sim.is_matched])
    unmatched_m = data.sample(both_m[is_unmatched], pair[is_unmatched], "unmatched")
    matched_m = data.sample(real.range_m[real.is_matched], real.pair[real.is_matched], "matched")
    claim, interval = "median range of unmatched objects, m", over_pairs(np.median, unmatched_m)
    yield _near_paper(claim, "median over objects", MEDIAN_UNMATCHED_RANGE_M, interval)
    claim, what = "unmatched objects lie farther away than matched ones", "median range in metres"
    yield order(claim, what, np.median, unmatched_m, matched_m, pattern="{:.1f} and {:.1f}")
    all_m = data.sample(both_m, pair).values
    middle_m = np.median(all_m) if len(all_m) else np.inf
    for side, status, name in data.unmatched_sides():
        far = side.range_m >= middle_m
        yield share_order(
            f"more of the distant {name} objects are {status}",
            f"share that is {status}",
            data.unmatched(side, "beyond the median range", far),
            data.unmatched(side, "nearer", ~far),
        )


def _extremes(data: _RunObjects) -> Iterator[Claim]:
    cdc, ratio = data.matched.cdc, data.matched.n_sim / data.matched.n_real
    for claim, paper, values, has_it, extreme, what, pattern in (
        (
            "n_sim / n_real goes below a quarter",
            "< 1/4",
            ratio,
            ratio < SPARSE_RATIO,
            np.min,
            "ratio below a quarter",
            "{:.2f}",
        ),
        ("n_sim / n_real goes above four", "> 4", ratio, ratio > DENSE_RATIO, np.max, "ratio above four", "{:.2f}"),
        ("CDC takes no value below 0.4", "0.40", cdc, cdc < LEAST_CDC, np.min, f"CDC below {LEAST_CDC}", "{:.3f}"),
    ):
        known = data.matches(values).values
        text = pattern.format(extreme(known)) if len(known) else "-"
        pairs, exists = _by_pair(data.matches(has_it), np.any), "no value" not in claim
        yield in_some_pairs(claim, f"an object has a {what}", pairs, text, paper=paper, exists=exists)


def _distributions(data: _RunObjects) -> Iterator[Claim]:
    matched = data.matched
    cdc, r_lambda, r_gap = (data.pair_means(getattr(matched, name), name) for name in ("cdc", "r_lambda", "r_gap"))
    yield above_zero(
        "mean CDC is substantially larger than mean r_lambda",
        "difference of the means minus the sum of their std over pairs",
        " and ".join(f"{np.mean(own.values):.3f}" if len(own.values) else "-" for own in (cdc, r_lambda)),
        over_pairs(lambda a, b: np.mean(a) - np.mean(b) - _std(a) - _std(b), cdc, r_lambda),
        "0.75 and 0.37",
    )
    yield order("r_lambda is more variable than r_gap", "std over pairs", _std, r_lambda, r_gap, paper="0.03 and 0.014")
    cdc, r_lambda = data.matches(matched.cdc, "CDC"), data.matches(matched.r_lambda, "r_lambda")
    for claim, what, statistic, larger, smaller in (
        ("r_lambda varies more than CDC relative to its mean", "std / mean over objects", _variation, r_lambda, cdc),
        ("r_lambda spans a wider range than CDC", "95 % minus 5 % quantile over objects", _span, r_lambda, cdc),
        (
            *("the peak of CDC is higher and sharper than that of r_lambda", "density of the fullest bin of 0.05"),
            *(peak_density, cdc, r_lambda),
        ),
    ):
        yield order(claim, what, statistic, larger, smaller)
    known = ~(np.isnan(matched.cdc) | np.isnan(matched.r_lambda)) & (data.blocks[matched.pair] != _COPY)
    scores = np.column_stack([matched.cdc, matched.r_lambda])[known]
    traits = np.column_stack([matched.range_m, matched.n_real, matched.n_sim / matched.n_real])[known]
    block = data.blocks[matched.pair[known]]
    claim, names = "CDC and r_lambda are complementary, not redundant", "range, number of points or density ratio"
    yield complementary(claim, Sample(scores, block), Sample(traits, block, names))


def _within_scans(data: _RunObjects, apart: Sequence[int]) -> Iterator[Claim]:
    """Claims about the variation of the scores over the objects of one scan; pairs that count as one are averaged."""
    matched, n_pairs = data.matched, len(data.blocks)
    wider = std_by_pair(matched.r_lambda, matched.pair, n_pairs) - std_by_pair(matched.cdc, matched.pair, n_pairs)
    yield in_most_pairs(
        "within a scan r_lambda varies more than CDC, consistently",
        "std over a pair's objects, r_lambda > CDC",
        _by_pair(data.of_pairs(wider), lambda own: np.mean(own) > 0),
        CONSISTENT_SHARE,
    )
    wider = np.full(n_pairs, np.nan)
    for pair in apart if len(apart) > 1 else ():
        own = [scores[(matched.pair == pair) & ~np.isnan(scores)] for scores in (matched.r_lambda, matched.cdc)]
        if all(len(scores) for scores in own):
            r_lambda, cdc = (np.subtract(*np.quantile(scores, [0.75, 0.25])) for scores in own)
            wider[pair] = r_lambda - cdc
    yield in_most_pairs(
        "in scans over a minute apart, r_lambda varies more than CDC",
        "interquartile range over a scan's objects, r_lambda > CDC",
        _by_pair(data.of_pairs(wider), lambda own: np.mean(own) > 0),
        CONSISTENT_SHARE,
        paper="4 of 4 scans",
    )


def _classes(data: _RunObjects) -> Iterator[Claim]:
    matched = data.matched
    foliage, solid = "trees and vegetation", "cars and walls"
    for side, status, name in data.unmatched_sides():
        yield share_order(
            f"trees and vegetation are {status} more often than cars and walls",
            f"share of {name} objects that is {status}",
            data.unmatched(side, foliage, np.isin(side.label, _FOLIAGE)),
            data.unmatched(side, solid, np.isin(side.label, ("car", "wall"))),
        )
    is_tree = (matched.label == "tree") & (data.blocks[matched.pair] != _COPY)
    middle_m = np.median(matched.range_m[is_tree]) if is_tree.any() else np.inf
    yield order(
        "near trees keep their structure, distant ones less",
        "mean r_lambda of trees",
        np.mean,
        data.matches(matched.r_lambda, "the farther half", is_tree & (matched.range_m >= middle_m)),
        data.matches(matched.r_lambda, "the nearer one", is_tree & (matched.range_m < middle_m)),
        paper="0.70 and 0.27",
    )
    excess = matched.cdc - matched.r_lambda
    yield order(
        "CDC exceeds r_lambda more for trees and vegetation than for cars",
        "mean of CDC minus r_lambda (the paper: of a near tree and of a car)",
        np.mean,
        data.matches(excess, foliage, np.isin(matched.label, _FOLIAGE)),
        data.matches(excess, "cars", matched.label == "car"),
        paper="0.52 and 0.13",
    )


def _near_paper(claim: str, what: str, paper: float, interval: Interval) -> Claim:
    """Check that a value is within a tenth of the paper's."""
    what = f"{what} within a tenth of the paper's, that is"
    return near(claim, what, (0.9 * paper, 1.1 * paper), interval, paper=f"{paper:.3g}", pattern="{:.3g}")


def _by_pair(sample: Sample, reduced: Callable[[NDArray[Any]], Any]) -> Sample:
    """One value for each independent pair, from its values."""
    pairs = np.unique(sample.pair)
    return Sample(np.array([reduced(sample.values[sample.pair == pair]) for pair in pairs], dtype=np.bool_), pairs)


def _std(values: FloatArray) -> float:
    """Standard deviation (n - 1); NaN for fewer than two values."""
    return float(np.std(values, ddof=1)) if len(values) > 1 else np.nan


def _variation(values: FloatArray) -> float:
    """Standard deviation over mean; NaN if the mean is 0."""
    mean = float(np.mean(values))
    return _std(values) / mean if mean else np.nan


def _span(values: FloatArray) -> float:
    """The 95 % minus the 5 % quantile."""
    return float(np.subtract(*np.quantile(values, [0.95, 0.05])))
