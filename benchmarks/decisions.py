"""Does fidpipe decide rightly that a simulator got worse, and does it name the flaw?

    fidpipe twin ../shared/data/kitti_sequence .cache/twins --pairs '*[02468]'
    python benchmarks/decisions.py ../shared/data/kitti_twin .cache/twins

Twenty-one flaws and a control on the simulated side of ten pairs, on two bases: *poor* (the twins as they are) and
*good* (each real scan re-measured with 2 cm range noise and 3 % loss). `fidpipe compare` gets the run of the base and
the run of the flawed copy; every flaw makes the simulator worse, so "worse" is the right decision.

Both sides are first reduced to every fourth row: the files list beam after beam, so this keeps all beams and a quarter
of the azimuth resolution. Flaws are applied afterwards, so that their amounts (200 points of rain, 12 holes) hold for
the scans that are compared. Flaws use numpy and scipy on points only, nothing of fidpipe. Stopped, it resumes.
"""

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("OMP_NUM_THREADS", "1")

import argparse
import json
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pandas as pd
from flawed_scans import (
    ALL,
    CONTROL,
    FLAWS,
    Scan,
    find_car,
    find_poles,
    random,
    ray_noise,
    read,
    write,
)
from measure import FIDPIPE

from fidpipe.pipeline.results.compare import compare_runs

EVERY = 4
NONE = "none"
BASES = ("poor", "good")
CAMPAIGNS = ("poor-reference", "good-reference", "poor-paper")


def make_datasets(args):
    """Writes a dataset per base and flaw, all with the same real scans; gives the points of each pair's car."""
    sources = [
        path for folder in args.datasets for path in sorted((folder / "real").glob("*.bin"))
    ]
    cars = {}
    for path in sources[:: args.every_pair]:
        name = f"{path.parent.parent.name}-{path.stem}"
        full = read(path)
        cars[name] = find_car(full)
        poles = find_poles(full)
        real = full[::EVERY]
        twin = read(path.parent.with_name("sim") / path.name)[::EVERY]
        kept = real[random(name, "loss").random(len(real)) >= 0.03]
        remeasured = ray_noise(0.02)(Scan(kept, cars[name], poles), random(name, "noise"))
        write(args.out / "real" / f"{name}.bin", real)
        for base, points in (("poor", twin), ("good", remeasured)):
            for flaw in (NONE, *args.flaws):
                scan = Scan(points, cars[name], poles)
                flawed = points if flaw == NONE else ALL[flaw](scan, random(name, flaw))
                write(dataset(args, base, flaw) / "sim" / f"{name}.bin", flawed)
    rows = "".join(f"{name},../../real/{name}.bin,sim/{name}.bin\n" for name in cars)
    for base in BASES:
        for flaw in (NONE, *args.flaws):
            (dataset(args, base, flaw) / "pairs.csv").write_text("pair_id,real,sim\n" + rows)
    return cars


def slug(flaw):
    return "".join(c if c.isalnum() else "-" for c in flaw)


def dataset(args, base, flaw):
    return args.out / base / slug(flaw)


def run_of(args, campaign, flaw):
    return args.out / "runs" / campaign / slug(flaw)


def fidpipe(*words):
    done = subprocess.run(
        [FIDPIPE, *map(str, words)], capture_output=True, text=True, check=False
    )
    if done.returncode:
        raise SystemExit(
            f"fidpipe {' '.join(map(str, words))}: exit {done.returncode}\n{done.stderr[-2000:]}"
        )
    return done.stdout


def run_all(args):
    tasks = [(campaign, flaw) for campaign in args.campaigns for flaw in (NONE, *args.flaws)]

    def run(task):
        base, preset = task[0].split("-")
        out = run_of(args, *task)
        fidpipe(
            "run",
            dataset(args, base, task[1]),
            "--preset",
            preset,
            "--out",
            out,
            "--workers",
            1,
            "--replace",
        )
        print(*task, "done", file=sys.stderr, flush=True)

    with ThreadPoolExecutor(args.jobs) as pool:
        list(pool.map(run, tasks))


def decide(args, campaign, flaw, *, independent=False):
    """The decision of `compare` between base and flaw, its families that moved, and the causes that changed."""
    runs = [run_of(args, campaign, NONE), run_of(args, campaign, flaw)]
    found = compare_runs(runs, independent=independent)[0].as_dict()
    moved = [one for one in found["families"] if one["verdict"] in ("better", "worse", "mixed")]
    families = [
        f"({one['name']} {one['verdict']})" if one["why"] else f"{one['name']} {one['verdict']}"
        for one in moved
    ]
    causes = [f"{changed['words']} {changed['verdict']}".strip() for changed in found["causes"]]
    return found["decision"], ", ".join(families) or "-", ", ".join(causes) or "-"


def first_cause(args, campaign, flaw):
    causes = json.loads((run_of(args, campaign, flaw) / "run.json").read_text())["overview"][
        "causes"
    ]
    return causes[0]["words"] if causes else "-"


