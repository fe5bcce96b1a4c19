"""How often does `fidpipe compare` call a score better or worse where nothing differs, and how often where it does?

    python benchmarks/false_alarms.py [--repeats 400]

Ten scores of pairs that differ by chance alone; a false alarm is any score that is called better or worse. Beside it
the power: how often the first score is decided where its mean change is one or two standard deviations. The old rule
(BCa bootstrap over pairs, each score for itself) is kept here only.
"""

import argparse
import warnings

import numpy as np
from scipy import stats

from fidpipe.stages.statistics.comparison import blocks_of, far_beyond_noise, holm, judge, paired_difference

N_SCORES, STEP_S, MEMORY_S = 10, 0.2, 1.15  # 50 frames with this memory: 56 % false alarms of the old rule at one score


def normal(rng, n):
    return rng.normal(size=(N_SCORES, n)), None


def skewed(rng, n):
    return rng.exponential(size=(N_SCORES, n)) - 1, None


def neighbours(rng, n):
    """Frames 0.2 s apart, whose changes forget each other within about a second."""
    share = np.exp(-STEP_S / MEMORY_S)
    change = rng.normal(size=(N_SCORES, n))
    for i in range(1, n):
        change[:, i] = share * change[:, i - 1] + np.sqrt(1 - share**2) * change[:, i]
    return change, blocks_of([str(i) for i in range(n)], list(STEP_S * np.arange(n)))


def copies(rng, n):
    """One pair under n names, the second run under another Louvain seed."""
    return np.repeat(rng.normal(size=(N_SCORES, 1)), n, axis=1), blocks_of(["one scan"] * n, [None] * n)


CASES = (
    ("6 pairs", normal, 6),
    ("10 pairs", normal, 10),
    ("50 pairs", normal, 50),
    ("6 pairs, skewed", skewed, 6),
    ("10 pairs, skewed", skewed, 10),
    ("50 pairs, skewed", skewed, 50),
    ("50 pairs 0.2 s apart", neighbours, 50),
    ("500 pairs 0.2 s apart", neighbours, 500),
    ("8 copies, another seed", copies, 8),
)


def decided_now(change, blocks):
    """Which scores are called better or worse, and which are said to have moved far beyond noise."""
    found = [paired_difference(np.zeros(len(own)), own, blocks) for own in change]
    p_values = holm([one.p for one in found])
    decided = [judge(one, True, p) in ("better", "worse") for one, p in zip(found, p_values, strict=True)]
    return np.array(decided), np.array(far_beyond_noise(found, [None] * len(found)))


def decided_before(change, n_resamples=999):
    """The old rule; of changes that are all alike it was always sure."""
    decided = []
    for own in change:
        if np.ptp(own) == 0:
            decided.append(True)
            continue
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            interval = stats.bootstrap(
                (own,), np.mean, n_resamples=n_resamples, method="BCa", rng=np.random.default_rng(0)
            ).confidence_interval
        decided.append(interval.low > 0 or interval.high < 0)
    return np.array(decided)


def rates(make, n, repeats, seed=0):
    """How often any score is decided though nothing differs, and how often one is said to be far beyond noise."""
    rng = np.random.default_rng(seed)
    found = [[own.any() for own in decided_now(*make(rng, n))] for _ in range(repeats)]
    return tuple(np.mean(found, axis=0))


def power(make, n, step, repeats, seed=0):
    """How often the first score is decided where its mean change is so many standard deviations."""
    rng, n_decided = np.random.default_rng(seed), 0
    for _ in range(repeats):
        change, blocks = make(rng, n)
        change[0] += step
        n_decided += decided_now(change, blocks)[0][0]
    return n_decided / repeats


def rates_before(make, n, repeats, seed=0):
    """False alarms of the old rule: of one score, and of any of the ten."""
    rng = np.random.default_rng(seed)
    decided = np.array([decided_before(make(rng, n)[0]) for _ in range(repeats)])
    return decided.mean(), decided.any(axis=1).mean()


def main(repeats):
    print(f"{repeats} repeats, {N_SCORES} scores; binomial error of 5 %: {np.sqrt(0.05 * 0.95 / repeats):.1%}")
    print("| case | before: one score | before: any of ten | now: any of ten | far by chance | power 1 std | 2 std |")
    print("|---|---|---|---|---|---|---|")
    for name, make, n in CASES:
        powers = (power(make, n, step, repeats) for step in (1.0, 2.0))
        cells = (*rates_before(make, n, max(1, repeats // 4)), *rates(make, n, repeats), *powers)
        print(f"| {name} | " + " | ".join(f"{100 * cell:.1f} %" for cell in cells) + " |", flush=True)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--repeats", type=int, default=400)
    main(parser.parse_args().repeats)
