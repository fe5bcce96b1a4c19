"""What the paper claims of real and simulated scans, and whether a dataset bears it out.

Each claim of the paper's section "Real experiments" (and of its remarks on density and classes) that a number can check
is one line: claim, the paper's value, the value here with its interval, the rule, the verdict. By which rules a claim
holds is said in `claim_rules`. Left out are what is read off pictures, what the perturbation experiment shows, and that
r_lambda is larger than r_gap, which no data can deny: r_gap is at most half of r_lambda by its definition.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...schemas.metrics import metric_of
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
    SOME_PAIRS,
    WEAK_CORRELATION,
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
from .reported import MEDIAN_UNMATCHED_RANGE_M, N_MATCHED, N_PAIRS

#: "Consistently" across scans: in at least this share of them.
CONSISTENT_SHARE = 0.9
#: The smallest CDC of the paper's data.
LEAST_CDC = 0.4

_COPY = -1
_ALL = slice(None)
_FOLIAGE = ("tree", "vegetation")
_IN_WORDS = "(in words)"  # the paper gives no number


def check_claims(
    real: SideObjects,
    sim: SideObjects,
    matched: MatchedObjects,
    contents: Sequence[str],
    real_scans: Sequence[str],
    timestamps_s: Sequence[float | None],
) -> list[Claim]:
    """Every claim with its verdict; `not decided`, with the reason, where the data are too few or lack what it needs.

    Parameters
    ----------
    real, sim, matched : the objects of all pairs
    contents : by pair, a hash of all that its numbers come from: a copy of an earlier pair is left out
    real_scans : by pair, a hash of its real scan: pairs of one real scan count as one
    timestamps_s : by pair, when the scan was taken, None where unknown: scans within 10 s count as one
    """
    first: dict[str, int] = {}
    kept = [i for i, content in enumerate(contents) if first.setdefault(content, i) == i]
    blocks = np.full(len(contents), _COPY, dtype=np.int32)
    blocks[kept] = blocks_of([real_scans[i] for i in kept], [timestamps_s[i] for i in kept])
    data = _Dataset(real, sim, matched, blocks)
    apart = [kept[i] for i in chain_apart([timestamps_s[i] for i in kept])]
    return [*_means(data), *_unmatched(data), *_spreads(data), *_within_scans(data, apart), *_classes(data)]


@dataclass(frozen=True)
class _Dataset:
    """The objects of all pairs as samples; `blocks` says of each pair which independent one it is, or -1: a copy."""

    real: SideObjects
    sim: SideObjects
    matched: MatchedObjects
    blocks: IntArray

    def sample(self, values: NDArray[Any], pair: IntArray) -> Sample:
        """Some values of objects with the independent pairs that these come from; NaN and copies are left out."""
        block = self.blocks[pair]
        known = (block != _COPY) & ~np.isnan(values.astype(np.float64))
        return Sample(values[known], block[known])

    def matches(self, values: NDArray[Any], chosen: BoolArray | slice = _ALL) -> Sample:
        """Values of the matched objects, or of some of them."""
        return self.sample(values[chosen], self.matched.pair[chosen])

    def of_pairs(self, values: NDArray[Any]) -> Sample:
        """Values of the pairs themselves."""
        return self.sample(values, np.arange(len(self.blocks), dtype=np.int32))

    def pair_means(self, scores: FloatArray) -> Sample:
        """The mean of a score over the matched objects of each pair."""
        known = ~np.isnan(scores)
        n, total = (
            np.bincount(self.matched.pair[known], weights, len(self.blocks)) for weights in (None, scores[known])
        )
        return self.of_pairs(np.divide(total, n, out=np.full(len(n), np.nan), where=n > 0))

    def any_in_pair(self, is_so: BoolArray) -> Sample:
        """By independent pair with matched objects, whether any of these is so."""
        return _by_pair(self.matches(is_so), np.any)

    def unmatched(self, side: SideObjects, chosen: BoolArray | slice = _ALL) -> Sample:
        """Of the objects of a side, or of some of them, whether the other side lacks them."""
        return self.sample(~side.is_matched[chosen], side.pair[chosen])


def _means(data: _Dataset) -> Iterator[Claim]:
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
        if metric.paper is not None:
            low, high = metric.paper.mean - metric.paper.std, metric.paper.mean + metric.paper.std
            rule = f"mean over pairs within {low:.3g} and {high:.3g}"
            interval = over_pairs(np.mean, values)
            yield near(f"mean {metric.heading} over pairs", f"{metric.paper}", rule, (low, high), interval)
    yield _within_a_tenth(
        f"matched objects a pair (the paper: {N_MATCHED:,} in {N_PAIRS})",
        "mean over pairs",
        N_MATCHED / N_PAIRS,
        over_pairs(np.mean, data.of_pairs(n_matched)),
    )


def _unmatched(data: _Dataset) -> Iterator[Claim]:
    real, sim = data.real, data.sim
    both_m, pair = np.concatenate([real.range_m, sim.range_m]), np.concatenate([real.pair, sim.pair])
    is_alone = ~np.concatenate([real.is_matched, sim.is_matched])
    unmatched_m = data.sample(both_m[is_alone], pair[is_alone])
    matched_m = data.sample(real.range_m[real.is_matched], real.pair[real.is_matched])
    yield _within_a_tenth(
        "median range of unmatched objects, m",
        "median over objects",
        MEDIAN_UNMATCHED_RANGE_M,
        over_pairs(_median, unmatched_m),
    )
    yield order(
        "unmatched objects lie farther away than matched ones",
        _IN_WORDS,
        "median range in metres, unmatched less matched, above 0",
        _median,
        unmatched_m,
        matched_m,
        "{:.1f} and {:.1f}",
    )
    all_m = data.sample(both_m, pair).values
    middle_m = _median(all_m) if len(all_m) else np.inf
    for what, side, name in (("missing", real, "real"), ("hallucinated", sim, "simulated")):
        far = side.range_m >= middle_m
        yield share_order(
            f"more of the distant {name} objects are {what}",
            _IN_WORDS,
            f"share that is {what}, beyond the median range less nearer, above 0",
            data.unmatched(side, far),
            data.unmatched(side, ~far),
        )


def _spreads(data: _Dataset) -> Iterator[Claim]:
    matched = data.matched
    ratio = matched.n_sim / matched.n_real
    for words, paper, is_so, extreme in (
        ("below a quarter", "< 1/4", ratio < SPARSE_RATIO, np.min),
        ("above four", "> 4", ratio > DENSE_RATIO, np.max),
    ):
        yield in_some_pairs(
            f"n_sim / n_real goes {words}",
            paper,
            f"in over {SOME_PAIRS:.0%} of the pairs an object has a ratio {words}",
            data.any_in_pair(is_so),
            is_wanted=True,
            extreme=_extreme(extreme, data.matches(ratio), "{:.2f}"),
        )
    yield in_some_pairs(
        "CDC takes no value below 0.4",
        "0.40",
        f"in under {SOME_PAIRS:.0%} of the pairs an object has a CDC below {LEAST_CDC}",
        data.any_in_pair(matched.cdc < LEAST_CDC),
        is_wanted=False,
        extreme=_extreme(np.min, data.matches(matched.cdc), "{:.3f}"),
    )
    cdc, r_lambda, r_gap = (data.pair_means(scores) for scores in (matched.cdc, matched.r_lambda, matched.r_gap))
    means = [f"{np.mean(own.values):.3f}" if len(own.values) else "-" for own in (cdc, r_lambda)]
    yield above_zero(
        "mean CDC is substantially larger than mean r_lambda",
        "0.75 and 0.37",
        "difference of the means, less the sum of their std over pairs, above 0",
        " and ".join(means),
        over_pairs(lambda a, b: np.mean(a) - np.mean(b) - _std(a) - _std(b), cdc, r_lambda),
    )
    yield order(
        "r_lambda is more variable than r_gap",
        "0.03 and 0.014",
        "std over pairs, r_lambda less r_gap, above 0",
        _std,
        r_lambda,
        r_gap,
    )
    of_r_lambda, of_cdc = data.matches(matched.r_lambda), data.matches(matched.cdc)
    for claim, rule, statistic, larger, smaller in (
        (
            "r_lambda varies more than CDC relative to its mean",
            "std / mean over objects, r_lambda less CDC, above 0",
            _variation,
            of_r_lambda,
            of_cdc,
        ),
        (
            "r_lambda spans a wider range than CDC",
            "95 % less 5 % quantile over objects, r_lambda less CDC, above 0",
            lambda values: np.subtract(*np.quantile(values, [0.95, 0.05])),
            of_r_lambda,
            of_cdc,
        ),
        (
            "the peak of CDC is higher and sharper than that of r_lambda",
            "density of the fullest bin of 0.05, CDC less r_lambda, above 0",
            peak_density,
            of_cdc,
            of_r_lambda,
        ),
    ):
        yield order(claim, _IN_WORDS, rule, statistic, larger, smaller)
    both = ~(np.isnan(matched.cdc) | np.isnan(matched.r_lambda))
    rows = np.column_stack([matched.cdc, matched.r_lambda, matched.range_m, matched.n_real, ratio])[both]
    block = data.blocks[matched.pair[both]]
    rows, block = rows[block != _COPY], block[block != _COPY]
    yield complementary(
        "CDC and r_lambda are complementary, not redundant",
        _IN_WORDS,
        "both follow range, points or density ratio (Spearman's rho over objects), and rho of one with the other lies "
        f"within ±{WEAK_CORRELATION}",
        Sample(rows[:, :2], block),
        Sample(rows[:, 2:], block),
    )


def _within_scans(data: _Dataset, apart: Sequence[int]) -> Iterator[Claim]:
    """Claims about how the scores vary over the objects of one scan; of pairs that count as one their mean does."""
    matched, n_pairs = data.matched, len(data.blocks)
    wider = std_by_pair(matched.r_lambda, matched.pair, n_pairs) - std_by_pair(matched.cdc, matched.pair, n_pairs)
    yield in_most_pairs(
        "within a scan r_lambda varies more than CDC, consistently",
        _IN_WORDS,
        f"std over a pair's objects, r_lambda > CDC in {CONSISTENT_SHARE:.0%} of the pairs, and beyond chance in half",
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
        "4 of 4 scans",
        f"interquartile range over a scan's objects, r_lambda > CDC in {CONSISTENT_SHARE:.0%} of such scans, and "
        "beyond chance in half",
        _by_pair(data.of_pairs(wider), lambda own: np.mean(own) > 0),
        CONSISTENT_SHARE,
    )


def _classes(data: _Dataset) -> Iterator[Claim]:
    matched = data.matched
    for what, side, name in (("missing", data.real, "real"), ("hallucinated", data.sim, "simulated")):
        yield share_order(
            f"trees and vegetation are {what} more often than cars and walls",
            _IN_WORDS,
            f"share of {name} objects that is {what}, trees and vegetation less cars and walls, above 0",
            data.unmatched(side, np.isin(side.label, _FOLIAGE)),
            data.unmatched(side, np.isin(side.label, ("car", "wall"))),
        )
    is_tree = (matched.label == "tree") & (data.blocks[matched.pair] != _COPY)
    middle_m = _median(matched.range_m[is_tree]) if is_tree.any() else np.inf
    yield order(
        "near trees keep their structure, distant ones less",
        "0.70 and 0.27",
        "mean r_lambda of trees, the farther half less the nearer one, above 0",
        np.mean,
        data.matches(matched.r_lambda, is_tree & (matched.range_m >= middle_m)),
        data.matches(matched.r_lambda, is_tree & (matched.range_m < middle_m)),
    )
    excess = matched.cdc - matched.r_lambda
    yield order(
        "CDC exceeds r_lambda more for trees and vegetation than for cars",
        "0.52 and 0.13",
        "mean of CDC less r_lambda, of trees and vegetation less of cars, above 0 (the paper: a near tree, a car)",
        np.mean,
        data.matches(excess, np.isin(matched.label, _FOLIAGE)),
        data.matches(excess, matched.label == "car"),
    )


def _within_a_tenth(claim: str, what: str, paper: float, interval: Interval) -> Claim:
    """That a value lies within a tenth of the paper's."""
    bounds = (0.9 * paper, 1.1 * paper)
    rule = f"{what} within {bounds[0]:.3g} and {bounds[1]:.3g}, a tenth of the paper's"
    return near(claim, f"{paper:.3g}", rule, bounds, interval, "{:.3g}")


def _by_pair(sample: Sample, reduced: Callable[[NDArray[Any]], Any]) -> Sample:
    """One value for each independent pair, from its values."""
    pairs = np.unique(sample.pair)
    order_of = np.argsort(sample.pair, kind="stable")
    parts = np.split(sample.values[order_of], np.searchsorted(sample.pair[order_of], pairs[1:])) if len(pairs) else []
    return Sample(np.array([reduced(part) for part in parts], dtype=np.bool_), pairs)


def _extreme(which: Callable[[FloatArray], Any], sample: Sample, pattern: str) -> str:
    return pattern.format(which(sample.values)) if len(sample.values) else "-"


def _std(values: FloatArray) -> float:
    """Standard deviation (n - 1); NaN of fewer than two values."""
    return float(np.std(values, ddof=1)) if len(values) > 1 else np.nan


def _variation(values: FloatArray) -> float:
    """Standard deviation over mean; NaN where the mean is 0."""
    mean = float(np.mean(values))
    return _std(values) / mean if mean else np.nan


def _median(values: FloatArray) -> float:
    return float(np.median(values))
