"""By which rules a claim of the paper holds here. Every number comes with its 95 % interval over the pairs of scans.

A pair of scans is one observation, however many objects it shows: objects of one pair share its weather, its street and
its flaws. So the question is always: how far would this number move if other pairs had been recorded? (`over_pairs`.)

- an order (A above B): the interval of A less B lies above 0: it holds; below 0: it does not; else: not decided;
- a value (near the paper's): the interval lies within the paper's bounds: it holds; beyond them: it does not; else: not
  decided;
- how often (in most pairs): the same of the share of pairs, by the binomial distribution;
- whether at all (a value below 0.4): the same, against one pair in ten: one stray object shows nothing.

Fewer than six independent pairs decide no order and no value. The bounds on the paper's values, on "consistently" and
on a weak correlation were written before any of our results was seen. The intervals, the tenth of the pairs and the
groups of `over_pairs` came later, chosen by the rates on random data: `benchmarks/false_alarms.py`, and the table in
`benchmarks/BENCHMARK.md`. They make it harder to hold, but for "no value below 0.4", which a stray object no longer
denies.
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

#: More pairs than this are left out in so many groups, not one by one. Single pairs of many would hardly move a median,
#: and its interval would be too narrow (Shao and Wu, A general theory for jackknife variance estimation, 1989).
MOST_GROUPS = 25
#: "Some" and "none": in more, or fewer, than this share of the pairs.
SOME_PAIRS = 0.1
#: |Spearman's rho| below this is a weak rank correlation (Evans, Straightforward Statistics, 1996).
WEAK_CORRELATION = 0.4

Statistic = Callable[..., Any]


@dataclass(frozen=True, kw_only=True)
class Claim:
    """One claim: the paper's value, the value here, and whether it holds.

    estimate, low, high : what the rule looks at, such as a difference, with its 95 % interval; None if there is none
    n_pairs : independent pairs that it comes from
    verdict : `HOLDS`, `FAILS` or `UNDECIDED`
    why : why there is no interval or no verdict; "" if there is nothing to add
    """

    claim: str
    paper: str
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
    """Values of objects (or of pairs), and which independent pair each comes from.

    values : (n,) or (n, k) float64 or bool
    pair : (n,) int32
    """

    values: NDArray[Any]
    pair: IntArray


@dataclass(frozen=True)
class Interval:
    """A number with its 95 % interval over `n_pairs` independent pairs; None, and why, where there is none."""

    value: float | None = None
    low: float | None = None
    high: float | None = None
    n_pairs: int = 0
    why: str = ""


def over_pairs(statistic: Statistic, *samples: Sample) -> Interval:
    """A number made from some samples, and how far it would move if other pairs had been recorded.

    Each pair is left out in turn (the jackknife: Tukey, Bias and confidence in not quite large samples, Ann. Math.
    Stat. 1958; with whole pairs left out, and many pairs in 25 groups: Kott, The delete-a-group jackknife, J. Off.
    Stat. 2001). With T the number, T_g what it is without pair g, and G pairs, the pair's own share in it is

        v_g = T + (G - 1) (mean of all T_g - T_g)

    which for a mean over pairs is just the pair's value. T is the mean of all v_g, and its interval that of a mean:
    Student's t, see `mean_test`. Only pairs with a value in every sample count.

    Parameters
    ----------
    statistic : of the values of each sample, one number
    samples : what it is made from

    Examples
    --------
    >>> six = Sample(np.array([1.0, 2.0, 3.0, 4.0, 5.0, 6.0]), np.arange(6, dtype=np.int32))
    >>> found = over_pairs(np.mean, six)
    >>> found.value, round(found.low, 2), round(found.high, 2), found.n_pairs
    (3.5, 0.77, 6.23, 6)
    """
    inside = _in_shared_pairs(samples)
    n_pairs = len(np.unique(inside[0].pair))
    if not n_pairs:
        return Interval(why="no objects to compare")
    value = float(statistic(*(sample.values for sample in inside)))
    if not math.isfinite(value):
        return Interval(n_pairs=n_pairs, why="too few values")
    found = Interval(value, None, None, n_pairs)
    if n_pairs < LEAST_PAIRS:
        return replace(found, why=f"{n_pairs} of {LEAST_PAIRS} pairs that are needed")
    shares = value_by_pair(statistic, inside)
    if not np.isfinite(shares).all():
        return replace(found, why="too few values")
    if np.ptp(shares) <= ALIKE * np.abs(shares).max():
        return replace(found, why="all pairs alike, so that nothing says what chance is")
    _, low, high = mean_test(shares)
    return replace(found, low=float(low), high=float(high))


def value_by_pair(statistic: Statistic, samples: list[Sample]) -> FloatArray:
    """(..., G) each pair's own share v_g in a number (or in several), from `over_pairs`; their mean is the number."""
    pairs = np.unique(samples[0].pair)
    groups = [np.searchsorted(pairs, sample.pair) % MOST_GROUPS for sample in samples]
    n_groups = min(len(pairs), MOST_GROUPS)
    without = [
        statistic(*(sample.values[group != g] for sample, group in zip(samples, groups, strict=True)))
        for g in range(n_groups)
    ]
    left = np.stack([np.asarray(value, dtype=np.float64) for value in without], axis=-1)
    whole = np.asarray(statistic(*(sample.values for sample in samples)), dtype=np.float64)
    shares: FloatArray = whole[..., None] + (n_groups - 1) * (left.mean(axis=-1, keepdims=True) - left)
    return shares


