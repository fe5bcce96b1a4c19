"""Which sensors are recognised by their beams, and is one ever named that it is not?

    python benchmarks/sensors.py ../shared/data               # the tables of docs/sensors.md; about three minutes
    python benchmarks/sensors.py ../shared/data --choose      # the streets by which the limits were chosen

Recordings as they are. Streets of `fidpipe synth` scanned by each known sensor as its table has it, by units whose
beams stray from it, with noise and losses; then the same scans out of their sensor's frame, and sensors that are in no
table. A hit names the sensor, a miss names none, a false name is another's.
"""

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import sys
import time
from collections import defaultdict
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from fidpipe.pipeline.datasets.pairs import scans_of
from fidpipe.pipeline.datasets.readers import read_scan
from fidpipe.schemas.sensor_models import SENSORS
from fidpipe.stages.generate.street_scans import make_pair
from fidpipe.stages.sensor_description import beams_text, describe_sensor

# of the lower and the upper block above the origin of its recordings
HEIGHTS_M = {"hdl64": (0.12, 0.21)}
RECORDINGS = {
    "rellis/vel000104.bin": "Velodyne VLP-32C",
    "rellis/000104.bin": "Ouster OS1-64 (gen 1)",
    "nuscenes/*.pcd.bin": "Velodyne HDL-32E",
    "velodyne_vlp32c/one_sweep.pcd": "Velodyne VLP-32C",
    "velodyne_vlp32c/rosbag1.bag": "Velodyne VLP-32C",
    "velodyne_vlp32c/rosbag2_mcap": "Velodyne VLP-32C",
    "velodyne_vlp32c/rosbag2_sqlite3": "Velodyne VLP-32C",
    "velodyne_vlp32c/sweeps.pcap": "Velodyne VLP-32C",
    "registration/source.ply": "Velodyne HDL-32E",
    "registration/target.ply": "Velodyne HDL-32E",
    "kitti_sequence/*.bin": "Velodyne HDL-64E",
    "kitti_twin/real/*.bin": "every second beam of Velodyne HDL-64E",
    "kitti_twin/sim/*.bin": "every second beam of Velodyne HDL-64E",
    "carla/*.bin": None,
}
UNKNOWN = {
    "64 even, -24.8 to 2": np.linspace(2.0, -24.8, 64),
    "32 even, -25 to 15": np.linspace(15.0, -25.0, 32),
    "16 even, -15 to 16": np.linspace(16.0, -15.0, 16),
    "40 even, -25 to 15": np.linspace(15.0, -25.0, 40),
    "64 even, -16.5 to 16.5": np.linspace(16.5, -16.5, 64),
    "128 even, -22.5 to 22.5": np.linspace(22.5, -22.5, 128),
    "32 anyhow": np.sort(np.random.default_rng(3).uniform(-25, 15, 32))[::-1],
    "64 anyhow": np.sort(np.random.default_rng(4).uniform(-25, 5, 64))[::-1],
    "32, denser about the horizon": 20 * np.linspace(1.0, -1.0, 32) ** 3 - 2,
}


def unit(sensor, rng):
    """One unit of a sensor: where units differ, shifted by up to `unit_deg`, each beam by up to 0.05 in addition."""
    if not sensor.unit_deg:
        return sensor
    elevation = np.array(sensor.elevation_deg)
    most_deg = min(0.33, sensor.unit_deg)
    stray = rng.uniform(-most_deg, most_deg) + rng.normal(0, 0.15 * most_deg, len(elevation))
    return replace(sensor, elevation_deg=tuple(np.sort(elevation + stray)[::-1]))


def street(sensor, seed, index):
    """What the sensor reports of a street, in the frame of its recordings."""
    points = make_pair(seed, index, sensor).real.rows[:, :3].astype(float)
    if sensor.name in HEIGHTS_M:
        lower, upper = HEIGHTS_M[sensor.name]
        slope = np.degrees(np.arctan2(points[:, 2], np.hypot(points[:, 0], points[:, 1])))
        points[:, 2] += np.where(slope < -8.6, lower, upper)
    return points


def turned(degrees, axis):
    return lambda points, rng: (
        points @ Rotation.from_euler(axis, degrees, degrees=True).as_matrix().T
    )


def crossing(focal_m):
    """Beams that cross so far before the axis, as those of drivers that leave the focal distance in."""

    def change(points, rng):
        level = np.hypot(points[:, 0], points[:, 1])
        return points * np.column_stack(
            [1 + focal_m / level, 1 + focal_m / level, np.ones(len(level))]
        )

    return change


def lost(share):
    return lambda points, rng: points[rng.random(len(points)) >= share]


def without_outer_beams(points, rng):
    elevation = np.round(
        np.degrees(np.arctan2(points[:, 2], np.hypot(points[:, 0], points[:, 1]))), 1
    )
    common, count = np.unique(elevation, return_counts=True)
    common = common[count > 0.001 * len(points)]
    return points[(elevation > common[0] + 0.15) & (elevation < common[-1] - 0.15)]


def noisy(sigma_m):
    def change(points, rng):
        range_m = np.linalg.norm(points, axis=1, keepdims=True)
        return points * (1 + rng.normal(0, sigma_m, range_m.shape) / range_m)

    return change


