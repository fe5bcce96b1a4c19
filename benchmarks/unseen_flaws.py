"""Are flaws named that the estimators were not tuned on?

    python benchmarks/unseen_flaws.py ../shared/data/kitti_twin

Seventeen flaws of the simulated side, applied to five pairs on two bases: *poor* (the twin as it is) and *good* (each
real scan re-measured with 2 cm of noise along the ray and 3 % lost). Both sides are first reduced to every fourth row.
Prints per flaw what `fidpipe run` names first, what `fidpipe diagnose` puts first, and the headline of `fidpipe
compare` against the base. Stopped, it resumes.
"""

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("OMP_NUM_THREADS", "1")

import argparse
import json
import subprocess
from pathlib import Path

import numpy as np
from flawed_scans import random, ranges, read, write
from measure import FIDPIPE

from fidpipe.pipeline.diagnose.diagnose import diagnose_run
from fidpipe.pipeline.engine.progress import Reporter
from fidpipe.stages.sensor_description import describe_sensor

EVERY = 4
BASES = ("good", "poor")
NONE = "none"
SPEED_M_S = 8.0
SWEEP_S = 0.1


def spherical(points):
    """Range, azimuth and elevation, radians."""
    range_m = ranges(points)
    return range_m, np.arctan2(points[:, 1], points[:, 0]), np.arcsin(points[:, 2] / range_m)


def cartesian(range_m, azimuth, elevation):
    level_m = range_m * np.cos(elevation)
    return np.column_stack(
        [level_m * np.cos(azimuth), level_m * np.sin(azimuth), range_m * np.sin(elevation)]
    )


def remeasured(points, rng):
    kept = points[rng.random(len(points)) >= 0.03]
    return kept * (1 + rng.normal(0, 0.02, len(kept)) / ranges(kept))[:, None]


def rolled(angle_deg):
    c = np.cos(np.radians(angle_deg))
    s = np.sin(np.radians(angle_deg))
    return lambda points, rng: points @ np.array([[1, 0, 0], [0, c, -s], [0, s, c]]).T


def turned(angle_deg):
    c = np.cos(np.radians(angle_deg))
    s = np.sin(np.radians(angle_deg))
    return lambda points, rng: points @ np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]).T


def late(delay_s):
    return lambda points, rng: points + np.array([SPEED_M_S * delay_s, 0, 0])


def biased(bias_m):
    return lambda points, rng: points * (1 + bias_m / ranges(points))[:, None]


def blind(first_deg, last_deg):
    def cut(points, rng):
        azimuth_deg = np.degrees(np.arctan2(points[:, 1], points[:, 0]))
        return points[(azimuth_deg < first_deg) | (azimuth_deg > last_deg)]

    return cut


def with_second_returns(share, least_m, most_m):
    """Further returns of some rays, so much behind the first."""

    def add(points, rng):
        first = points[rng.random(len(points)) < share]
        behind_m = rng.uniform(least_m, most_m, len(first))
        return np.vstack([points, first * (1 + behind_m / ranges(first))[:, None]])

    return add


def jittering(angle_deg):
    def jitter(points, rng):
        range_m, azimuth, elevation = spherical(points)
        azimuth += np.radians(angle_deg) * rng.normal(size=len(points))
        elevation += np.radians(angle_deg) * rng.normal(size=len(points))
        return cartesian(range_m, azimuth, elevation)

    return jitter


def stretched(share):
    def stretch(points, rng):
        range_m, azimuth, elevation = spherical(points)
        return cartesian(range_m, azimuth, elevation * (1 + share))

    return stretch


def one_pose(points, rng):
    """The sweep as from one pose, while the real scan is distorted by the motion."""
    turn = np.arctan2(points[:, 1], points[:, 0]) / (2 * np.pi)
    return points - turn[:, None] * [SPEED_M_S * SWEEP_S, 0, 0]


def beams_of(points):
    sensor = describe_sensor(points)
    return sensor.beam_of(points), sensor.beams_deg


def dead(n, least_deg=-90.0):
    """A number of beams above an elevation return nothing."""

    def cut(points, rng):
        beam, elevation_deg = beams_of(points)
        candidates = np.flatnonzero(elevation_deg > least_deg)
        gone = np.random.default_rng(5).choice(candidates, n, replace=False)
        return points[~np.isin(beam, gone)]

    return cut


