"""How often are verdicts wrong by chance: of `fidpipe compare`, and of the paper's claims in `fidpipe show --paper`?

    python benchmarks/false_alarms.py [--repeats 400] [--of compare|claims] [--runs RUN_A RUN_B]

`compare`: as many scores as it judges, of pairs that differ by chance alone; a false alarm is any score that is called
better or worse, and `compare --fail-on worse` fails where any is worse, or moved so far beyond the noise. Beside it the
power: how often the first score is decided where its mean change is one or two standard deviations. The old rule (BCa
bootstrap over pairs, each score for itself) is kept here only. With `--runs`, instead the changes of two real runs, the
sign of each pair drawn at random for all of its scores alike: equal simulators, whose scores depend on each other.

`claims`: datasets whose numbers know nothing of each other, and how often each claim holds on them; beside it how often
the estimate alone is on the claim's side, which was the rule before. Power: datasets as the paper describes them.
"""

import argparse
import warnings
from pathlib import Path

import numpy as np
from scipy import stats

from fidpipe.pipeline.results.compare import SCORES, compare_runs
from fidpipe.pipeline.results.followed import SHARED_SCORES
from fidpipe.stages.statistics.claim_rules import HOLDS
from fidpipe.stages.statistics.claims import check_claims
from fidpipe.stages.statistics.comparison import blocks_of, far_beyond_noise, holm, judge, paired_difference
from fidpipe.stages.statistics.findings import MatchedObjects, SideObjects

N_SCORES = len(SCORES) + len(SHARED_SCORES)
STEP_S, MEMORY_S = 0.2, 1.15  # 50 frames with this memory: 56 % false alarms of the old rule at one score


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


def flipped(folders):
    """Draws some pairs of a comparison of real runs, each as it is or with before and after swapped."""
    (found,) = compare_runs([Path(folder) for folder in folders])
    known = [name for name in found.pairs if all(score.of_pairs[name] is not None for score in found.scores)]
    changes = np.array([[score.of_pairs[name] for name in known] for score in found.scores])

    def make(rng, n):
        chosen = rng.choice(len(known), n, replace=False)
        return changes[:, chosen] * rng.choice([-1, 1], n), None

    return make, len(known)


def decided_now(change, blocks):
    """Which scores are called better or worse, which are said to have moved far beyond noise, and which fail a gate."""
    found = [paired_difference(np.zeros(len(own)), own, blocks) for own in change]
    p_values = holm([one.p for one in found])
    verdicts = np.array([judge(one, True, p) for one, p in zip(found, p_values, strict=True)])
    is_far = np.array(far_beyond_noise(found, [None] * len(found)))
    fell = np.array([(one.difference or 0.0) < 0 for one in found])
    return np.isin(verdicts, ("better", "worse")), is_far, (verdicts == "worse") | (is_far & fell)


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
    """How often any score is decided, said to be far beyond noise, and fails a gate, though nothing differs."""
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
    """False alarms of the old rule: of one score, and of any of them."""
    rng = np.random.default_rng(seed)
    decided = np.array([decided_before(make(rng, n)[0]) for _ in range(repeats)])
    return decided.mean(), decided.any(axis=1).mean()


N_OBJECTS = 24  # matched objects of a pair, on average
CLASSES = ("tree", "vegetation", "car", "wall")


def objects(rng, n_pairs, scores, alone, n_objects=N_OBJECTS):
    """The arguments of `check_claims` for random pairs, with a scan every two minutes.

    scores : of (rng, pair, range_m, label) the scores cdc, r_lambda, r_gap of matched objects
    alone : of (rng, pair, range_m, label) the chance that an object has no partner
    """
    sides = []
    for _ in range(2):  # the median range is on the upper bound of the paper's, 31.9 m
        n = rng.poisson(2 * n_objects, n_pairs) + 4
        pair = np.repeat(np.arange(n_pairs, dtype=np.int32), n)
        range_m, label = rng.uniform(3, 60.8, len(pair)), rng.choice(CLASSES, len(pair))
        sides.append((pair, range_m, label, rng.random(len(pair)) < alone(rng, pair, range_m, label)))
    (pair, range_m, label, is_alone), (sim_pair, sim_range_m, sim_label, is_invented) = sides
    rows = np.flatnonzero(~is_alone)
    # As many simulated objects are matched as real ones, the others are invented.
    of = [np.flatnonzero(~is_invented & (sim_pair == i))[: np.sum(pair[rows] == i)] for i in range(n_pairs)]
    is_matched = np.zeros(len(sim_pair), dtype=bool)
    is_matched[np.concatenate(of)] = True
    rows = np.concatenate([rows[pair[rows] == i][: len(own)] for i, own in enumerate(of)])
    has_partner = np.zeros(len(pair), dtype=bool)
    has_partner[rows] = True
    n_real, n_sim = (np.exp(rng.normal(5, 0.3, len(rows))).astype(np.int32) for _ in range(2))
    cdc, r_lambda, r_gap = scores(rng, pair[rows], range_m[rows], label[rows])
    names = [str(i) for i in range(n_pairs)]
    return (
        SideObjects(pair, range_m, label, has_partner),
        SideObjects(sim_pair, sim_range_m, sim_label, is_matched),
        MatchedObjects(pair[rows], range_m[rows], label[rows], n_real, n_sim, cdc, r_lambda, r_gap),
        names,
        names,
        [120.0 * i for i in range(n_pairs)],
    )