def pairs_with_car_missing(args, campaign, flaw, cars):
    """Number of pairs with a missing piece whose centroid is in the car's box or at most 0.5 m outside."""
    pieces = pd.read_parquet(run_of(args, campaign, flaw) / "pieces").query("side == 'real'")
    n = 0
    for name, car in cars.items():
        low = car.min(axis=0) - 0.5
        high = car.max(axis=0) + 0.5
        centres = pieces.loc[pieces.pair_id == name, ["cx", "cy", "cz"]].to_numpy()
        n += bool(((centres >= low) & (centres <= high)).all(axis=1).any())
    return n


def decision_table(args, campaign, cars):
    lines = [
        f"`{campaign}`, {len(cars)} pairs:",
        "| flaw | decision | with `--independent` | families | first cause of the run | causes that changed |",
        "|---|---|---|---|---|---|",
    ]
    decisions = {}
    independent = {}
    for flaw in args.flaws:
        decisions[flaw], families, causes = decide(args, campaign, flaw)
        independent[flaw] = decide(args, campaign, flaw, independent=True)[0]
        first = first_cause(args, campaign, flaw)
        lines.append(
            f"| {flaw} | {decisions[flaw]} | {independent[flaw]} | {families} | {first} | {causes} |"
        )
    lines.append("")
    for title, own in (("by default", decisions), ("with `--independent`", independent)):
        counted = [own[flaw] for flaw in FLAWS if flaw in own and flaw != CONTROL]
        counts = ", ".join(
            f"{counted.count(word)} {word}"
            for word in ("worse", "mixed", "better", "undecided", "same")
        )
        lines.append(f"Of {len(counted)} flaws {title}: {counts}; control: {own.get(CONTROL)}.")
    lines.append(f"First cause of the base: {first_cause(args, campaign, NONE)}.")
    for flaw in (NONE, *(flaw for flaw in args.flaws if "car" in flaw)):
        n = pairs_with_car_missing(args, campaign, flaw, cars)
        lines.append(f"The car is among the missing pieces ({flaw}): {n} of {len(cars)} pairs.")
    return "\n".join(lines)


def changes(args, campaign):
    """Mean change and paired t over pairs of every number of `pairs`, one row per flaw and column."""
    before = pd.read_parquet(run_of(args, campaign, NONE) / "pairs.parquet").set_index(
        "pair_id"
    )
    rows = []
    for flaw in args.flaws:
        after = pd.read_parquet(run_of(args, campaign, flaw) / "pairs.parquet").set_index(
            "pair_id"
        )
        for column in after.select_dtypes("number"):
            change = (after[column] - before[column]).dropna().astype(float)
            error = change.std(ddof=1) / np.sqrt(len(change))
            t = 0.0
            if change.any():
                t = change.mean() / error if error else np.sign(change.mean()) * np.inf
            rows.append(
                (campaign, flaw, column, before[column].mean(), change.mean(), t, len(change))
            )
    return pd.DataFrame(
        rows, columns=["campaign", "flaw", "column", "before", "change", "t", "pairs"]
    )


def pieces_table(found, campaign):
    columns = ("n_missing_pieces", "n_invented_pieces", "cdc_mean")
    t = found[found.campaign == campaign].pivot(index="flaw", columns="column", values="t")
    lines = [
        f"`{campaign}`, t over pairs:",
        "| flaw | missing pieces | invented pieces | CDC |",
        "|---|---|---|---|",
    ]
    for flaw in dict.fromkeys(found.flaw):
        cells = [f"{t.loc[flaw, column]:.1f}" for column in columns]
        lines.append(f"| {flaw} | {' | '.join(cells)} |")
    return "\n".join(lines)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("datasets", type=Path, nargs="+", help="folders with real/ and sim/")
    parser.add_argument(
        "--out", type=Path, default=Path(".cache/decisions"), help="datasets and runs; resumed"
    )
    parser.add_argument(
        "--campaigns",
        nargs="+",
        choices=CAMPAIGNS,
        default=list(CAMPAIGNS),
        help="base and preset",
    )
    parser.add_argument("--flaws", nargs="+", choices=ALL, default=list(ALL))
    parser.add_argument(
        "--every-pair", type=int, default=1, help="take each n-th pair, to try the script"
    )
    parser.add_argument(
        "--jobs", type=int, default=os.cpu_count(), help="runs at the same time"
    )
    arguments = parser.parse_args()
    cars_of_pairs = make_datasets(arguments)
    run_all(arguments)
    measured = pd.concat([changes(arguments, campaign) for campaign in arguments.campaigns])
    measured.to_csv(arguments.out / "changes.csv", index=False)
    for one in arguments.campaigns:
        print(
            decision_table(arguments, one, cars_of_pairs),
            pieces_table(measured, one),
            sep="\n\n",
            end="\n\n",
        )
