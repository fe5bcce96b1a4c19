"""Which faults of a side as a whole does check see, and how often does it see one where there is none?

    python benchmarks/checks.py ../shared/data     # the tables of docs/checks.md

Hits: each fault made on purpose. False alarms: the same recordings as they are, the simulated side measured again (3 cm
noise, 30 % lost) where there is none. The limits were chosen on the recordings that are not called held out.
"""

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import re
import sys
import time
from pathlib import Path

import numpy as np

from fidpipe.pipeline.datasets.pairs import ScanPair
from fidpipe.pipeline.datasets.readers import frames_of, read_scan
from fidpipe.pipeline.datasets.readers.scan import Scan
from fidpipe.pipeline.inspect.side_checks import sample_scan, side_warnings, stretches_of
from fidpipe.schemas.sensor_models import SENSORS
from fidpipe.schemas.settings import FRAME_AXES, InputSettings
from fidpipe.stages.clean import as_ros, clean_scan
from fidpipe.stages.frame_search import check_frames
from fidpipe.stages.generate.street_scans import make_pair
from fidpipe.stages.plausibility import implausible

SETTINGS = InputSettings()
SEEN = {  # which fault a warning is of
    "late": r"frames? late",
    "early": r"frames? early|or more early",
    "static real": "all real scans are alike",
    "static sim": "all simulated scans are alike",
    "empty": "nearly empty",
    "ego real": r"^real scans: .* own vehicle",
    "ego sim": r"^simulated scans: .* own vehicle",
}


def again(points, seed):
    rng = np.random.default_rng(seed)
    kept = points[np.isfinite(points).all(axis=1) & points.any(axis=1)]
    kept = kept[rng.random(len(kept)) < 0.7]
    return kept + rng.normal(0, 0.03, kept.shape)


def bonnet(n, seed=0):
    """Returns of a bonnet, 2.6 to 3.8 m ahead and 0.8 m below the sensor."""
    rng = np.random.default_rng(seed)
    return rng.uniform([2.6, -0.8, -0.85], [3.8, 0.8, -0.75], (n, 3))


def with_bonnet(scans, n):
    return [np.vstack([points, bonnet(n, i)]) for i, points in enumerate(scans)]


def still(scans):
    return [again(scans[0], 100 + i) for i in range(len(scans))]


#: Fault: what becomes of both sides, and what is to be seen.
FAULTS = {
    "none": (lambda real, sim: (real, sim), None),
    "simulated 1 frame late": (lambda real, sim: (real[1:], sim[:-1]), "late"),
    "simulated 2 frames late": (lambda real, sim: (real[2:], sim[:-2]), "late"),
    "simulated 1 frame early": (lambda real, sim: (real[:-1], sim[1:]), "early"),
    "simulated side static": (lambda real, sim: (real, still(sim)), "static sim"),
    "real side static": (lambda real, sim: (still(real), sim), "static real"),
    "simulated side nearly empty (1 point in 40)": (
        lambda real, sim: (real, [each[::40] for each in sim]),
        "empty",
    ),
    "300 hits on the bonnet, real": (
        lambda real, sim: (with_bonnet(real, 300), sim),
        "ego real",
    ),
    "3000 hits on the bonnet, simulated": (
        lambda real, sim: (real, with_bonnet(sim, 3000)),
        "ego sim",
    ),
}


def points_of(paths):
    return [read_scan(path).points for path in paths]


def streets(seed, n, sensor):
    pairs = [make_pair(seed, i, SENSORS[sensor]) for i in range(n)]
    real = [pair.real.rows[:, :3].astype(float) for pair in pairs]
    sim = [pair.sim.rows[:, :3].astype(float) for pair in pairs]
    return real, sim


def with_copies(scans):
    return scans, [again(points, i) for i, points in enumerate(scans)]


def sequences(data):
    """Real and simulated scans in order of time, by what they are."""
    return {
        "kitti_sequence": with_copies(
            points_of(sorted((data / "kitti_sequence").glob("*.bin")))
        ),
        "kitti_twin": tuple(
            points_of(sorted((data / "kitti_twin" / side).iterdir()))
            for side in ("real", "sim")
        ),
        "VLP-32C, parked": with_copies(
            points_of(frames_of(data / "velodyne_vlp32c/sweeps.pcap")[:4])
        ),
        "carla, 2 frames": with_copies(
            points_of(data / "carla" / f"0000{i}.bin" for i in (30, 31))
        ),
        "synth --seed 0": streets(0, 8, "vlp32c"),
        "held out: synth --seed 31 --sensor os1-64": streets(31, 8, "os1-64"),
        "held out: registration": with_copies(
            points_of(data / "registration" / f"{i}.ply" for i in ("source", "target"))
        ),
    }


def cleaned_counts(scans):
    """Number of points of each scan after cleaning."""
    return [len(clean_scan(points, SETTINGS).points) for points in scans]


