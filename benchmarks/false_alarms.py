"""How often are verdicts of `fidpipe compare` wrong by chance?

    python benchmarks/false_alarms.py [--repeats 400] [--of compare|runs]
    python benchmarks/false_alarms.py --make ../shared/data/kitti_sequence worlds
    for i in worlds/*; do fidpipe run $i --preset reference --out runs/$(basename $i); done
    python benchmarks/false_alarms.py --of runs --draws ../shared/data/kitti_twin TWINS --worlds runs/w*

`compare`: eight families of four scores of equal simulators, by the distribution of the scores' changes; scores of a
family are correlated at 0.6, those of different families at 0.2. A false alarm is any family that is decided. Power:
how often the first family is decided if its first score changes by 0.5, 1 or 2 standard deviations.

`runs`: scans of real streets, every eighth row. *Independent draws*: the simulated side re-measured twice (2 cm, 3 %).
*Fixed in the world*: ten neighbouring frames by simulators that each have 12 holes and 8 ghosts at random places of the
street; every two of their runs are compared. All simulators of a kind are equal in distribution, so that each verdict
is a false alarm.
"""

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("OMP_NUM_THREADS", "1")

import argparse
from concurrent.futures import ProcessPoolExecutor
from itertools import combinations
from pathlib import Path

import numpy as np
import pandas as pd
from flawed_scans import write
from scipy import stats

import fidpipe
from fidpipe.pipeline.datasets.pairs import read_dataset
from fidpipe.pipeline.datasets.readers import read_scan
from fidpipe.pipeline.results.compare import compare_runs
from fidpipe.pipeline.results.families import ScoredPairs, judge_families, overall
from fidpipe.stages.statistics.comparison import adjusted_p_values, holm

N_FAMILIES, N_SCORES = 8, 4
SIZES = (3, 5, 6, 8, 10, 20, 50)
STEPS = (0.5, 1.0, 2.0)


def correlated(rng, n):
    """(families, scores, n) normal changes, correlated within a family and less over families."""
    shape = (N_FAMILIES, N_SCORES, n)
    shared = rng.normal(size=(1, 1, n))
    own_family = rng.normal(size=(N_FAMILIES, 1, n))
    own = rng.normal(size=shape)
    return np.sqrt(0.2) * shared + np.sqrt(0.4) * own_family + np.sqrt(0.4) * own


def shares(rng, n):
    return stats.norm.cdf(correlated(rng, n))


#: Changes of equal simulators by distribution, each of standard deviation 1, with the smallest step of the scores.
DISTRIBUTIONS = {
    "normal": (correlated, 0.0),
    "skewed scores": (
        lambda rng, n: (
            (stats.expon.ppf(shares(rng, n)) - stats.expon.ppf(shares(rng, n))) / 2**0.5
        ),
        0.0,
    ),
    "heavy tails (t, 3 degrees)": (lambda rng, n: stats.t.ppf(shares(rng, n), 3) / 3**0.5, 0.0),
    "discrete (-1, 0, 1)": (
        lambda rng, n: (np.floor(3 * shares(rng, n)) - 1) / (2 / 3) ** 0.5,
        (3 / 2) ** 0.5,
    ),
    "skewed changes of mean 0": (lambda rng, n: stats.expon.ppf(shares(rng, n)) - 1, 0.0),
}


def lowest_p(changes, step):
    return np.nanmin(adjusted_p_values(changes, np.zeros(N_SCORES), np.full(N_SCORES, step)))


def rates(make, step, n, repeats, seed=0):
    """Share of comparisons with a false alarm, and with the first family decided at each step of its first score."""
    rng = np.random.default_rng(seed)
    found = []
    for _ in range(repeats):
        changes = make(rng, n)
        alone = [lowest_p(own, step) for own in changes]
        moved = [changes[0] + np.array([[size]] + [[0.0]] * (N_SCORES - 1)) for size in STEPS]
        powers = [holm([lowest_p(own, step), *alone[1:]])[0] < 0.05 for own in moved]
        found.append([min(holm(alone)) < 0.05, *powers])
    return np.mean(found, axis=0)


def of_compare(repeats):
    print(f"{repeats} repeats; binomial error of 5 %: {np.sqrt(0.05 * 0.95 / repeats):.1%}")
    print(
        "False alarms; power at 0.5, 1, 2 standard deviations, by the number of independent pairs"
    )
    print("| changes | " + " | ".join(map(str, SIZES)) + " |")
    print("|---" * (len(SIZES) + 1) + "|")
    for name, (make, step) in DISTRIBUTIONS.items():
        found = [rates(make, step, n, repeats) for n in SIZES]
        cells = []
        for alarms, *powers in found:
            percents = [f"{100 * power:.0f}" for power in powers]
            cells.append(f"{100 * alarms:.1f} %; {', '.join(percents)}")
        print(f"| {name} | " + " | ".join(cells) + " |", flush=True)


EVERY, DRAWS, WORLDS = 8, 8, 16


def remeasured(points, rng):
    """Points with 2 cm noise along the ray, 3 % of them lost."""
    points = points[rng.random(len(points)) > 0.03]
    lengths = np.linalg.norm(points, axis=1, keepdims=True)
    return points * (1 + rng.normal(0, 0.02, (len(points), 1)) / np.maximum(lengths, 1e-6))