def exchanged(a, b):
    """Two beams with each other's elevations."""

    def exchange(points, rng):
        beam, elevation_deg = beams_of(points)
        range_m, azimuth, elevation = spherical(points)
        apart = np.radians(elevation_deg[b] - elevation_deg[a])
        elevation[beam == a] += apart
        elevation[beam == b] -= apart
        return cartesian(range_m, azimuth, elevation)

    return exchange


def low_and_lossy(points, rng):
    return points[rng.random(len(points)) >= 0.15] - [0, 0, 0.08]


#: The first ten were seen while the estimators were written, the others were not.
FLAWS = {
    "roll 0.5 degrees": rolled(0.5),
    "roll 1.5 degrees": rolled(1.5),
    "latency 60 ms": late(0.06),
    "6 dead beams": dead(6),
    "blind sector of 57 degrees": blind(100, 157),
    "second returns 1 to 3 m behind 5 %": with_second_returns(0.05, 1, 3),
    "jitter of angles 0.15 degrees": jittering(0.15),
    "elevations 2 % too large": stretched(0.02),
    "one pose per sweep at 8 m/s": one_pose,
    "two beams exchanged": exchanged(10, 20),
    "yaw 0.4 degrees": turned(0.4),
    "ranges 6 cm too long": biased(0.06),
    "blind sector of 20 degrees": blind(-60, -40),
    "second returns 3 to 6 m behind 10 %": with_second_returns(0.1, 3, 6),
    "4 dead beams above -8 degrees": dead(4, -8.0),
    "neighbouring beams exchanged": exchanged(14, 15),
    "8 cm too low and 15 % lost": low_and_lossy,
}


def make_datasets(args):
    """Writes a dataset per base and flaw, all with the same real scans."""
    names = []
    for path in sorted((args.dataset / "real").glob("*.bin")):
        names.append(path.stem)
        real = read(path)[::EVERY]
        write(args.out / "real" / path.name, real)
        bases = {
            "good": remeasured(real, random(path.stem, "base")),
            "poor": read(args.dataset / "sim" / path.name)[::EVERY],
        }
        for base, points in bases.items():
            write(dataset(args, base, NONE) / "sim" / path.name, points)
            for flaw in args.flaws:
                flawed = FLAWS[flaw](points, random(path.stem, base, flaw))
                write(dataset(args, base, flaw) / "sim" / path.name, flawed)
    rows = "".join(f"{name},../../real/{name}.bin,sim/{name}.bin\n" for name in names)
    for base in BASES:
        for flaw in (NONE, *args.flaws):
            (dataset(args, base, flaw) / "pairs.csv").write_text("pair_id,real,sim\n" + rows)


def slug(flaw):
    return "".join(c if c.isalnum() else "-" for c in flaw)


def dataset(args, base, flaw):
    return args.out / base / slug(flaw)


def run_of(args, base, flaw):
    return args.out / "runs" / base / slug(flaw)


def fidpipe(*words):
    done = subprocess.run(
        [FIDPIPE, *map(str, words)], capture_output=True, text=True, check=False
    )
    if done.returncode not in (0, 4):
        raise SystemExit(
            f"fidpipe {' '.join(map(str, words))}: exit {done.returncode}\n{done.stderr[-2000:]}"
        )
    return done.stdout


def evaluate(args, base, flaw):
    """First causes of a run, without and with gains, and the headline of its comparison with the base."""
    run = run_of(args, base, flaw)
    fidpipe(
        "run", dataset(args, base, flaw), "--preset", "reference", "--out", run, "--workers", 1
    )
    named = json.loads((run / "run.json").read_text())["overview"]["causes"]
    diagnosed = diagnose_run(run, Reporter()).causes
    headline = "-"
    if flaw != NONE:
        headline = fidpipe("compare", run_of(args, base, NONE), run).strip().splitlines()[0]
    return (
        named[0]["words"] if named else "-",
        diagnosed[0].words if diagnosed else "-",
        headline,
    )


if __name__ == "__main__":
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("dataset", type=Path, help="folder with real/ and sim/")
    parser.add_argument(
        "--out", type=Path, default=Path(".cache/unseen"), help="datasets and runs; resumed"
    )
    parser.add_argument("--flaws", nargs="+", choices=FLAWS, default=list(FLAWS))
    arguments = parser.parse_args()
    make_datasets(arguments)
    print("| base | flaw | `run` | `diagnose` | `compare` |", "|---|---|---|---|---|", sep="\n")
    for base in BASES:
        for flaw in (NONE, *arguments.flaws):
            cells = " | ".join(evaluate(arguments, base, flaw))
            print(f"| {base} | {flaw} | {cells} |", flush=True)
