"""Rules by which a claim of the paper holds or fails. Every number has a 95 % interval over the pairs of scans.

A pair of scans is one observation, regardless of the number of objects in it: objects of one pair share its weather,
street and flaws. So each interval describes how far a number would move if other pairs had been recorded
(`over_pairs`).

- An order (A above B) holds if the interval of A minus B is above 0, and fails if it is below 0.
- A value (near the paper's) holds if its interval is within the paper's bounds, and fails if it is outside them.
- A majority (in most pairs) and an existence (some objects, no objects) are decided in the same way by the exact
  binomial interval of the share of pairs; existence is compared with one pair in ten, so that a single stray object
  decides nothing.

Otherwise the claim is not decided. With fewer than six independent pairs no order and no value is decided. The bounds
on the paper's values, on "consistently" and on a weak correlation were fixed before any of our results was seen. The
intervals, the tenth of the pairs and the groups of `over_pairs` were chosen later by the rates of false alarms on
random data: `benchmarks/false_alarms.py`, and the table in `benchmarks/BENCHMARK.md`.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import reduce
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import binomtest, rankdata
from scipy.stats import t as student_t

from ..arrays import FloatArray, IntArray
from ..statistics.comparison import ALIKE, CONFIDENCE, LEAST_PAIRS, WORTH, holm, mean_test

HOLDS = "holds"
FAILS = "does not hold"
UNDECIDED = "not decided"

#: More pairs than this are left out in this number of groups instead of one by one. A single pair of many would hardly
#: move a median, and its interval would be too narrow (Shao and Wu, A general theory for jackknife variance estimation,
#: 1989).
MOST_GROUPS = 25
#: "Some" and "none": in more, or in fewer, than this share of the pairs.
SOME_PAIRS = 0.1
#: "Consistently" across pairs: in at least this share of them.
CONSISTENT_SHARE = 0.9
#: |Spearman's rho| below this is a weak rank correlation (Evans, Straightforward Statistics, 1996).
WEAK_CORRELATION = 0.4
IN_WORDS = "(in words)"  #: the paper states no number
_NOISE = ("", "one of the scores may be noise", "both scores may be noise")  # by the number of such scores

Statistic = Callable[..., Any]


@dataclass(frozen=True, kw_only=True)
class Claim:
    """One claim: the paper's value, the value here, and the verdict.

    estimate, low, high : number that the rule evaluates, such as a difference, with its 95 % interval; None if absent
    n_pairs : independent pairs that it comes from
    verdict : `HOLDS`, `FAILS` or `UNDECIDED`
    why : reason if there is no interval or no verdict, else ""
    """

    claim: str = ""
    paper: str = IN_WORDS
    here: str
    estimate: float | None = None
    low: float | None = None
    high: float | None = None
    n_pairs: int = 0
    rule: str = ""
    verdict: str
    why: str = ""


@dataclass(frozen=True)
class Sample:
    """Values of objects (or of pairs), and the independent pair of each.

    values : (n,) or (n, k) float64 or bool
    pair : (n,) int32
    name : in the text of a rule
    """

    values: NDArray[Any]
    pair: IntArray
    name: str = ""


@dataclass(frozen=True)
class Interval:
    """A number with its 95 % interval over `n_pairs` independent pairs; None, with a reason, if it is unknown."""

    estimate: float | None = None
    low: float | None = None
    high: float | None = None
    n_pairs: int = 0
    why: str = ""


def over_pairs(statistic: Statistic, *samples: Sample) -> Interval:
    """A statistic of some samples, and how far it would move if other pairs had been recorded.

    Each pair is left out in turn (the jackknife: Tukey, Bias and confidence in not quite large samples, Ann. Math.
    Stat. 1958; with whole pairs left out, and many pairs in 25 groups: Kott, The delete-a-group jackknife, J. Off.
    Stat. 2001). With T the number, T_g its value without pair g, and G pairs, the pseudovalue of a pair is

        v_g = T + (G - 1) (mean of all T_g - T_g)

    which for a mean over pairs is the pair's value. T is the mean of all v_g, and its interval that of a mean:
    Student's t, see `mean_test`. Only pairs with a value in every sample count.

    Parameters
    ----------
    statistic : function of the values of each sample; returns one number
    samples : its arguments

    Examples
    --------
    >>> six = Sample(np.array([1.0, 2.0, 3.0, 4.0, 5.0, 6.0]), np.arange(6, dtype=np.int32))
    >>> found = over_pairs(np.mean, six)
    >>> found.estimate, round(found.low, 2), round(found.high, 2), found.n_pairs
    (3.5, 0.77, 6.23, 6)
    """
    shared = _in_shared_pairs(samples)
    n_pairs = len(np.unique(shared[0].pair))
    if not n_pairs:
        return Interval(why="no objects to compare")
    estimate = float(statistic(*(sample.values for sample in shared)))
    if not math.isfinite(estimate):
        return Interval(n_pairs=n_pairs, why="too few values")
    if n_pairs < LEAST_PAIRS:
        return Interval(estimate, n_pairs=n_pairs, why=f"expected at least {LEAST_PAIRS} pairs, got {n_pairs}")
    values = pseudovalues(statistic, shared)
    if not np.isfinite(values).all():
        return Interval(estimate, n_pairs=n_pairs, why="too few values")
    if np.ptp(values) <= ALIKE * np.abs(values).max():
        return Interval(estimate, n_pairs=n_pairs, why="all pairs have the same value, so chance cannot be estimated")
    _, low, high = mean_test(values)
    return Interval(estimate, float(low), float(high), n_pairs)


def pseudovalues(statistic: Statistic, samples: list[Sample]) -> FloatArray:
    """(..., G) the pseudovalue v_g of each pair for one statistic or several, see `over_pairs`."""
    pairs = np.unique(samples[0].pair)
    groups = [np.searchsorted(pairs, sample.pair) % MOST_GROUPS for sample in samples]
    n_groups = min(len(pairs), MOST_GROUPS)
    without = [
        statistic(*(sample.values[group != g] for sample, group in zip(samples, groups, strict=True)))
        for g in range(n_groups)
    ]
    left = np.stack([np.asarray(value, dtype=np.float64) for value in without], axis=-1)
    whole = np.asarray(statistic(*(sample.values for sample in samples)), dtype=np.float64)
    values: FloatArray = whole[..., None] + (n_groups - 1) * (left.mean(axis=-1, keepdims=True) - left)
    return values


def decided(holds: bool, fails: bool | None = None) -> str:
    """The verdict on two findings that exclude each other; by default a claim fails if it does not hold."""
    return HOLDS if holds else FAILS if fails is None or fails else UNDECIDED


def within(interval: Interval, least: float, most: float) -> str:
    """The verdict on a value within bounds: the whole interval is inside, or all of it outside, or neither."""
    if interval.low is None or interval.high is None:
        return UNDECIDED
    return decided(least < interval.low and interval.high < most, interval.high < least or interval.low > most)


def near(what: str, bounds: tuple[float, float], interval: Interval, pattern: str = "{:.3f}") -> Claim:
    """Check that a number is within bounds."""
    here = "-" if interval.estimate is None else pattern.format(interval.estimate)
    rule = f"{what} within {bounds[0]:.3g} and {bounds[1]:.3g}"
    return _claim(rule, here, interval, within(interval, *bounds))


def order(
    what: str, statistic: Statistic, larger: Sample, smaller: Sample, pattern: str = "{:.3f} and {:.3f}"
) -> Claim:
    """Check that a statistic (`what`) of one sample is larger than that of another."""
    interval = over_pairs(lambda a, b: statistic(a) - statistic(b), larger, smaller)
    values = [float(statistic(sample.values)) for sample in _in_shared_pairs((larger, smaller)) if len(sample.values)]
    here = pattern.format(*values) if values and all(map(math.isfinite, values)) else "-"
    return above_zero(f"{what}, {larger.name} minus {smaller.name}", here, interval)


def share_order(what: str, larger: Sample, smaller: Sample) -> Claim:
    """Check that a property (`what`) is more frequent in one sample than in another.

    Shares of 0 and 1 do not move when a pair is left out, and yet are uncertain. So the interval is at least as wide
    as if all objects were independent: k of n objects count as c = (k + 2) / (n + 4) with the variance
    c (1 - c) / (n + 4) (Agresti and Coull, Approximate is better than exact, Am. Stat. 1998).
    """
    found = order(what, np.mean, larger, smaller)
    if found.n_pairs < LEAST_PAIRS:
        return found
    inside = [sample.values for sample in _in_shared_pairs((larger, smaller))]
    centre = [(np.count_nonzero(values) + 2) / (len(values) + 4) for values in inside]
    variance = sum(c * (1 - c) / (len(values) + 4) for c, values in zip(centre, inside, strict=True))
    t = float(student_t.isf((1 - CONFIDENCE) / 2, WORTH * (found.n_pairs - 1)))
    ends = [float(centre[0] - centre[1]) + sign * t * math.sqrt(variance) for sign in (-1, 1)]
    low = min(end for end in (found.low, ends[0]) if end is not None)
    high = max(end for end in (found.high, ends[1]) if end is not None)
    verdict = within(Interval(low=low, high=high), 0.0, math.inf)
    return replace(found, low=low, high=high, why="", verdict=verdict)


def above_zero(what: str, here: str, interval: Interval) -> Claim:
    """Check that a number is above 0."""
    return _claim(f"{what}, above 0", here, interval, within(interval, 0.0, math.inf))


def in_most_pairs(what: str, sample: Sample) -> Claim:
    """Check that the mean over a pair is above 0 in nine of ten pairs, and beyond chance in more than half of them.

    If each pair tossed a coin, all of six would agree in 2 % of the cases: the interval of the share is the exact one
    of the binomial distribution (Clopper and Pearson, Biometrika 1934). The claim fails if it is below nine tenths.
    """
    interval, here = _share_of_pairs(sample, lambda own: np.mean(own) > 0)
    verdict = UNDECIDED
    if interval.estimate is not None and interval.low is not None and interval.high is not None:
        is_frequent = interval.estimate >= CONSISTENT_SHARE and interval.low > 0.5
        verdict = decided(is_frequent, interval.high < CONSISTENT_SHARE)
    rule = f"{what} in {CONSISTENT_SHARE:.0%} of the pairs, and beyond chance in half of them"
    return _claim(rule, here, interval, verdict)


def in_some_pairs(
    what: str, has_it: Sample, extreme: Sample, statistic: Statistic, pattern: str, *, exists: bool = True
) -> Claim:
    """Check that some objects have a property, or (`exists` is False) that none has, in a tenth of the pairs.

    A single stray object is not enough for either, and none in a few pairs may be luck: the interval of the share of
    pairs with such an object must be above a tenth, or below it; otherwise the claim is not decided.

    Parameters
    ----------
    has_it : bool, of each object
    extreme, statistic, pattern : values of the objects, of which the most extreme is shown
    """
    interval, count = _share_of_pairs(has_it, np.any)
    least, most = (SOME_PAIRS, math.inf) if exists else (-math.inf, SOME_PAIRS)
    rule = f"{what} in {'over' if exists else 'under'} {SOME_PAIRS:.0%} of the pairs"
    here = f"{pattern.format(statistic(extreme.values)) if len(extreme.values) else '-'}; in {count}"
    return _claim(rule, here, interval, within(interval, least, most))


def complementary(scores: Sample, traits: Sample) -> Claim:
    """Check that two scores carry different information: both follow some trait of the objects, and hardly each other.

    Two columns of noise are not correlated either. So each score must first follow a trait of the objects (Spearman's
    rho, p of `mean_test` over the pairs, below 5 % after Holm over the traits). Then the claim holds if the interval
    of rho between the scores is within ±0.4, and fails if it is outside.

    Parameters
    ----------
    scores : (n, 2) the scores
    traits : (n, k) traits of the same objects
    """
    rule = f"both follow {traits.name} (Spearman's rho over objects), and their own rho is within ±{WEAK_CORRELATION}"
    both = Sample(np.column_stack([scores.values, traits.values]), scores.pair)
    interval, verdict = over_pairs(lambda rows: _rank_correlations(rows)[0, 1], both), UNDECIDED
    if interval.low is not None and interval.high is not None:
        verdict = within(interval, -WEAK_CORRELATION, WEAK_CORRELATION)
        n_noise = 0 if verdict == FAILS else _n_that_follow_nothing(both)
        interval, verdict = replace(interval, why=_NOISE[n_noise]), UNDECIDED if n_noise else verdict
    return _claim(rule, "-" if interval.estimate is None else f"rho {interval.estimate:.2f}", interval, verdict)


def _claim(rule: str, here: str, interval: Interval, verdict: str) -> Claim:
    """The claim without its text and the paper's value."""
    return Claim(here=here, rule=rule, verdict=verdict, **vars(interval))