def decided(holds: bool, fails: bool | None = None) -> str:
    """The verdict where two findings exclude each other; by default it fails if it does not hold."""
    return HOLDS if holds else FAILS if fails is None or fails else UNDECIDED


def within(interval: Interval, least: float, most: float) -> str:
    """The verdict on a value within bounds: the whole interval lies inside, or all of it beyond, or neither."""
    if interval.low is None or interval.high is None:
        return UNDECIDED
    return decided(least < interval.low and interval.high < most, interval.high < least or interval.low > most)


def order(
    claim: str,
    paper: str,
    rule: str,
    statistic: Statistic,
    larger: Sample,
    smaller: Sample,
    pattern: str = "{:.3f} and {:.3f}",
) -> Claim:
    """That a number of one sample is larger than that of another."""
    interval = over_pairs(lambda a, b: statistic(a) - statistic(b), larger, smaller)
    return above_zero(claim, paper, rule, _both(statistic, larger, smaller, pattern), interval)


def share_order(claim: str, paper: str, rule: str, larger: Sample, smaller: Sample) -> Claim:
    """That something is so of a larger share of one sample than of another.

    Shares of 0 and 1 do not move when a pair is left out, and yet are not for sure. So the interval is at least as wide
    as if all objects were independent: k of n objects count as c = (k + 2) / (n + 4) with the variance
    c (1 - c) / (n + 4) (Agresti and Coull, Approximate is better than exact, Am. Stat. 1998).
    """
    interval = over_pairs(lambda a, b: np.mean(a) - np.mean(b), larger, smaller)
    if interval.n_pairs >= LEAST_PAIRS:
        inside = [sample.values for sample in _in_shared_pairs((larger, smaller))]
        centre = [(np.count_nonzero(values) + 2) / (len(values) + 4) for values in inside]
        variance = sum(c * (1 - c) / (len(values) + 4) for c, values in zip(centre, inside, strict=True))
        t = float(student_t.isf((1 - CONFIDENCE) / 2, WORTH * (interval.n_pairs - 1)))
        ends = [centre[0] - centre[1] + sign * t * math.sqrt(variance) for sign in (-1, 1)]
        low = min(end for end in (interval.low, ends[0]) if end is not None)
        high = max(end for end in (interval.high, ends[1]) if end is not None)
        interval = replace(interval, low=low, high=high, why="")
    return above_zero(claim, paper, rule, _both(np.mean, larger, smaller, "{:.3f} and {:.3f}"), interval)


def above_zero(claim: str, paper: str, rule: str, here: str, interval: Interval) -> Claim:
    """That a number is above 0: it holds if the whole interval is, and fails if it is wholly below."""
    return _claim(claim, paper, rule, here, interval, within(interval, 0.0, math.inf))


def near(
    claim: str, paper: str, rule: str, bounds: tuple[float, float], interval: Interval, pattern: str = "{:.3f}"
) -> Claim:
    """That a number lies within bounds: it holds if the whole interval does, and fails if none of it does."""
    here = "-" if interval.value is None else pattern.format(interval.value)
    return _claim(claim, paper, rule, here, interval, within(interval, *bounds))


def in_most_pairs(claim: str, paper: str, rule: str, pairs: Sample, least_share: float) -> Claim:
    """That something is so in at least a share of the pairs, and beyond chance in more than half of them.

    Of pairs that toss a coin all of six agree in 2 % of the cases: the interval of the share is the exact one of the
    binomial distribution (Clopper and Pearson, Biometrika 1934). It does not hold where that lies below the share.

    Parameters
    ----------
    pairs : bool, one value an independent pair
    """
    interval = share_of_pairs(pairs)
    verdict = UNDECIDED
    if interval.value is not None and interval.low is not None and interval.high is not None:
        often = interval.value >= least_share and interval.low > 0.5
        verdict = decided(often, interval.high < least_share)
    return _claim(claim, paper, rule, _count(pairs), interval, verdict)


