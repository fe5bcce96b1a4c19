"""Does the tell-apart test see the flaws of a simulator, and is it blind to two measurements by one sensor?

    fidpipe twin ../shared/data/kitti_sequence .cache/twins --pairs '*[02468]'
    python benchmarks/tell_apart.py ../shared/data/kitti_twin .cache/twins

First real against real of one sensor, then each flaw of `decisions.py` on its bases, in memory: AUC, its change
against the base with t over the folds, and the other score that sees the flaw best, by t over the pairs.
"""

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("OMP_NUM_THREADS", "1")

import argparse
from pathlib import Path
from unittest.mock import patch

import numpy as np
import pandas as pd
import pyarrow as pa
from decisions import EVERY, NONE, random, read
from flawed_scans import ALL, Scan, find_car, find_poles, ray_noise

from fidpipe.pipeline.datasets.readers import frames_of, read_scan
from fidpipe.pipeline.diagnose.tell_apart import compare_samples, draw_sample, features_of
from fidpipe.schemas.settings import load
from fidpipe.stages.clean import clean_scan
from fidpipe.stages.coverage import cover, nearest_distances
from fidpipe.stages.diagnose import tell_apart as classifier
from fidpipe.stages.ground import remove_ground
from fidpipe.stages.pieces import CutScan, find_pieces
from fidpipe.stages.rays import find_rays, score_rays
from fidpipe.stages.sensor_description import describe_sensor
from fidpipe.stages.surface import compare_roughness, describe_surface, measure_offsets

SETTINGS = load(preset="reference")
SENSOR = ("azimuth_step_deg", "range_quantum_m", "range_noise_m", "lost_share")
MILD = {
    "0.5 cm noise, 1 % loss": (0.005, 0.01),
    "1 cm noise": (0.01, 0.0),
    "3 cm noise": (0.03, 0.0),
    "8 cm noise": (0.08, 0.0),
    "20 % loss": (0.0, 0.2),
}


def cleaned(points):
    points = clean_scan(points, SETTINGS.input).points
    return points, remove_ground(points, SETTINGS.ground)


def ground_of(cloud):
    points, cut = cloud
    columns = dict(zip("xyz", points.T, strict=True))
    columns |= {"height_m": cut.height_m, "is_ground": cut.is_ground}
    return pa.table(columns | {"intensity": np.zeros(len(points))})


def sample(clouds):
    return draw_sample([(ground_of(cloud), None) for cloud in clouds], len(clouds))


def show(name, found):
    print(
        f"| {name} | {found.auc:.3f} | {found.low:.3f} to {found.high:.3f} | {len(found.by_fold)} |",
        flush=True,
    )


def real_against_real(name, scans):
    """Even against odd frames, and the first half against the second."""
    clouds = [cleaned(scan) for scan in scans]
    half = len(scans) // 2
    for which, a, b in (
        ("even and odd frames", clouds[: 2 * half : 2], clouds[1::2]),
        ("first and second half", clouds[:half], clouds[half : 2 * half]),
    ):
        both = sample(a), sample(b)
        show(f"{name}, {which}", compare_samples(*both, features_of(both[0])))
        with patch.object(classifier, "GUARD_DEG", 0.0):
            show(
                f"{name}, {which}, without the margin",
                compare_samples(*both, features_of(both[0])),
            )


def scores(real, sim):
    """Scores of a pair that need no objects."""
    both = (real, sim)
    points = [own[~cut.is_ground] for own, cut in both]
    values = {}
    for side, distance_m in zip(("real", "sim"), nearest_distances(*points), strict=True):
        whole = cover(distance_m, np.zeros(len(distance_m), dtype=np.int32))
        values[f"covered {side}"] = whole.covered[0, 1]
    surfaces = [describe_surface(own) for own in points]
    values |= compare_roughness(*surfaces) | {"shift": measure_offsets(*surfaces).distance_m[0]}
    pieces = find_pieces(
        *(CutScan(own, cut.is_ground, cut.height_m) for own, cut in both), SETTINGS.pieces
    )
    values |= {"missing pieces": pieces[0].share, "invented pieces": pieces[1].share}
    sensors = [describe_sensor(scan) for scan, _ in both]
    values |= {name: getattr(sensors[1], name) for name in SENSOR}
    values |= {"beams": len(sensors[1].elevation_deg)}
    rays = find_rays(real[0], sim[0], sensors)
    return values | ({} if isinstance(rays, str) else score_rays(rays))


