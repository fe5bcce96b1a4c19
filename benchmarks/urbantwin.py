"""A contest entry scored by the contest's metrics and by fidpipe, next to real frames against each other.

    python benchmarks/urbantwin.py ../shared/data/lumpi

Every figure of `docs/urbantwin.md`. Needs `pip install small_gicp`.
"""

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("OMP_NUM_THREADS", "1")

import argparse
import itertools
from pathlib import Path

import numpy as np
import ot
import small_gicp
from scipy.linalg import sqrtm
from scipy.spatial import cKDTree
from scipy.spatial.distance import cdist

from fidpipe.pipeline.diagnose.tell_apart import tell_apart_folders
from fidpipe.schemas.settings import load
from fidpipe.stages.ground import remove_ground
from fidpipe.stages.pieces import CutScan, find_pieces

#: The contest's region, sample and range of each metric, from which its score is made (config.json of the track).
BOX = np.array([[-40.0, -40.0, -5.0], [40.0, 40.0, 5.0]])
SAMPLE, SEED = 10_000, 1234
LIMITS = {"CD": (2.0, 30.0), "MMD": (0.0, 0.5), "EMD": (0.0, 5.0), "FPD": (0.0, 50.0)}
WORDS = [
    'input.columns=["x","y","z"]',
    "input.min_range_m=0",
    "input.include_box=[-40,-40,-5,40,40,5]",
]
ROAD_M = 1.0
REACHES_M = (0.1, 0.3, 1.0)


def read(folder):
    for path in sorted(folder.glob("*.bin")):
        points = np.fromfile(path, np.float32).reshape(-1, 3).astype(float)
        yield points[((points >= BOX[0]) & (points <= BOX[1])).all(axis=1)]


def contest(real, sim):
    """The four distances between two clouds, and the realism score."""
    a = real[np.random.default_rng(SEED).choice(len(real), SAMPLE, replace=False)]
    b = sim[np.random.default_rng(SEED + 1).choice(len(sim), SAMPLE, replace=False)]
    to_b = cKDTree(b).query(a)[0]
    to_a = cKDTree(a).query(b)[0]
    few = a[:4000], b[:4000]
    width = np.median(cdist(*few))
    kernel = {
        (i, j): np.exp(-cdist(few[i], few[j], "sqeuclidean") / (2 * width**2)).mean()
        for i, j in ((0, 0), (0, 1), (1, 1))
    }
    A, B = np.cov(a.T), np.cov(b.T)
    found = {
        "CD": (to_b**2).mean() + (to_a**2).mean(),
        "MMD": kernel[0, 0] + kernel[1, 1] - 2 * kernel[0, 1],
        "EMD": float(ot.emd2([], [], cdist(a, b), numItermax=10**8)),
        "FPD": float(
            ((a.mean(axis=0) - b.mean(axis=0)) ** 2).sum()
            + np.trace(A + B - 2 * sqrtm(A @ B).real)
        ),
    }
    kept = [
        1 - np.clip((found[name] - low) / (high - low), 0, 1)
        for name, (low, high) in LIMITS.items()
    ]
    return found | {"realism": float(np.mean(kept))}


def align(real, sim, fixed):
    """Motions of the simulated onto the real cloud by GICP from 117 starts, and the share of `fixed` that each covers.

    Best first.
    """
    found = []
    for yaw_deg, x, y in itertools.product(range(-6, 7), (-2.0, 0.0, 2.0), (-2.0, 0.0, 2.0)):
        start = np.eye(4)
        c = np.cos(np.radians(yaw_deg))
        s = np.sin(np.radians(yaw_deg))
        start[:2, :2] = [[c, -s], [s, c]]
        start[:2, 3] = (x, y)
        options = {"downsampling_resolution": 0.25, "max_correspondence_distance": 4.0}
        T = small_gicp.align(
            real, sim, init_T_target_source=start, registration_type="GICP", **options
        ).T_target_source
        found.append((covered(fixed, moved(T, [sim]))[1], T))
    return sorted(found, key=lambda each: -each[0])


def affine(sim, real, alpha=0.9):
    """The entrant's last step: mean and deviation along each axis moved to those of real frames, by `alpha`."""
    sim_points = np.vstack(sim)
    real_points = np.vstack(real)
    mean = sim_points.mean(axis=0)
    scale = 1 + alpha * (real_points.std(axis=0) / sim_points.std(axis=0) - 1)
    new_mean = mean + alpha * (real_points.mean(axis=0) - mean)
    return [(points - mean) * scale + new_mean for points in sim]