def noise(rng, n_pairs, own_level=0.0, skewed=False):
    """Scores that are all alike and follow nothing; with a level of its own for each pair, or with a long tail."""

    def scores(rng, pair, range_m, label):
        level = rng.normal(0, own_level, (3, n_pairs))[:, pair]
        draw = rng.exponential(0.2, (3, len(pair))) if skewed else rng.normal(0.2, 0.1, (3, len(pair)))
        return np.abs(0.2 + draw + level)  # on the upper bound of the paper's mean r_lambda, 0.40

    share = np.clip(rng.normal(0.4, own_level, n_pairs), 0.1, 0.8)
    return objects(rng, n_pairs, scores, lambda rng, pair, range_m, label: share[pair])


def as_the_paper(rng, n_pairs):
    """Orders as the paper describes them, of a size that is stated in `docs/faults.md`."""

    def scores(rng, pair, range_m, label):
        is_foliage, is_tree = np.isin(label, CLASSES[:2]), label == "tree"
        cdc = rng.normal(0.70, 0.05, len(pair)) + 0.002 * (range_m - 30) + 0.1 * is_foliage
        r_lambda = rng.normal(0.35, 0.15, len(pair)) + 0.1 * is_tree * np.sign(range_m - 30)
        r_lambda -= 0.003 * (range_m - 30) * ~is_tree
        return np.clip([cdc, r_lambda + rng.normal(0, 0.02, n_pairs)[pair], 0.08 * rng.random(len(pair))], 0.01, 2)

    def alone(rng, pair, range_m, label):
        return 0.25 + 0.2 * (range_m > 30) + 0.2 * np.isin(label, CLASSES[:2])

    return objects(rng, n_pairs, scores, alone)


def copied(rng, n_pairs, n_copies=8):
    """Noise, and the same with further copies of its first pair: the arguments of `check_claims` for both."""
    once = noise(rng, n_pairs, own_level=0.1)
    real, sim, matched, names, _, times_s = once
    names = [*names, *["0"] * (n_copies - 1)]

    def repeated(side):
        own = np.flatnonzero(side.pair == 0)
        rows = np.concatenate([np.arange(len(side.pair)), np.tile(own, n_copies - 1)])
        values = {name: values[rows] for name, values in vars(side).items()}
        values["pair"][len(side.pair) :] = np.repeat(np.arange(n_copies - 1, dtype=np.int32) + n_pairs, len(own))
        return type(side)(**values)

    return once, (*map(repeated, (real, sim, matched)), names, names, [*times_s, *[None] * (n_copies - 1)])


CLAIM_CASES = (
    ("6 pairs", lambda rng: noise(rng, 6)),
    ("10 pairs", lambda rng: noise(rng, 10)),
    ("50 pairs", lambda rng: noise(rng, 50)),
    ("10 pairs, skewed", lambda rng: noise(rng, 10, skewed=True)),
    ("10 pairs, each with its own level", lambda rng: noise(rng, 10, own_level=0.1)),
    ("8 copies of one pair", lambda rng: copied(rng, 1)[1]),
    ("10 pairs as the paper", lambda rng: as_the_paper(rng, 10)),
    ("50 pairs as the paper", lambda rng: as_the_paper(rng, 50)),
)


def holding(make, repeats, seed=0):
    """By claim, how often it holds, and how often the estimate of an order alone is above 0 (NaN of the others)."""
    rng, found = np.random.default_rng(seed), []
    for _ in range(repeats):
        claims = check_claims(*make(rng))
        found.append([(one.verdict == HOLDS, (one.estimate or 0) > 0) for one in claims])
    rates = np.mean(found, axis=0)
    return {
        one.claim: (held, alone if "above 0" in one.rule else np.nan)
        for one, (held, alone) in zip(claims, rates, strict=True)
    }


def of_claims(repeats):
    cases = [(name, holding(make, repeats)) for name, make in CLAIM_CASES]
    print(f"{repeats} repeats; binomial error of 5 %: {np.sqrt(0.05 * 0.95 / repeats):.1%}")
    print(f"| claim | {cases[1][0]}, estimate alone | " + " | ".join(name for name, _ in cases) + " |")
    print("|---" * (len(cases) + 2) + "|")
    for claim in cases[0][1]:
        shares = [cases[1][1][claim][1], *(found[claim][0] for _, found in cases)]
        print(f"| {claim} | " + " | ".join("" if np.isnan(s) else f"{100 * s:.1f} %" for s in shares) + " |")


def of_compare(repeats, runs=()):
    print(f"{repeats} repeats, {N_SCORES} scores; binomial error of 5 %: {np.sqrt(0.05 * 0.95 / repeats):.1%}")
    print(
        "| case | before: one score | before: any score | now: any score | far by chance | --fail-on worse fails "
        "| power 1 std | 2 std |"
    )
    print("|---|---|---|---|---|---|---|---|")
    cases = CASES
    if runs:
        make, n_known = flipped(runs)
        cases = [(f"{n} pairs of real runs, signs at random", make, n) for n in (6, 10, n_known) if n <= n_known]
    for name, make, n in cases:
        powers = [] if runs else [power(make, n, step, repeats) for step in (1.0, 2.0)]
        cells = (*rates_before(make, n, max(1, repeats // 4)), *rates(make, n, repeats), *powers)
        empty = " | " * (2 - len(powers))
        print(f"| {name} | " + " | ".join(f"{100 * cell:.1f} %" for cell in cells) + f"{empty} |", flush=True)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--repeats", type=int, default=400)
    parser.add_argument("--of", choices=("compare", "claims"), default="compare")
    parser.add_argument("--runs", nargs=2, default=(), metavar=("RUN_A", "RUN_B"))
    chosen = parser.parse_args()
    of_claims(chosen.repeats) if chosen.of == "claims" else of_compare(chosen.repeats, chosen.runs)