def t_of(change):
    """Mean over its standard error."""
    change = np.asarray(change, dtype=float)
    change = change[~np.isnan(change)]
    error = change.std(ddof=1) / np.sqrt(len(change)) if len(change) > 2 else 0.0
    return float(change.mean() / error) if error > 1e-12 else 0.0


def main():
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("datasets", type=Path, nargs="+", help="folders with real/ and sim/")
    parser.add_argument("--flaws", nargs="*", default=list(ALL))
    parser.add_argument("--bases", nargs="*", choices=("good", "poor"), default=["good"])
    parser.add_argument("--data", type=Path, default=Path("../shared/data"))
    args = parser.parse_args()
    print("| real against real | AUC | 95 % interval | folds |\n|---|---|---|---|")
    for name, paths in (
        (
            "HDL-64E, ten frames of a drive",
            sorted((args.data / "kitti_sequence").glob("*.bin")),
        ),
        (
            "HDL-64E, five frames of a drive",
            sorted((args.data / "kitti_twin/real").glob("*.bin")),
        ),
        (
            "VLP-32C, parked, four sweeps",
            frames_of(args.data / "velodyne_vlp32c/sweeps.pcap")[:4],
        ),
    ):
        real_against_real(name, [read_scan(path).points for path in paths])
    names = []
    scans = {"real": [], "poor": [], "good": []}
    full = []
    for path in (
        path for folder in args.datasets for path in sorted((folder / "real").glob("*.bin"))
    ):
        name = f"{path.parent.parent.name}-{path.stem}"
        cloud = read(path)
        car = find_car(cloud)
        poles = find_poles(cloud)
        real = cloud[::EVERY]
        kept = real[random(name, "loss").random(len(real)) >= 0.03]
        names.append(name)
        full.append(cloud)
        scans["real"].append(Scan(real, car, poles))
        scans["poor"].append(
            Scan(read(path.parent.with_name("sim") / path.name)[::EVERY], car, poles)
        )
        scans["good"].append(
            Scan(ray_noise(0.02)(Scan(kept, car, poles), random(name, "noise")), car, poles)
        )
    print(
        "\n| real against itself re-measured | AUC | 95 % interval | folds |\n|---|---|---|---|"
    )
    whole = sample([cleaned(cloud) for cloud in full])
    for name, (noise_m, lost) in MILD.items():
        again = [
            ray_noise(noise_m)(Scan(own[rng.random(len(own)) >= lost], None, None), rng)
            for own, rng in zip(full, (random(one, name) for one in names), strict=True)
        ]
        show(
            name,
            compare_samples(whole, sample([cleaned(own) for own in again]), features_of(whole)),
        )
    reals = [cleaned(own.points) for own in scans["real"]]
    real_sample = sample(reals)
    for base in args.bases:
        print(
            f"\n| flaw, {base} base | AUC | surface alone | change | t | best other score | t |\n"
            + "|---" * 7
            + "|"
        )
        before = None
        for flaw in (NONE, *args.flaws):
            sims = [
                cleaned(own.points if flaw == NONE else ALL[flaw](own, random(name, flaw)))
                for name, own in zip(names, scans[base], strict=True)
            ]
            drawn = sample(sims)
            found = compare_samples(real_sample, drawn, features_of(real_sample))
            surface = compare_samples(real_sample, drawn, classifier.FAMILIES["surface"])
            table = pd.DataFrame(
                [scores(*pair) for pair in zip(reals, sims, strict=True)]
            ).astype(float)
            row = f"| {flaw} | {found.auc:.3f} | {surface.auc:.3f} |"
            if before is None:
                before = found, table
                print(row, "- | - | - | - |", flush=True)
                continue
            t = {
                column: t_of(table[column] - before[1][column])
                for column in table.columns.intersection(before[1].columns)
            }
            best = max(t, key=lambda column: abs(t[column]))
            change = found.by_fold - before[0].by_fold
            print(
                row,
                f"{change.mean():+.3f} | {t_of(change):+.0f} | {best} | {t[best]:+.0f} |",
                flush=True,
            )


if __name__ == "__main__":
    main()
