"""Two simulator versions on the same real scans: which scores differ, and which objects got better or worse."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..arrays import BoolArray, FloatArray

N_RESAMPLES, CONFIDENCE, SEED = 9999, 0.95, 0
#: Without any difference, all of n pairs change the same way in 2 x 0.5^n of the cases: in under 5 % from 6 pairs on.
LEAST_PAIRS = 6
#: A score of an object has changed if it moved by more than this.
LEAST_CHANGE = 0.05
#: So many random numbers are drawn at once, so that many pairs cost no more memory than few.
_BATCH_NUMBERS = 2_000_000

KINDS = ("vanished", "worse", "mixed", "alike", "better", "appeared", "missing in both")


@dataclass(frozen=True)
class Difference:
    """A mean difference (after less before) over pairs with its 95 % interval; None where it cannot be computed.

    before, after : means over the pairs that have both values
    why : why there is no interval
    """

    n_pairs: int
    before: float | None
    after: float | None
    difference: float | None
    low: float | None
    high: float | None
    why: str = ""


def paired_difference(before: FloatArray, after: FloatArray) -> Difference:
    """The mean of after - before, with a bootstrap interval over pairs.

    The pairs are drawn with replacement, both values of a pair together (paired bootstrap), 9,999 times from a fixed
    seed; the interval is the bias-corrected and accelerated one (BCa; Efron, Better bootstrap confidence intervals,
    JASA 1987) of `scipy.stats.bootstrap`. Pairs that lack a value are left out. Where all differences are equal the
    interval is that difference. Of fewer than 6 pairs there is none, because it would be about [smallest, largest] and
    leave out 0 by chance in over 5 % of the cases (2 x 0.5^n, the sign test); but where two pairs or more all differ
    by 0 it is [0, 0].

    Parameters
    ----------
    before, after : (n,) a score of each pair, NaN where null

    Examples
    --------
    >>> paired_difference(np.arange(6.0), np.arange(6.0) + 0.5).low
    0.5
    >>> paired_difference(np.arange(2.0), np.arange(2.0) + 0.5).why
    '2 pairs are too few for a 95 % interval, 6 are wanted'
    """
    known = ~(np.isnan(before) | np.isnan(after))
    a, b = before[known], after[known]
    n = len(a)
    if not n:
        return Difference(0, None, None, None, None, None, "no pair has both values")
    means = (float(a.mean()), float(b.mean()), float((b - a).mean()))
    if n < LEAST_PAIRS and (n < 2 or np.any(a != b)):
        pairs = "1 pair is" if n == 1 else f"{n} pairs are"
        return Difference(
            n, *means, None, None, f"{pairs} too few for a {100 * CONFIDENCE:.0f} % interval, {LEAST_PAIRS} are wanted"
        )
    if np.ptp(b - a) == 0:
        return Difference(n, *means, means[2], means[2])
    low, high = _interval(a, b)
    if not np.isfinite([low, high]).all():
        return Difference(n, *means, None, None, "the differences are too alike for an interval")
    return Difference(n, *means, low, high)


def judge(difference: Difference, higher_is_better: bool) -> str:
    """In a word: `better` or `worse` where the interval leaves out 0, `same` where it is 0, else `undecided`."""
    low, high = difference.low, difference.high
    if low is None or high is None:
        return "undecided"
    if low == high == 0:
        return "same"
    if low <= 0 <= high:
        return "undecided"
    return "better" if (low > 0) == higher_is_better else "worse"


def kinds_of_change(
    before: BoolArray, after: BoolArray, cdc: tuple[FloatArray, FloatArray], r_lambda: tuple[FloatArray, FloatArray]
) -> NDArray[np.str_]:
    """What has become of each real object.

    `appeared`: missing before, matched now; `vanished`: the reverse. Of an object matched in both: `better` if CDC or
    r_lambda fell by more than 0.05 and neither rose by so much, `worse` the reverse, `mixed` if one fell and the other
    rose, else `alike`. A score that is null in either run does not count.

    Parameters
    ----------
    before, after : (n,) whether the real object is matched
    cdc, r_lambda : (n,) and (n,), before and after, NaN where null
    """
    change = np.nan_to_num(np.column_stack([cdc[1] - cdc[0], r_lambda[1] - r_lambda[0]]))
    fell, rose = (change < -LEAST_CHANGE).any(axis=1), (change > LEAST_CHANGE).any(axis=1)
    conditions = [~before & ~after, before & ~after, ~before & after, fell & rose, fell, rose]
    kinds = ["missing in both", "vanished", "appeared", "mixed", "better", "worse"]
    found: NDArray[np.str_] = np.select(conditions, kinds, "alike")
    return found


def _interval(a: FloatArray, b: FloatArray) -> tuple[float, float]:
    import warnings

    from scipy import stats

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", stats.DegenerateDataWarning)  # its bounds are NaN, which the caller looks for
        found = stats.bootstrap(
            (a, b),
            lambda a, b, axis: np.mean(b - a, axis=axis),
            paired=True,
            vectorized=True,
            n_resamples=N_RESAMPLES,
            batch=max(1, _BATCH_NUMBERS // len(a)),
            confidence_level=CONFIDENCE,
            method="BCa",
            rng=np.random.default_rng(SEED),
        ).confidence_interval
    return float(found.low), float(found.high)