def _in_shared_pairs(samples: tuple[Sample, ...]) -> list[Sample]:
    """The samples, restricted to the pairs that all of them have."""
    shared = reduce(np.intersect1d, (sample.pair for sample in samples))
    inside = [np.isin(sample.pair, shared) for sample in samples]
    return [Sample(sample.values[own], sample.pair[own]) for sample, own in zip(samples, inside, strict=True)]


def _share_of_pairs(sample: Sample, holds: Callable[[NDArray[Any]], Any]) -> tuple[Interval, str]:
    """Share of the independent pairs whose values have a property, with the exact binomial interval, and as text."""
    pairs = np.unique(sample.pair)
    n, n_with = len(pairs), sum(bool(holds(sample.values[sample.pair == pair])) for pair in pairs)
    text = f"{n_with} of {n} pairs"
    if not n:
        return Interval(why="no pairs to compare"), text
    ends = binomtest(n_with, n).proportion_ci(CONFIDENCE, method="exact")
    return Interval(n_with / n, float(ends.low), float(ends.high), n), text


def _n_that_follow_nothing(both: Sample) -> int:
    """Number of the first two columns that are correlated with none of the others beyond chance."""
    values = pseudovalues(lambda rows: _rank_correlations(rows)[:2, 2:], [both])
    with np.errstate(divide="ignore", invalid="ignore"):  # a constant trait has no p
        tests = mean_test(values)[0]
    p_values = [holm([None if math.isnan(p) else float(p) for p in own]) for own in tests]
    return sum(not any(p is not None and p < 1 - CONFIDENCE for p in own) for own in p_values)


def _rank_correlations(rows: FloatArray) -> FloatArray:
    """(k, k) Spearman's rho of the columns: Pearson's of their ranks; 0 for a constant column."""
    ranks = rankdata(rows, axis=0)
    centred = ranks - ranks.mean(axis=0)
    length = np.sqrt((centred**2).sum(axis=0))
    unit = centred / np.where(length > 0, length, 1.0)
    found: FloatArray = unit.T @ unit
    return found