def static(frames, i):
    """Points of a frame that all other frames of its side have within 0.3 m, at least 1 m above the road."""
    is_in = frames[i][:, 2] > road(frames[i]) + ROAD_M
    for other in frames[:i] + frames[i + 1 :]:
        is_in &= cKDTree(other).query(frames[i])[0] < 0.3
    return frames[i][is_in]


def road(points):
    return remove_ground(points, load().ground).peak_m


def covered(points, others):
    distance_m = cKDTree(np.vstack(others)).query(points)[0]
    return [float((distance_m <= reach).mean()) for reach in REACHES_M]


def pieces(real, sim):
    """Share of the object points of each side in missing and invented pieces."""
    cuts = [remove_ground(cloud, load().ground) for cloud in (real, sim)]
    scans = [
        CutScan(cloud, cut.is_ground, cut.height_m)
        for cloud, cut in zip((real, sim), cuts, strict=True)
    ]
    return [own.share for own in find_pieces(*scans, load().pieces)]


def show(name, rows):
    rows = np.array(rows, dtype=float).reshape(-1, np.shape(rows)[-1])
    cells = [
        f"{np.mean(own):.3g} ({min(own):.3g} to {max(own):.3g})"
        if len(rows) > 1
        else f"{own[0]:.3g}"
        for own in rows.T
    ]
    print(f"| {name} | {' | '.join(cells)} |", flush=True)


def moved(T, clouds):
    return [cloud @ T[:3, :3].T + T[:3, 3] for cloud in clouds]


def main():
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", type=Path)
    args = parser.parse_args()
    real = list(read(args.folder / "real"))
    sim = list(read(args.folder / "sim"))
    n = range(len(real))
    print("| contest | CD | MMD | EMD | FPD | realism |\n|---|---|---|---|---|---|")
    pairs = list(itertools.combinations(n, 2))
    fixed = [static(real, i) for i in n]
    starts = align(np.vstack(real), np.vstack(sim), fixed[0])
    T = starts[0][1]
    aligned = moved(T, sim)
    twins = {
        "twin": sim,
        "twin, entrant's affine step": affine(sim, real),
        "twin, aligned": aligned,
    }
    measured = [list(contest(real[i], real[j]).values()) for i, j in pairs]
    show("real against real", measured)
    for name, twin in twins.items():
        show(name, [list(contest(real[i], twin[i]).values()) for i in n])
    cloud = np.vstack(real)
    means = cloud.mean(axis=0)
    stds = cloud.std(axis=0)
    blob = [
        np.random.default_rng(i).normal(means, stds, (len(own), 3)) for i, own in enumerate(sim)
    ]
    show(
        "Gaussian cloud of the real moments",
        [list(contest(real[i], blob[i]).values()) for i in n],
    )

    print("\nbest of 117 starts: covered 0.3 m, x y z (m), yaw (deg)")
    for share, one in starts[:4]:
        print(
            f"{share:.3f}",
            np.round(one[:3, 3], 2),
            round(float(np.degrees(np.arctan2(one[1, 0], one[0, 0]))), 2),
        )
    print("\n| static surface over 1 m | covered 0.1 m | 0.3 m | 1 m |\n|---|---|---|---|")
    show(
        "real, by the other real frames",
        [covered(fixed[i], real[:i] + real[i + 1 :]) for i in n],
    )
    for name, twin in twins.items():
        show(f"real, by the {name}", [covered(fixed[i], twin) for i in n])
        show(f"{name}, by the real frames", [covered(static(twin, i), real) for i in n])
    print("\n| share of object points | missing pieces | invented pieces |\n|---|---|---|")
    show("real against real", [pieces(real[i], real[j]) for i, j in pairs])
    for name, twin in twins.items():
        show(name, [pieces(real[i], twin[i]) for i in n])

    found = tell_apart_folders(args.folder / "real", args.folder / "sim", load(None, WORDS))
    base = found["real_against_real"]
    print("\n| tell apart | AUC | 95 % interval |\n|---|---|---|")
    for name, test in (("twin", found), (f"real against real, {base['of']}", base)):
        print(f"| {name} | {test['auc']:.3f} | {test['low']:.3f} to {test['high']:.3f} |")
    print(found["families"], found["features"])


if __name__ == "__main__":
    main()
