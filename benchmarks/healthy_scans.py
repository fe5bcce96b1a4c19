"""Is a cause named where there is none?

    python benchmarks/healthy_scans.py ../shared/data --cases 5

Real scans of every recorded sensor whose beams are known, against themselves re-measured with 1 to 3 cm of range noise
and 1 to 4 % lost: by the same rays, and by the rays next to them, which are other columns of the full scan. Five pairs
per case, evaluated as by `fidpipe run` and `fidpipe diagnose`. Prints the share of cases in which no cause is named and
nothing is unexplained.
"""

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("OMP_NUM_THREADS", "1")

import argparse
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import flawed_scans as fs
import numpy as np
from diagnosis import diagnose, estimated, remeasured, side_of
from flawed_scans import random

from fidpipe.pipeline.datasets import pairs
from fidpipe.pipeline.datasets.readers import read_scan
from fidpipe.stages.causes.sides import PairScans
from fidpipe.stages.sensor_description import describe_sensor

N_PAIRS = 5
MOST_POINTS = 20_000
RECORDINGS = {
    "HDL-64E": "kitti_sequence/*.bin",
    "HDL-64E, every second beam": "kitti_twin/real/*.bin",
    "VLP-32C off-road": "rellis/vel000104.bin",
    "OS1-64 off-road": "rellis/000104.bin",
    "VLP-32C parked": "velodyne_vlp32c/sweeps.pcap",
    "HDL-32E": "registration/*.ply",
}


@dataclass(frozen=True)
class Case:
    sensor: str
    ray: str
    number: int


def scans_of(folder, pattern):
    """The points of five scans at most whose beams are recognised, metres."""
    scans = []
    for path in sorted(folder.glob(pattern))[:N_PAIRS]:
        for frame in pairs.scans_of(path)[:N_PAIRS]:
            points = np.asarray(read_scan(frame).points, dtype=float)
            is_return = np.isfinite(points).all(axis=1) & points.any(axis=1)
            if describe_sensor(points[is_return]).elevation_deg:
                scans.append(points[is_return])
    return scans


def columns_of(points):
    """Number of the firing of each return within its beam."""
    sensor = describe_sensor(points)
    beam = sensor.beam_of(points)
    azimuth_deg = np.degrees(np.arctan2(points[:, 1], points[:, 0]))
    order = np.lexsort((azimuth_deg, beam))
    step_deg = sensor.azimuth_step_deg
    if step_deg is None:
        firings = np.ones(len(points) - 1, dtype=int)
    else:
        firings = np.round(np.diff(azimuth_deg[order]) / step_deg).astype(int)
    columns = np.empty(len(points), dtype=int)
    columns[order] = np.concatenate([[0], np.cumsum(firings)])
    return columns


def healthy_pair(points, ray, rng):
    columns = columns_of(points)
    every = max(2, len(points) // MOST_POINTS)
    first = points[columns % every == 0]
    second = first if ray == "same" else points[columns % every == 1]
    scan = fs.Scan(second, second[:1], second[:1, :2])
    again = remeasured(scan, rng, rng.uniform(0.01, 0.03), rng.uniform(0.01, 0.04))
    return PairScans(side_of(first), side_of(again))


def evaluate(case):
    """Names of the causes of a case; `unexplained` for a distance that none explains."""
    scans = SCANS[case.sensor]
    pairs = []
    for i in range(N_PAIRS):
        rng = random(case.sensor, case.ray, case.number, i)
        pairs.append(estimated(healthy_pair(scans[i % len(scans)], case.ray, rng)))
    return [(name, round(amount, 3)) for name, amount, _, _ in diagnose(pairs)]


SCANS = {}


if __name__ == "__main__":
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("data", type=Path, help="folder of the recordings")
    parser.add_argument("--cases", type=int, default=5, help="per sensor and kind of rays")
    parser.add_argument("--jobs", type=int, default=os.cpu_count())
    parser.add_argument("--sensors", nargs="+", choices=RECORDINGS, default=list(RECORDINGS))
    arguments = parser.parse_args()
    for sensor in arguments.sensors:
        SCANS[sensor] = scans_of(arguments.data, RECORDINGS[sensor])
    cases = []
    for number in range(arguments.cases):
        for sensor in SCANS:
            cases += [Case(sensor, ray, number) for ray in ("same", "other")]
    n_clean = 0
    with ProcessPoolExecutor(arguments.jobs) as pool:
        for case, causes in zip(cases, pool.map(evaluate, cases), strict=True):
            n_clean += not causes
            print(
                case.sensor,
                f"{case.ray} rays",
                case.number,
                causes or "-",
                sep=" | ",
                flush=True,
            )
    print(
        f"no cause and nothing unexplained: {n_clean} of {len(cases)}, {n_clean / len(cases):.1%}"
    )
