"""Two simulator versions on the same real scans: which scores differ, and which objects got better or worse.

A score is better or worse where chance makes such a difference of any of the scores in under 5 % of the cases. The
rates of false verdicts were found by simulation: `benchmarks/false_alarms.py`, and the table in `docs/faults.md`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import t as student_t

from ..arrays import BoolArray, FloatArray, IntArray

CONFIDENCE = 0.95
#: Fewer independent pairs decide nothing: all of n change the same way by chance in 2 x 0.5^n of the cases.
LEAST_PAIRS = 6
#: The degrees of freedom of Student's t are this share of n - 1: a deviation that is estimated from a few values of
#: skewed or heavy-tailed differences is worth less than one of normal ones (excess kurtosis 2 halves it).
WORTH = 0.5
#: Pairs within this time see the same surroundings, and count as one: a car drives out of its own view in it.
BLOCK_S = 10.0
#: A change of more than so many standard deviations of the pairs' changes is named, however few pairs there are.
FAR_STDS = 5.0
#: A score of an object has changed if it moved by more than this.
LEAST_CHANGE = 0.05
#: Changes that agree to this share of their mean are those of copies, not of different scans.
ALIKE = 1e-9

KINDS = ("vanished", "worse", "mixed", "alike", "better", "appeared", "missing in both")


@dataclass(frozen=True)
class Difference:
    """A mean difference (after less before) with its 95 % interval; None where it cannot be computed.

    n_pairs : pairs that have both values
    n_blocks : independent ones among them: pairs of one block count once, with their mean
    before, after, difference : means over the blocks
    std : standard deviation (n - 1) of the blocks' differences
    low, high : the interval of this score alone
    p : how often chance makes a difference as large, of this score alone
    why : why there is no interval
    """

    n_pairs: int
    n_blocks: int
    before: float | None
    after: float | None
    difference: float | None
    std: float | None
    low: float | None
    high: float | None
    p: float | None
    why: str = ""


def paired_difference(before: FloatArray, after: FloatArray, blocks: IntArray | None = None) -> Difference:
    """The mean of after - before, with interval and p of a paired t-test that allows for skew.

    See `mean_test`. Pairs that lack a value are left out. There is no interval for fewer than 6 blocks, and none where
    all blocks change alike: different scans do not, and where they do nothing says what chance makes. But where two
    pairs or more all differ by 0 the interval is [0, 0].

    Parameters
    ----------
    before, after : (n,) a score of each pair, NaN where null
    blocks : (n,) which pairs depend on each other, from `blocks_of`; by default each pair is a block of its own

    Examples
    --------
    >>> paired_difference(np.arange(2.0), np.arange(2.0) + 0.5).why
    '2 pairs are too few for a 95 % interval, 6 are wanted'
    """
    known = ~(np.isnan(before) | np.isnan(after))
    n = int(np.count_nonzero(known))
    if not n:
        return Difference(0, 0, None, None, None, None, None, None, None, "no pair has both values")
    own = np.arange(n) if blocks is None else np.unique(blocks[known], return_inverse=True)[1]
    size = np.bincount(own)
    a, b = (np.bincount(own, values[known]) / size for values in (before, after))
    change, n_blocks = b - a, len(size)
    counts = (n, n_blocks, float(a.mean()), float(b.mean()), float(change.mean()))
    std = float(change.std(ddof=1)) if n_blocks > 1 else None
    if n > 1 and not np.any(before[known] != after[known]):
        return Difference(*counts, std, 0.0, 0.0, 1.0)
    if n_blocks < LEAST_PAIRS:
        return Difference(*counts, std, None, None, None, _too_few(n, n_blocks))
    if np.ptp(change) <= ALIKE * np.abs(change).max():
        return Difference(*counts, std, None, None, None, "all pairs change alike, so that nothing says what chance is")
    p, low, high = (float(value) for value in mean_test(change))
    return Difference(*counts, std, low, high, p)


def mean_test(change: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """The p-value of a mean of 0, and the two ends of its 95 % interval: Student's t, with skew allowed for.

    With W = mean / std, g the skewness, T = sqrt(n) W and Hall's monotone transformation (On the removal of skewness
    by transformation, J. R. Stat. Soc. B 1992, with the constant g / 6n)

        H = sqrt(n) (W + g W^2 / 3 + g^2 W^3 / 27 + g / 6n)

    p is that of the smaller of |T| and |H| (0 where they differ in sign) on (n - 1) / 2 degrees of freedom, and the
    interval reaches as far as the wider one of both. Few values hide their skew, whence the halved degrees of freedom.

    Parameters
    ----------
    change : (..., n) float64, n at least 3, not all equal
    """
    n = change.shape[-1]
    mean = change.mean(axis=-1)
    centred = change - mean[..., None]
    std = np.sqrt((centred**2).sum(axis=-1) / (n - 1))
    skew = (centred**3).mean(axis=-1) / std**3
    ratio = mean / std
    plain = np.sqrt(n) * ratio
    skewed = np.sqrt(n) * (ratio + skew * ratio**2 / 3 + skew**2 * ratio**3 / 27 + skew / (6 * n))
    size = np.where(plain * skewed > 0, np.minimum(np.abs(plain), np.abs(skewed)), 0.0)
    degrees = WORTH * (n - 1)
    reach = student_t.isf((1 - CONFIDENCE) / 2, degrees) / np.sqrt(n)
    ends = []
    for sign in (1.0, -1.0):
        cube = np.cbrt(1 + skew * (sign * reach - skew / (6 * n)))
        is_skewed = np.abs(skew) > ALIKE
        hall = np.where(is_skewed, 3 * (cube - 1) / np.where(is_skewed, skew, 1.0), sign * reach)
        ends.append(mean - std * sign * np.maximum(sign * hall, reach))
    return 2 * student_t.sf(size, degrees), ends[0], ends[1]


def blocks_of(contents: Sequence[str], timestamps_s: Sequence[float | None]) -> IntArray:
    """(n,) the block of each pair: copies of one real scan are one block, and so are scans within 10 s of its first.

    Parameters
    ----------
    contents : (n,) what tells real scans apart, such as a hash of their content
    timestamps_s : (n,) when they were taken, in seconds; None where that is not known

    Examples
    --------
    >>> blocks_of(["a", "a", "b", "c"], [None, None, 0.0, 9.0]).tolist()
    [0, 0, 2, 2]
    """
    first: dict[str, int] = {}
    blocks = np.array([first.setdefault(content, i) for i, content in enumerate(contents)], dtype=np.int32)
    start_s, block = -np.inf, -1
    for time_s, i in sorted((time_s, i) for i, time_s in enumerate(timestamps_s) if time_s is not None):
        if time_s - start_s >= BLOCK_S:
            start_s, block = time_s, int(blocks[i])
        blocks[blocks == blocks[i]] = block
    return blocks


def holm(p_values: Sequence[float | None]) -> list[float | None]:
    """The p-values of several tests, so that any of them is below 5 % by chance in under 5 % of the cases.

    Holm, A simple sequentially rejective multiple test procedure, Scand. J. Stat. 1979; None stays None.

    Examples
    --------
    >>> holm([0.01, None, 0.04, 0.03])
    [0.03, None, 0.06, 0.06]
    """
    known = sorted((p, i) for i, p in enumerate(p_values) if p is not None)
    adjusted: list[float | None] = [None] * len(p_values)
    highest = 0.0
    for rank, (p, i) in enumerate(known):
        highest = max(highest, min(1.0, (len(known) - rank) * p))
        adjusted[i] = highest
    return adjusted


def judge(difference: Difference, higher_is_better: bool, p: float | None, seed_noise: float | None = None) -> str:
    """In a word: `better` or `worse` where p is below 5 %, `same` where nothing differs, else `undecided`.

    Parameters
    ----------
    p : from `holm`, over all scores that are looked at
    seed_noise : a difference up to this may be made by seeds alone, and is `undecided`; None where that is not known
    """
    if difference.low == difference.high == 0:
        return "same"
    change = difference.difference
    if change is None or p is None or p >= 1 - CONFIDENCE or abs(change) <= (seed_noise or 0.0):
        return "undecided"
    return direction(change, higher_is_better)


def direction(change: float, higher_is_better: bool) -> str:
    """`better` or `worse`."""
    return "better" if (change > 0) == higher_is_better else "worse"


def far_beyond_noise(differences: Sequence[Difference], seed_noise: Sequence[float | None]) -> list[bool]:
    """Whether each score moved by more than five paired standard deviations, and by more than seeds make.

    Said of any number of independent pairs from two on, so that a break is named where too few pairs decide. Of few
    pairs a standard deviation is itself uncertain: Student's t (n - 1) must leave under 5 % to chance, after Holm.

    Parameters
    ----------
    differences, seed_noise : (m,) of all scores that are looked at; None where seed noise is not known
    """
    p_values: list[float | None] = []
    for one in differences:
        if one.difference is None or one.std is None:
            p_values.append(None)
        elif one.std <= ALIKE * abs(one.difference):  # integers that all fall alike; the sign test is what is left
            p_values.append(2 * 0.5**one.n_blocks if one.difference else 1.0)
        else:
            size = abs(one.difference) / one.std * np.sqrt(one.n_blocks)
            p_values.append(2 * float(student_t.sf(size, one.n_blocks - 1)))
    return [
        p is not None
        and p < 1 - CONFIDENCE
        and one.difference is not None
        and abs(one.difference) > max(FAR_STDS * (one.std or 0.0), noise or 0.0)
        for one, p, noise in zip(differences, holm(p_values), seed_noise, strict=True)
    ]


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


def _too_few(n: int, n_blocks: int) -> str:
    wanted = f"too few for a {100 * CONFIDENCE:.0f} % interval, {LEAST_PAIRS} are wanted"
    if n != n_blocks:
        return f"{n} pairs count as {n_blocks}, which is {wanted}"
    return f"1 pair is {wanted}" if n == 1 else f"{n} pairs are {wanted}"