def in_some_pairs(claim: str, paper: str, rule: str, pairs: Sample, is_wanted: bool, extreme: str) -> Claim:
    """That some objects are such (`is_wanted`), or that none are: in more, or in fewer, than a tenth of the pairs.

    One stray object is not enough for either, and none in a few pairs may be luck: the interval of the share of pairs
    with such an object lies above a tenth, or below it; else the claim is not decided.

    Parameters
    ----------
    pairs : bool, one value an independent pair: whether any of its objects is such
    extreme : the most extreme value of an object, in words
    """
    interval = share_of_pairs(pairs)
    least, most = (SOME_PAIRS, math.inf) if is_wanted else (-math.inf, SOME_PAIRS)
    verdict = within(interval, least, most)
    return _claim(claim, paper, rule, f"{extreme}; in {_count(pairs)}", interval, verdict)


def complementary(claim: str, paper: str, rule: str, scores: Sample, traits: Sample) -> Claim:
    """That two scores tell different things: both follow something about the objects, and hardly each other.

    Two columns of noise are not correlated either. So each score must first follow a trait of the objects (Spearman's
    rho, p of `mean_test` over the pairs, below 5 % after Holm over the traits). Then the claim holds where the interval
    of rho between the scores lies within ±0.4; it does not where the interval lies beyond; else it is not decided.

    Parameters
    ----------
    scores : (n, 2) the scores
    traits : (n, k) what they may follow, of the same objects
    """
    both = Sample(np.column_stack([scores.values, traits.values]), scores.pair)
    interval = over_pairs(lambda rows: _rank_correlations(rows)[0, 1], both)
    here = "-" if interval.value is None else f"rho {interval.value:.2f}"
    if interval.low is None or interval.high is None:
        return _claim(claim, paper, rule, here, interval, UNDECIDED)
    if min(abs(interval.low), abs(interval.high)) > WEAK_CORRELATION and interval.low * interval.high > 0:
        return _claim(claim, paper, rule, here, interval, FAILS)
    shares = value_by_pair(lambda rows: _rank_correlations(rows)[:2, 2:], [both])
    with np.errstate(divide="ignore", invalid="ignore"):  # a trait that is the same everywhere has no p
        tests = mean_test(shares)[0]
    p_values = [holm([None if math.isnan(p) else float(p) for p in own]) for own in tests]
    silent = [i for i, own in enumerate(p_values) if not any(p is not None and p < 1 - CONFIDENCE for p in own)]
    if silent:
        return _claim(claim, paper, rule, here, replace(interval, why=_NO_SIGNAL[len(silent) - 1]), UNDECIDED)
    is_weak = max(abs(interval.low), abs(interval.high)) < WEAK_CORRELATION
    return _claim(claim, paper, rule, here, interval, HOLDS if is_weak else UNDECIDED)


_NO_SIGNAL = ("one of the scores may be noise", "both scores may be noise")


def share_of_pairs(pairs: Sample) -> Interval:
    """In which share of the independent pairs something is so, with the exact binomial interval."""
    n = len(pairs.values)
    if not n:
        return Interval(why="no pair to look at")
    n_so = int(np.count_nonzero(pairs.values))
    ends = binomtest(n_so, n).proportion_ci(CONFIDENCE, method="exact")
    return Interval(n_so / n, float(ends.low), float(ends.high), n)


def _claim(claim: str, paper: str, rule: str, here: str, interval: Interval, verdict: str) -> Claim:
    return Claim(
        claim=claim,
        paper=paper,
        here=here,
        estimate=interval.value,
        low=interval.low,
        high=interval.high,
        n_pairs=interval.n_pairs,
        rule=rule,
        verdict=verdict,
        why=interval.why,
    )


def _in_shared_pairs(samples: tuple[Sample, ...]) -> list[Sample]:
    """The samples, in the pairs that all of them have."""
    shared = reduce(np.intersect1d, (sample.pair for sample in samples))
    inside = [np.isin(sample.pair, shared) for sample in samples]
    return [Sample(sample.values[own], sample.pair[own]) for sample, own in zip(samples, inside, strict=True)]


def _both(statistic: Statistic, larger: Sample, smaller: Sample, pattern: str) -> str:
    inside = _in_shared_pairs((larger, smaller))
    values = [float(statistic(sample.values)) for sample in inside if len(sample.values)]
    return pattern.format(*values) if values and all(map(math.isfinite, values)) else "-"


def _count(pairs: Sample) -> str:
    return f"{np.count_nonzero(pairs.values)} of {len(pairs.values)} pairs"


def _rank_correlations(rows: FloatArray) -> FloatArray:
    """(k, k) Spearman's rho of the columns: Pearson's of their ranks; 0 for a constant column."""
    ranks = rankdata(rows, axis=0)
    centred = ranks - ranks.mean(axis=0)
    length = np.sqrt((centred**2).sum(axis=0))
    unit = centred / np.where(length > 0, length, 1.0)
    found: FloatArray = unit.T @ unit
    return found
