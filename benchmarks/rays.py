"""Do the ray scores see the flaws of a simulator?

    fidpipe twin ../shared/data/kitti_sequence .cache/twins --pairs '*[02468]'
    python benchmarks/rays.py ../shared/data/kitti_twin .cache/twins

For each flaw of `decisions.py`, t over pairs of the change of each ray score against the twin without the flaw; and the
outcomes by range of the twins, with those of each real scan re-measured (2 cm range noise, 3 % loss) next to them.
"""

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("OMP_NUM_THREADS", "1")

import argparse
import zlib
from itertools import pairwise
from pathlib import Path

import numpy as np
import pandas as pd
from flawed_scans import ALL, Scan, find_car, find_poles, ranges, ray_noise

from fidpipe.pipeline.datasets.readers import read_scan
from fidpipe.stages.rays import OUTCOMES, RANGE_EDGES_M, find_rays, score_rays
from fidpipe.stages.sensor_description import describe_sensor

FLAWS = ALL | {"range +0.5 %": lambda scan, rng: 1.005 * scan.points}
SCORES = (
    *(f"rays_{name}" for name in OUTCOMES[:-1]),
    "rays_bias_m",
    "rays_scale",
    "rays_medae_m",
    "rays_rmse_m",
)


def read(path):
    points = read_scan(path).points
    return points[(ranges(points) > 2.5) & (ranges(points) < 100)]


def random(*names):
    return np.random.default_rng(zlib.crc32(" ".join(names).encode()))


def scores_of(real, sim, sensor):
    rays = find_rays(real, sim, (sensor, describe_sensor(sim)))
    return {} if isinstance(rays, str) else score_rays(rays)


def by_range(rays):
    """Shares of the outcomes and bias by band of range."""
    range_m = np.where(np.isnan(rays.real_range_m), rays.sim_range_m, rays.real_range_m)
    bands = {
        f"{low:g} to {high:g} m": score_rays(rays, (range_m >= low) & (range_m < high))
        for low, high in pairwise((*RANGE_EDGES_M, np.inf))
    }
    return pd.DataFrame(bands).T[[*SCORES[:7]]]


def main():
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("datasets", type=Path, nargs="+", help="folders with real/ and sim/")
    parser.add_argument("--flaws", nargs="*", default=list(FLAWS))
    args = parser.parse_args()
    scores = {}
    bands = {"twin": [], "best case": []}
    for path in (
        path for folder in args.datasets for path in sorted((folder / "real").glob("*.bin"))
    ):
        name = f"{path.parent.parent.name}-{path.stem}"
        real, sim = read(path), read(path.parent.with_name("sim") / path.name)
        sensor = describe_sensor(real)
        car = find_car(real)
        poles = find_poles(real)
        base = find_rays(real, sim, (sensor, describe_sensor(sim)))
        scores[name, ""] = score_rays(base)
        kept = real[random(name, "loss").random(len(real)) >= 0.03]
        best_case = find_rays(
            real,
            ray_noise(0.02)(Scan(kept, car, poles), random(name, "noise")),
            (sensor, sensor),
        )
        for which, rays in (("twin", base), ("best case", best_case)):
            bands[which].append(by_range(rays))
        for flaw in args.flaws:
            scores[name, flaw] = scores_of(
                real, FLAWS[flaw](Scan(sim, car, poles), random(name, flaw)), sensor
            )
        print(name, flush=True)
    table = pd.DataFrame(scores).T[list(SCORES)].astype(float)
    base = table.xs("", level=1)
    rows = {}
    for flaw in args.flaws:
        change = table.xs(flaw, level=1) - base
        spread = change.std(ddof=1) / np.sqrt(len(change))
        rows[flaw] = (change.mean() / spread.where(spread > 0)).round(1)
    t = pd.DataFrame(rows).T
    best = t.abs().idxmax(axis=1)
    t.insert(
        0,
        "best",
        [
            f"{column.removeprefix('rays_')} {t.loc[flaw, column]:+.0f}"
            for flaw, column in best.items()
        ],
    )
    t.columns = [name.removeprefix("rays_") for name in t.columns]
    print(t.to_string())
    for which, frames in bands.items():
        mean = sum(frame.astype(float) for frame in frames) / len(frames)
        mean.columns = [name.removeprefix("rays_") for name in mean.columns]
        print(f"\n{which}, mean of {len(frames)} pairs\n{mean.round(3).to_string()}")


if __name__ == "__main__":
    main()
