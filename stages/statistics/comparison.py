"""Two simulator versions on the same real scans: which scores changed beyond chance.

Equal simulators exchange *before* and *after*, so that each change is as likely as its opposite. That is all that the
test of `adjusted_p_values` assumes. Its rates of false alarms and its power were found by simulation:
`benchmarks/false_alarms.py`, summarised in `docs/compare.md`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np

from ..arrays import FloatArray, IntArray
from ..summary import mean_and_std

CONFIDENCE = 0.95
#: Fewer independent pairs decide nothing but changes far beyond the noise.
LEAST_PAIRS = 6
#: Fewer have no interval.
LEAST_FOR_INTERVAL = 3
#: From this number of blocks on, signs are flipped: 2^(1-n) is then below 5 % over eight families. Below it, rotations.
LEAST_FLIPPED = 9
#: Up to this number of blocks, all flips of signs are enumerated; above it, `DRAWS` are drawn.
MOST_ENUMERATED = 14
DRAWS = 20_000
#: Pairs within this time see the same surroundings, and count as one: a car leaves its view in that time.
BLOCK_S = 10.0
#: Of fewer than `LEAST_PAIRS` blocks, only a change of more than this many standard deviations is decided.
FAR_STDS = 5.0
#: Smaller differences are rounding, such as between two processors.
ALIKE = 1e-9


@dataclass(frozen=True)
class Difference:
    """A mean difference (after minus before) with its 95 % interval; None if it cannot be computed.

    n_pairs : pairs that have both values
    n_blocks : independent blocks among them: pairs of one block count once, with their mean
    before, after, difference : means over the blocks
    std : standard deviation (n - 1) of the blocks' differences
    low, high : interval of this score alone (Student's t), None for fewer than 3 blocks; [0, 0] if nothing differs
    """

    n_pairs: int = 0
    n_blocks: int = 0
    before: float | None = None
    after: float | None = None
    difference: float | None = None
    std: float | None = None
    low: float | None = None
    high: float | None = None

    @property
    def size(self) -> float:
        """Magnitude of the change; 0 if it cannot be computed."""
        return abs(self.difference or 0.0)

    @property
    def half_width(self) -> float | None:
        """Half the width of the interval; None without one."""
        return None if self.low is None or self.high is None else (self.high - self.low) / 2


def block_means(values: FloatArray, blocks: IntArray) -> FloatArray:
    """(..., b) means over the pairs of each block; NaN if none has a value.

    Parameters
    ----------
    values : (..., n) by pair, NaN for null
    blocks : (n,) block of each pair, from `blocks_of`
    """
    numbers, place = np.unique(blocks, return_inverse=True)
    known = ~np.isnan(values)
    sums = np.zeros((len(numbers), *values.shape[:-1]))
    counts = np.zeros_like(sums)
    np.add.at(sums, place, np.moveaxis(np.where(known, values, 0.0), -1, 0))
    np.add.at(counts, place, np.moveaxis(known, -1, 0))
    with np.errstate(invalid="ignore"):
        return np.moveaxis(sums / counts, 0, -1)


def paired_difference(
    before: FloatArray,
    after: FloatArray,
    blocks: IntArray,
) -> Difference:
    """Mean of after - before over the blocks, with the interval of `mean_interval`.

    Pairs that lack a value are left out. Fewer than three blocks have no interval.

    Parameters
    ----------
    before, after : (n,) score of each pair, NaN for null
    blocks : (n,) block of each pair, from `blocks_of`

    Examples
    --------
    >>> found = paired_difference(np.zeros(3), np.array([0.4, 0.5, 0.6]), np.arange(3))
    >>> found.difference, found.n_blocks
    (0.5, 3)
    """
    known = ~(np.isnan(before) | np.isnan(after))
    n_pairs = int(np.count_nonzero(known))
    if not n_pairs:
        return Difference()
    a, b = block_means(np.stack([before[known], after[known]]), blocks[known])
    change = b - a
    mean, std = mean_and_std(change)
    low = high = None
    if n_pairs > 1 and (np.abs(change) <= ALIKE).all():
        std = low = high = 0.0
    elif len(change) >= LEAST_FOR_INTERVAL:
        _, low, high = mean_interval(change)
    return Difference(
        n_pairs=n_pairs,
        n_blocks=len(change),
        before=float(a.mean()),
        after=float(b.mean()),
        difference=mean,
        std=std,
        low=low,
        high=high,
    )


def mean_interval(values: FloatArray) -> tuple[float, float, float]:
    """Mean with its 95 % interval (Student's t on n - 1 degrees of freedom); below 3 values, their range.

    Parameters
    ----------
    values : (n,) float64, at least one
    """
    from scipy.special import stdtrit  # takes longer to load than the rest of `show`

    n = len(values)
    mean = float(values.mean())
    if n < LEAST_FOR_INTERVAL:
        return mean, float(values.min()), float(values.max())
    reach = float(stdtrit(n - 1, (1 + CONFIDENCE) / 2) * values.std(ddof=1) / np.sqrt(n))
    return mean, mean - reach, mean + reach


def adjusted_p_values(change: FloatArray, least: FloatArray, step: FloatArray) -> FloatArray:
    """(m,) p-value of each score of one family, adjusted for all of them (maxT); NaN if it cannot be below 1.

    With x_i the change of a score in block i, moved towards 0 by `least`, and e a vector of signs,

        T(e) = max over scores of |sum_i e_i x_i| / sqrt(sum_i x_i^2)

    and p is the share of all e for which T(e) is at least a score's own value at e = (1, ..., 1). The same signs are
    applied to all scores, so that their dependence is kept (Westfall and Young, Resampling-Based Multiple Testing,
    1993). That is exact for changes that are as likely as their opposites; as few blocks have few signs, below
    `LEAST_FLIPPED` e is drawn from the whole sphere of that radius instead (rotation test: Langsrud, Rotation tests,
    Stat. Comput. 2005), which is exact for normal changes and the t-test for one score. Below `LEAST_PAIRS` blocks a
    change must also exceed `FAR_STDS` standard deviations. A score whose mean cannot exceed `least` under any signs has
    no p-value; as that does not depend on the signs, it may be left out of all corrections.

    Parameters
    ----------
    change : (m, n) by score and block, NaN for null
    least : (m,) changes of the mean up to this size do not matter
    step : (m,) smallest step of the score, such as 1 for a count; few blocks may agree in it by chance
    """
    n_blocks = change.shape[1]
    known = ~np.isnan(change)
    n_known = known.sum(axis=1)
    n_divisor = np.maximum(n_known, 1)
    x = np.where(known, change, 0.0)
    highest_mean = np.abs(x).sum(axis=1) / n_divisor  # over all flips
    live = (highest_mean > np.maximum(least, ALIKE)) & (n_known > 1)
    p = np.full(len(change), np.nan)
    if not live.any():
        return p
    mean = x.sum(axis=1) / n_divisor
    offset = np.sign(mean) * np.minimum(least, np.abs(mean))
    x = np.where(known, x - offset[:, None], 0.0)[live]
    squares = (x**2).sum(axis=1)
    unit = x / np.sqrt(squares[:, None])
    if n_blocks < LEAST_FLIPPED:
        squares = squares + (n_known * (step / 2) ** 2)[live]  # rounding of the score
    score = np.abs(x.sum(axis=1)) / np.sqrt(squares)
    highest = np.abs(unit @ _directions(n_blocks).T).max(axis=0)
    p[live] = (highest >= score[:, None] - ALIKE).mean(axis=1)
    if n_blocks < LEAST_PAIRS:
        # of |mean| and root mean square
        ratio = score / np.sqrt(n_known[live])
        ratio_of_far = FAR_STDS / np.sqrt(1 - 1 / n_known[live] + FAR_STDS**2)
        p[live] = np.where(ratio > ratio_of_far, p[live], 1.0)
    return p


def blocks_of(
    contents: Sequence[str],
    timestamps_s: Sequence[float | None],
    neighbours: Sequence[tuple[int, int]] = (),
) -> IntArray:
    """(n,) block of each pair: copies of a real scan, scans within 10 s of a block's first, and chains of neighbours.

    Parameters
    ----------
    contents : (n,) identity of the real scans, such as a hash of their content
    timestamps_s : (n,) time of recording, in seconds; None if unknown
    neighbours : pairs (by index) whose real scans show the same place

    Examples
    --------
    >>> blocks_of(["a", "a", "b", "c"], [None, None, 0.0, 9.0]).tolist()
    [0, 0, 2, 2]
    """
    first: dict[str, int] = {}
    numbers = [first.setdefault(content, i) for i, content in enumerate(contents)]
    blocks = np.array(numbers, dtype=np.int32)
    times = sorted((time_s, i) for i, time_s in enumerate(timestamps_s) if time_s is not None)
    start_s = -np.inf
    block = -1
    for time_s, i in times:
        if time_s - start_s >= BLOCK_S:
            start_s = time_s
            block = int(blocks[i])
        blocks[blocks == blocks[i]] = block
    for i, j in neighbours:
        blocks[blocks == blocks[j]] = blocks[i]
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


@cache
def _directions(n: int) -> FloatArray:
    """(k, n) vectors of length sqrt(n): signs, all or some of them, or directions of the sphere; the first is all 1."""
    rng = np.random.default_rng(n)
    if n < LEAST_FLIPPED:
        normal = rng.normal(size=(DRAWS, n))
        drawn = normal * np.sqrt(n / (normal**2).sum(axis=1, keepdims=True))
    elif n <= MOST_ENUMERATED:  # an opposite has the same T: the first sign stays
        bits = np.arange(1, 2 ** (n - 1))[:, None] >> np.arange(n)
        drawn = 1.0 - 2.0 * (bits & 1)
    else:
        drawn = rng.choice([-1.0, 1.0], size=(DRAWS, n))
    return np.vstack([np.ones(n), drawn])
