"""By how much are the shares that stage `causes` estimates wrong, relative to their size?

    python benchmarks/share_accuracy.py ../shared/data/kitti_twin

Flaws of which the share is known, in four amounts, on the two bases of `diagnosis.py`. The estimate is the mean over
the pairs, minus that of the base without the flaw. `relative` in `schemas/causes.toml` is the largest error of a cause,
rounded up; none of the scenes that `diagnosis.py` judges was used for it.
"""

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("OMP_NUM_THREADS", "1")

import sys
from pathlib import Path

import flawed_scans as fs
import numpy as np
import pandas as pd
from diagnosis import (
    altered,
    car_moved,
    estimated,
    far_drop,
    ghosts,
    grazing_drop,
    holes,
    mixed,
    pair_of,
    rain,
    read_scenes,
    values_of,
)
from flawed_scans import along_ray, ranges

from fidpipe.pipeline.results.causes import change_of, changed_causes
from fidpipe.stages.causes.sides import SCATTERED
from fidpipe.stages.surfels import fit_planes


def leaves(points):
    planes = fit_planes(points, points, 20)
    return (planes.scattering >= SCATTERED) & (planes.variance[:, 2] < 1.0)


def solid(share):
    """A share of the returns of foliage comes from 1 m in front of it."""
    return lambda scan, rng: along_ray(
        scan.points,
        ranges(scan.points) - (leaves(scan.points) & (rng.random(len(scan.points)) < share)),
    )


def share_early(scene, before, after, amount):
    """Share of the rays into real foliage next to a simulated return that was moved."""
    real = scene[1].points[leaves(scene[1].points)]
    angle, near = fs.cKDTree(before / ranges(before)[:, None]).query(
        real / ranges(real)[:, None]
    )
    return (ranges(after - before) > 0.5)[near[angle < np.radians(0.4)]].mean()


def share_cut(scene, before, after, amount):
    """Share of the real points that have a simulated one within 0.25 m, and none afterwards that is as near."""
    before_m = fs.cKDTree(before).query(scene[1].points)[0]
    after_m = fs.cKDTree(after).query(scene[1].points)[0]
    return ((before_m < 0.25) & (after_m > before_m)).mean()


#: By cause: the altered scan by amount, the amounts, and the true share, given the scans without the flaw and with it.
FLAWS = {
    "solid foliage": (solid, (0.1, 0.2, 0.4, 0.6), share_early),
    "moved parts": (
        car_moved,
        (0.6, 0.9, 1.2, 1.5),
        lambda scene, *_: fs.belongs_to_car(scene[1]).mean(),
    ),
    "lost returns": (
        fs.drop,
        (0.05, 0.1, 0.2, 0.4),
        lambda *scans_and_amount: scans_and_amount[-1],
    ),
    "lost far returns": (
        far_drop,
        (0.2, 0.4, 0.6, 0.8),
        lambda *scans_and_amount: scans_and_amount[-1],
    ),
    "lost grazing returns": (
        grazing_drop,
        (0.2, 0.4, 0.6, 0.8),
        lambda *scans_and_amount: scans_and_amount[-1],
    ),
    "mixed pixels": (
        mixed,
        (0.015, 0.03, 0.06, 0.1),
        lambda *scans_and_amount: scans_and_amount[-1],
    ),
    "invented parts": (
        ghosts,
        (0.005, 0.01, 0.02, 0.04),
        lambda scene, before, after, _: 1 - len(before) / len(after),
    ),
    "clutter": (
        rain,
        (60, 120, 200, 600),
        lambda scene, before, after, amount: amount / len(after),
    ),
    "missing parts": (holes, (3, 6, 12, 25), share_cut),
}


def rows(folder):
    scenes = read_scenes(folder, 1)
    blocks = np.arange(len(scenes), dtype=np.int32)
    for base in ("good", "poor"):
        before = values_of([estimated(pair_of(scene, scene[2][base])) for scene in scenes])
        for name, (make, amounts, true_share) in FLAWS.items():
            for amount in amounts:
                flaw = [(f"{name} {amount}", make(amount))]
                pairs = [
                    estimated(pair_of(scene, altered(scene, base, flaw))) for scene in scenes
                ]
                truths = []
                for scene, pair in zip(scenes, pairs, strict=True):
                    truths.append(
                        true_share(scene, scene[2][base], pair.scans.sim.points, amount)
                    )
                truth = np.mean(truths)
                after = values_of(pairs)
                mean = change_of(name, before[name], after[name], {}).mean()
                holds = "not named"
                for cause in changed_causes(before, after, {}, blocks):
                    if cause.name == name:
                        holds = cause.low <= truth <= cause.high
                yield name, base, amount, truth, mean, truth / mean - 1, holds


if __name__ == "__main__":
    columns = [
        "cause",
        "base",
        "amount",
        "truth",
        "estimate",
        "relative error",
        "interval holds",
    ]
    table = pd.DataFrame([*rows(Path(sys.argv[1]))], columns=columns)
    print(table.round(4).to_string(index=False))
    table["relative error"] = table["relative error"].abs()
    print(table.groupby("cause")["relative error"].max().round(3).to_string())