def seen(real, sim):
    """The faults that are named of two sides, and the seconds that this took."""
    pairs = [ScanPair(f"{i:03}", Path("real"), Path("sim"), 0.1 * i) for i in range(len(real))]
    start = time.process_time()
    stretches = stretches_of(pairs)
    sampled = {pair.pair_id for stretch in stretches for pair in stretch}
    samples = {}
    for side, scans in (("real", real), ("sim", sim)):
        samples[side] = {
            pair.pair_id: sample_scan(pair, side, Scan(points), None, SETTINGS)
            for pair, points in zip(pairs, scans, strict=True)
            if pair.pair_id in sampled
        }
    counts = {"real": cleaned_counts(real), "sim": cleaned_counts(sim)}
    lines = side_warnings(samples, counts, stretches, SETTINGS)
    seconds = time.process_time() - start
    return (
        {name for name, pattern in SEEN.items() for line in lines if re.search(pattern, line)},
        lines,
        seconds,
    )


def sides(data):
    found = sequences(data)
    seconds = []
    odd = []
    print("| fault | " + " | ".join(found) + " |\n" + "|---" * (len(found) + 1) + "|")
    for fault, (change, wanted) in FAULTS.items():
        cells = []
        for name, (real, sim) in found.items():
            own_real, own_sim = change(real, sim)
            if not own_real:
                cells.append("")
                continue
            names, lines, own_s = seen(own_real, own_sim)
            seconds.append(own_s / len(own_real))
            words = ["nothing"]
            if wanted:
                words = ["seen" if wanted in names else "not seen"]
            cells.append(
                ", ".join(words + [f"and {other}" for other in sorted(names - {wanted})])
            )
            odd += [(fault, name, line) for line in lines] if names != {wanted} - {None} else []
        print(f"| {fault} | " + " | ".join(cells) + " |", flush=True)
    print("\nNot as wanted:")
    for fault, name, line in odd:
        print(f"- {fault}; {name}: {line}")
    print(
        f"\n{np.median(seconds):.2f} s of one core a pair that is looked at, cleaning and benchmark included"
    )


def frames(data):
    twin = list(
        zip(
            *(
                points_of(sorted((data / "kitti_twin" / side).iterdir()))
                for side in ("real", "sim")
            ),
            strict=True,
        )
    )
    carla = points_of([data / "carla/000030.bin"])
    nuscenes = points_of((data / "nuscenes").glob("*.bin"))
    held = points_of([data / "registration/source.ply"])
    named = {
        "kitti_twin": twin,
        "carla, nuscenes, measured again": [
            (points, again(points, 0)) for points in carla + nuscenes
        ],
        "synth --seed 0": list(zip(*streets(0, 8, "vlp32c"), strict=True)),
        "held out: synth --seed 31 --sensor os1-64": list(
            zip(*streets(31, 8, "os1-64"), strict=True)
        ),
        "held out: registration, measured again": [
            (points, again(points, 0)) for points in held
        ],
    }
    print(
        "\n| real | simulated | " + " | ".join(named) + " |\n" + "|---" * (len(named) + 2) + "|"
    )
    for real_frame in FRAME_AXES:
        for sim_frame in FRAME_AXES:
            cells = []
            for pairs in named.values():
                n_seen = n_mended = 0
                for real, sim in pairs:
                    own = [
                        points[np.isfinite(points).all(axis=1)] @ as_ros(np.eye(3), frame).T
                        for points, frame in zip(
                            (real, sim), (real_frame, sim_frame), strict=True
                        )
                    ]
                    check = check_frames(*own, SETTINGS)
                    if check is None or not check.is_suspect:
                        continue
                    n_seen += 1
                    words = dict(re.findall(r"input\.(\w+)=([\w-]+)", check.setting))
                    if "T_real_sim" not in check.setting:
                        mended = check_frames(*own, InputSettings(**words))
                        n_mended += mended is not None and not mended.is_suspect
                cells.append(
                    f"{n_seen} of {len(pairs)}" + (f", mended {n_mended}" if n_seen else "")
                )
            print(f"| {real_frame} | {sim_frame} | " + " | ".join(cells) + " |", flush=True)


def camera(data):
    """Scans by themselves, as they are and in camera axes: what both sides in one wrong frame leave to see."""
    names = [
        "kitti_twin/*/000000.bin",
        "kitti_sequence/000000.bin",
        "carla/000030.bin",
        "carla/half_sweep.bin",
    ]
    names += [
        "rellis/*.bin",
        "registration/source.ply",
        "velodyne_vlp32c/*.pcd",
        "nuscenes/*.bin",
    ]
    scans = (
        points_of(path for name in names for path in sorted(data.glob(name)))
        + streets(0, 4, "vlp32c")[1]
    )
    scans = [points[np.isfinite(points).all(axis=1) & points.any(axis=1)] for points in scans]
    for name, turn in (
        ("as they are", np.eye(3)),
        ("in camera axes", as_ros(np.eye(3), "kitti-cam").T),
    ):
        texts = [" ".join(implausible(points @ turn, "real", 2.5)) for points in scans]
        n_told = sum("camera axes" in text for text in texts)
        print(f"\n{name}: {n_told} of {len(scans)} scans are said to be in camera axes")


def main(data):
    sides(data)
    frames(data)
    camera(data)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
