"""Which faults of a frame are seen, and how often is one seen where there is none?

    python benchmarks/frames.py ../shared/data            # the tables of docs/checks.md
    python benchmarks/frames.py ../shared/data --choose   # the data by which the limits were chosen; not in the table
    python benchmarks/frames.py ../shared/data --places   # lifts, feet, and scans of two places

Hits: each fault made on purpose on the simulated side; where there is no pair, on the same scan measured again (5 cm
noise, half of the points lost). False alarms: pairs that lie in one frame, as they are.
"""

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import sys
import time
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from fidpipe.pipeline.datasets.readers import read_scan
from fidpipe.schemas.sensor_models import SENSORS
from fidpipe.schemas.settings import InputSettings
from fidpipe.stages.frame_search import check_frames
from fidpipe.stages.generate.street_scans import make_pair


def turned(degrees, axis="z", shift=(0, 0, 0)):
    return Rotation.from_euler(axis, degrees, degrees=True).as_matrix(), np.array(
        shift, dtype=float
    )


FAULTS = {
    "mirrored in y": (np.diag([1, -1, 1]), 0),
    "mirrored in x": (np.diag([-1, 1, 1]), 0),
    "turned by 90": turned(90),
    "turned by 180": turned(180),
    "turned by 270": turned(270),
    "x and y exchanged": (np.array([[0, 1, 0], [1, 0, 0], [0, 0, 1]]), 0),
    "upside down": turned(180, "x"),
    "in cm": (100 * np.eye(3), 0),
    "in mm": (1000 * np.eye(3), 0),
    "1.8 m up": (np.eye(3), [0, 0, 1.8]),
    "1.8 m down": (np.eye(3), [0, 0, -1.8]),
    "mirrored in y, 1.8 m up": (np.diag([1, -1, 1]), [0, 0, 1.8]),
    "2 m ahead": (np.eye(3), [2, 0, 0]),
    "turned by 8": turned(8),
    "other mount: 180, 1 m, 0.3 m up": turned(180, shift=(1, 0.2, 0.3)),
}


def altered(points, fault):
    A, t = FAULTS[fault]
    return points @ np.asarray(A, dtype=float).T + t


def again(points, seed=0):
    rng = np.random.default_rng(seed)
    points = points[rng.random(len(points)) < 0.5]
    return points + rng.normal(0, 0.05, points.shape)


def lumpi(folder):
    return [
        np.fromfile(path, "<f4").reshape(-1, 3).astype(float)
        for path in sorted(folder.iterdir())
    ]


def scan(path):
    return read_scan(path, None, {}).points


def twin(data):
    return [
        (scan(path), scan(data / "kitti_twin/sim" / path.name))
        for path in sorted((data / "kitti_twin/real").iterdir())
    ]


def rellis(data):
    lines = (data / "rellis/vel2os1.yaml").read_text().splitlines()
    w, x, y, z, *t = [float(line.split(":")[1]) for line in lines if line.split(":")[1].strip()]
    R = Rotation.from_quat([x, y, z, w]).as_matrix()
    return (
        scan(data / "rellis/000104.bin"),
        scan(data / "rellis/vel000104.bin"),
        np.column_stack([R, t]),
    )


def sequence(data, step):
    scans = [scan(path) for path in sorted((data / "kitti_sequence").glob("*.bin"))]
    return list(zip(scans, scans[step:], strict=False))


def streets(seed, n, sensor="vlp32c"):
    pairs = (make_pair(seed, i, SENSORS[sensor]) for i in range(n))
    return [
        (pair.real.rows[:, :3].astype(float), pair.sim.rows[:, :3].astype(float))
        for pair in pairs
    ]


def sources(data, is_choice):
    """Pairs with the motion that is set, by what they are."""
    os1, vlp, T = rellis(data)
    if is_choice:
        sweep = scan(data / "velodyne_vlp32c/one_sweep.pcd")
        carla = scan(data / "carla/000031.bin")
        return {
            "synth --seed 7": [(*pair, None) for pair in streets(7, 8)],
            "synth --seed 7 --sensor hdl64": [(*pair, None) for pair in streets(7, 4, "hdl64")],
            "VLP-32C, parked, measured again": [(sweep, again(sweep), None)],
            "carla 000031, measured again": [(carla, again(carla), None)],
            "kitti_sequence, every third against the next": [
                (*pair, None) for pair in sequence(data, 3)[::3]
            ],
        }
    nuscenes = scan(next((data / "nuscenes").glob("*.bin")))
    carla = scan(data / "carla/000030.bin")
    return {
        "kitti_twin (HDL-64E)": [(*pair, None) for pair in twin(data)],
        "rellis, OS1-64 against VLP-32C": [(os1, vlp, T), (vlp, os1, inverse(T))],
        "rellis VLP-32C, measured again": [(vlp, again(vlp), None)],
        "nuscenes (HDL-32E), measured again": [(nuscenes, again(nuscenes), None)],
        "carla, measured again": [(carla, again(carla), None)],
        "carla, two frames": [(carla, scan(data / "carla/000031.bin"), None)],
        "kitti_sequence, neighbours": [(*pair, None) for pair in sequence(data, 1)],
        "synth, 50 pairs": [(*pair, None) for pair in streets(0, 50)],
    }