HARMLESS = {
    "as it is": lambda points, rng: points,
    "without the highest and the lowest beam": without_outer_beams,
    "10 cm noise along the ray": noisy(0.1),
    "40 % lost": lost(0.4),
    "80 % lost": lost(0.8),
    "turned by 37 about z": turned(37, "z"),
    "x and y exchanged": lambda points, rng: points[:, [1, 0, 2]],
    "one half of the sweep": lambda points, rng: points[points[:, 1] <= 0],
    "rows in another order": lambda points, rng: rng.permutation(points),
    "rounded to 1 mm": lambda points, rng: np.round(points, 3),
}
OUT_OF_FRAME = {
    "tilted by 1": turned(1, "y"),
    "tilted by 5": turned(5, "y"),
    "y and z exchanged": lambda points, rng: points[:, [0, 2, 1]],
    "upside down": turned(180, "x"),
    "1.7 m up": lambda points, rng: points + np.array([0, 0, 1.7]),
    "1 m ahead": lambda points, rng: points + np.array([1, 0, 0]),
    "2 cm noise of each coordinate": lambda points, rng: (
        points + rng.normal(0, 0.02, points.shape)
    ),
}


def told(points, counts, key, truth):
    """Counts what is said of a scan, and returns it."""
    facts = describe_sensor(points)
    count(facts, counts[key], truth)
    return facts


def count(facts, counts, truth):
    """Counts whether a sensor has been recognised, and its beams."""
    if facts.model == truth:
        counts["hit"] += 1
    elif facts.model is None:
        counts["miss"] += 1
    else:
        counts["false name"] += 1
    counts["told"] += bool(facts.elevation_deg)


def no_counts():
    return defaultdict(lambda: defaultdict(int))


def show(title, counts):
    print(
        f"\n| {title} | scans | hits | misses | false names | beams told |\n|---|---|---|---|---|---|"
    )
    for key, row in counts.items():
        total = row["hit"] + row["miss"] + row["false name"]
        print(
            f"| {key} | {total} | {row['hit']} | {row['miss']} | {row['false name']} | {row['told']} |"
        )


def scans(data, pattern):
    for path in sorted(data.glob(pattern)):
        yield from scans_of(path)


def recordings(data):
    print(
        "| recording | points | beams | step (deg) | quantum (mm) | noise (mm) | lost (%) | seconds |"
    )
    print("|---|---|---|---|---|---|---|---|")
    counts = no_counts()
    for pattern, truth in RECORDINGS.items():
        for path in scans(data, pattern):
            scan = read_scan(path)
            start = time.perf_counter()
            facts = describe_sensor(scan.points, scan.rings)
            seconds = time.perf_counter() - start
            count(facts, counts[pattern], truth)
            share = "-" if facts.lost_share is None else f"{100 * facts.lost_share:.0f}"
            quantum = (
                "-" if facts.range_quantum_m is None else f"{1e3 * facts.range_quantum_m:g}"
            )
            noise = "-" if facts.range_noise_m is None else f"{1e3 * facts.range_noise_m:.0f}"
            name = path.relative_to(data)
            step = "-" if facts.azimuth_step_deg is None else f"{facts.azimuth_step_deg:.3f}"
            print(
                f"| {name} | {facts.n_points} | {beams_text(facts)} | {step} | {quantum} | {noise} | {share} "
                f"| {seconds:.2f} |"
            )
    show("recording", counts)


def main(data, seed):
    recordings(data)
    rng = np.random.default_rng(seed)
    by_sensor, harmless, out_of_frame, unknown = (
        no_counts(),
        no_counts(),
        no_counts(),
        no_counts(),
    )
    measured = defaultdict(list)
    for model in SENSORS.values():
        for index in range(3):
            points = street(unit(model, rng), seed, index)
            for change, function in HARMLESS.items():
                facts = told(function(points, rng), harmless, change, model.title)
                if change == "as it is":
                    told(points, by_sensor, model.title, model.title)
                    measured[model.title].append(facts)
            if model.focal_m:
                told(
                    crossing(model.focal_m)(points, rng),
                    harmless,
                    "beams cross before the axis",
                    model.title,
                )
            else:
                told(
                    crossing(0.0424)(points, rng),
                    out_of_frame,
                    "beams cross 42.4 mm before the axis",
                    model.title,
                )
            for change, function in OUT_OF_FRAME.items():
                told(function(points, rng), out_of_frame, change, model.title)
    for name, elevation in UNKNOWN.items():
        sensor = replace(
            SENSORS["hdl64"],
            name=name,
            elevation_deg=tuple(elevation),
            azimuth_offset_deg=(0.0,) * len(elevation),
        )
        for index in range(3):
            told(street(sensor, seed, index), unknown, name, None)
            told(
                crossing(0.0424)(street(sensor, seed, index), rng),
                unknown,
                "the same, 42.4 mm before the axis",
                None,
            )
    cloud = rng.uniform((-40, -40, -2), (40, 40, 8), (60_000, 3))
    told(cloud, unknown, "points anywhere in a box", None)
    told(
        np.concatenate([street(SENSORS[name], seed, 0) for name in ("vlp16", "hdl32")]),
        unknown,
        "two sensors merged",
        None,
    )
    show("known sensor, a street", by_sensor)
    show("change that leaves the sensor's frame", harmless)
    show("change out of the sensor's frame", out_of_frame)
    show("not in the table (a hit names none)", unknown)
    print(
        "\n| known sensor | quantum told (mm) | true | noise told (mm) | true |\n|---|---|---|---|---|"
    )
    for model in SENSORS.values():
        own = measured[model.title]
        quanta = " ".join(f"{1e3 * (facts.range_quantum_m or 0):g}" for facts in own)
        noise = " ".join(
            "-" if facts.range_noise_m is None else f"{1e3 * facts.range_noise_m:.0f}"
            for facts in own
        )
        true = f"{1e3 * model.range_quantum_m:g}", f"{1e3 * model.range_noise_m:g}"
        print(f"| {model.title} | {quanta} | {true[0]} | {noise} | {true[1]} |")


if __name__ == "__main__":
    main(Path(sys.argv[1]), 7 if "--choose" in sys.argv else 11)