def in_world(points, pose, seed):
    """Points with the holes and ghosts of one simulator, at fixed places of the street (`pose` maps to the world)."""
    rng = np.random.default_rng(seed)
    holes = rng.uniform([-20, -20, -1.0], [35, 20, 1.0], (12, 3))
    ghosts = rng.uniform([-20, -20, -0.5], [35, 20, 2.0], (8, 3))
    clouds = (ghosts[:, None] + rng.normal(0, 0.3, (8, 40, 3))).reshape(-1, 3)
    to_sensor = np.linalg.inv(pose)
    holes = holes @ to_sensor[:3, :3].T + to_sensor[:3, 3]
    clouds = clouds @ to_sensor[:3, :3].T + to_sensor[:3, 3]
    kept = (np.linalg.norm(points[:, None] - holes, axis=2) > 1.5).all(axis=1)
    return np.vstack([points[kept], clouds])


def read(path):
    points = read_scan(path).points[::EVERY]
    return points[np.isfinite(points).all(axis=1)]


def poses_of(folder):
    """(4, 4) of each scan, sensor to world, from poses in TUM format."""
    from scipy.spatial.transform import Rotation

    for row in np.loadtxt(folder / "poses.tum"):
        pose = np.eye(4)
        pose[:3, :3] = Rotation.from_quat(row[4:8]).as_matrix()
        pose[:3, 3] = row[1:4]
        yield pose


def make_worlds(sequence, out):
    """Writes a dataset of neighbouring frames for each of 16 simulators with their own defects of the street."""
    for path, pose in zip(sorted(sequence.glob("*.bin")), poses_of(sequence), strict=True):
        for i in range(WORLDS):
            rng = np.random.default_rng([i, *path.stem.encode()])
            write(out / f"w{i:02d}" / "real" / path.name, read(path))
            write(
                out / f"w{i:02d}" / "sim" / path.name,
                in_world(remeasured(read(path), rng), pose, i),
            )


def scored(name, draw, real, sim):
    points = remeasured(read(sim), np.random.default_rng([draw, *name.encode()]))
    return {"pair": name, "draw": draw} | fidpipe.evaluate_pair(
        read(real), points, {"preset": "reference"}
    ).summary


def measure_draws(args):
    """Rows of `pairs` for 8 draws of each simulated scan; those in the CSV file are kept."""
    rows = pd.read_csv(args.out).to_dict("records") if args.out.exists() else []
    done = {(row["pair"], row["draw"]) for row in rows}
    datasets = [
        (folder.name, pair) for folder in args.draws for pair in read_dataset(folder).pairs
    ]
    tasks = [
        (f"{name}/{own.pair_id}", i, own.real, own.sim)
        for name, own in datasets
        for i in range(DRAWS)
    ]
    with ProcessPoolExecutor(args.workers) as pool:
        futures = [pool.submit(scored, *task) for task in tasks if task[:2] not in done]
        for n, future in enumerate(futures, 1):
            rows.append(future.result())
            if n % 20 == 0 or n == len(futures):
                pd.DataFrame(rows).to_csv(args.out, index=False)
    rows = pd.DataFrame(rows)
    return {
        (row["pair"], row["draw"]): row
        for row in rows.astype(object).where(rows.notna(), None).to_dict("records")
    }


def print_rate(words, decisions):
    rate = np.isin(decisions, ["better", "worse", "mixed"]).mean()
    print(f"| {words} | {len(decisions)} | {100 * rate:.1f} % |", flush=True)


def of_runs(args):
    print("| equal simulators | comparisons | better, worse or mixed |")
    print("|---|---|---|")
    if args.draws:
        rows = measure_draws(args)
        rng = np.random.default_rng(0)
        decisions = []
        names = sorted({pair for pair, _ in rows})
        for _ in range(args.repeats):
            before = []
            after = []
            for name in names:
                first, second = rng.choice(DRAWS, 2, replace=False)
                before.append(rows[name, first])
                after.append(rows[name, second])
            blocks = np.arange(len(names), dtype=np.int32)
            pairs = ScoredPairs([pd.DataFrame(before), pd.DataFrame(after)], blocks)
            families = judge_families("reference", pairs)
            decisions.append(overall({family.verdict for family in families if not family.why}))
        print_rate(f"independent draws of {len(names)} pairs", decisions)
    couples = list(combinations(args.worlds or [], 2))
    for words, independent in (
        ("defects fixed in the world, as neighbouring frames", False),
        ("--independent", True),
    ):
        if couples:
            print_rate(
                words,
                [compare_runs(both, independent=independent)[0].decision for both in couples],
            )


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--repeats", type=int, default=400)
    parser.add_argument("--of", choices=("compare", "runs"), default="compare")
    parser.add_argument("--draws", type=Path, nargs="+", help="folders of pairs, for --of runs")
    parser.add_argument(
        "--worlds", type=Path, nargs="+", help="finished runs of the datasets of --make"
    )
    parser.add_argument(
        "--make", type=Path, nargs=2, metavar=("SEQUENCE", "OUT"), help="write those and stop"
    )
    parser.add_argument("--out", type=Path, default=Path("false_alarms.csv"))
    parser.add_argument("--workers", type=int, default=os.cpu_count())
    chosen = parser.parse_args()
    if chosen.make:
        make_worlds(*chosen.make)
    elif chosen.of == "compare":
        of_compare(chosen.repeats)
    else:
        of_runs(chosen)