LIFTS_M = (0.3, -0.3, 0.5, -0.5, 0.8, -1.2, 1.8, -1.8, 3.0, -3.0)
FLAWS = {
    "as they are": lambda points, rng: points,
    "30 % dropped": lambda points, rng: points[rng.random(len(points)) > 0.3],
    "60 % dropped beyond 25 m": lambda points, rng: points[
        (np.linalg.norm(points, axis=1) < 25) | (rng.random(len(points)) > 0.6)
    ],
    "range limited to 30 m": lambda points, rng: points[np.linalg.norm(points, axis=1) < 30],
    "range limited to 18 m": lambda points, rng: points[np.linalg.norm(points, axis=1) < 18],
    "every third, 10 cm noise": lambda points, rng: (
        points[::3] + rng.normal(0, 0.1, points[::3].shape)
    ),
}


def finite(points):
    return points[np.isfinite(points).all(axis=1) & points.any(axis=1)]


def places(data):
    """Lifts: error of the printed height, less the ground's own difference. Places: alarms, and pairs of two places."""
    settings = InputSettings()
    rng = np.random.default_rng(0)
    twins = twin(data)
    os1, vlp, T = rellis(data)
    errors = []
    in_feet = []
    for real, sim in [*twins, *streets(0, 8)[2::5]]:
        own = np.array(
            [
                _height(check_frames(real, sim + np.array([0, 0, lift]), settings)) + lift
                for lift in LIFTS_M
            ]
        )
        errors += [*(own - np.median(own))]
        in_feet.append(check_frames(real, sim * 3.28084, settings).reading == "in feet")
    print(
        f"lifts of {LIFTS_M} m: the printed heights differ by at most {1e3 * np.ptp(errors) / 2:.0f} mm per pair"
    )
    print(f"in feet: {sum(in_feet)} of {len(in_feet)} recognised")
    same = {
        name: [(real, flaw(sim, rng)) for real, sim in twins] for name, flaw in FLAWS.items()
    }
    same["rellis"] = [(finite(os1), finite(vlp) @ T[:, :3].T + T[:, 3])]
    same["kitti_sequence, neighbours"] = sequence(data, 1)
    same["synth"] = streets(0, 12)
    same["lumpi"] = [
        (real, sim) for real in lumpi(data / "lumpi/real") for sim in lumpi(data / "lumpi/sim")
    ]
    print("| one place | pairs | alarms | least best coverage |\n|---|---|---|---|")
    for name, pairs in same.items():
        found = [check_frames(finite(real), finite(sim), settings) for real, sim in pairs]
        n_alarms = sum(check.is_elsewhere or check.is_suspect for check in found)
        print(
            f"| {name} | {len(pairs)} | {n_alarms} | {min(check.coverage for check in found):.2f} |",
            flush=True,
        )
    scans = [
        twins[0][0],
        same["kitti_sequence, neighbours"][0][0],
        scan(next((data / "nuscenes").glob("*.bin"))),
        os1,
    ]
    scans += [
        scan(data / "carla/000030.bin"),
        scan(data / "velodyne_vlp32c/one_sweep.pcd"),
        same["synth"][3][0],
    ]
    scans = [*map(finite, scans), same["synth"][7][1]]
    found = [check_frames(a, b, settings) for a in scans for b in scans if a is not b]
    n_seen = sum(check.is_elsewhere for check in found)
    print(
        f"two places: {n_seen} of {len(found)} seen, largest best coverage {max(c.coverage for c in found):.2f}"
    )


def _height(check):
    """Height in the printed T_real_sim."""
    return float(check.setting.split('"')[1].split()[-1])


def inverse(T):
    return np.column_stack([T[:, :3].T, -T[:, :3].T @ T[:, 3]])


def main(data, is_choice):
    named = sources(data, is_choice)
    settings = InputSettings()
    seconds = []
    missed = []
    print("| fault | " + " | ".join(named) + " |")
    print("|---" * (len(named) + 1) + "|")
    for fault in ["none", *FAULTS]:
        cells = []
        for name, pairs in named.items():
            n = 0
            before = []
            after = []
            for real, sim, T in pairs:
                start = time.process_time()
                check = check_frames(
                    real, sim if fault == "none" else altered(sim, fault), settings, T
                )
                seconds.append(time.process_time() - start)
                if check is None:
                    missed.append((fault, name, check))
                    continue
                n += check.is_suspect
                before.append(check.as_it_lies)
                after.append(check.coverage)
                if check.is_suspect == (fault == "none"):
                    missed.append((fault, name, check))
            cells.append(f"{n} of {len(pairs)} ({np.mean(before):.2f}, {np.mean(after):.2f})")
        print(f"| {fault} | " + " | ".join(cells) + " |", flush=True)
    print("\nIn brackets: mean coverage as it lies, and of the best reading. Missed and false:")
    for fault, name, check in missed:
        print(f"- {fault}; {name}: {check}")
    print(
        f"\n{1e3 * np.median(seconds):.0f} ms of one core per pair (median), at most {1e3 * max(seconds):.0f}"
    )


if __name__ == "__main__":
    if "--places" in sys.argv:
        places(Path(sys.argv[1]))
    else:
        main(Path(sys.argv[1]), "--choose" in sys.argv)
