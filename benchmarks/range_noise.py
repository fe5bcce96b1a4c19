"""Lower and upper estimate of the range noise of scans with added noise, at full, half and third density in azimuth.

python benchmarks/range_noise.py ../shared/data
"""

import sys
from pathlib import Path

import numpy as np

from fidpipe.pipeline.datasets.readers import read_scan
from fidpipe.schemas.sensor_models import SENSORS
from fidpipe.stages.beam_patterns import find_beams
from fidpipe.stages.generate.street_scans import make_pair
from fidpipe.stages.sensor_description import _by_beam, describe_sensor

FILES = ("kitti_twin/sim/000000.bin", "kitti_twin/real/000000.bin", "kitti_sequence/000000.bin", "rellis/000104.bin")
STREETS = ("vlp32c", "os1-64", "xt32", "hdl64")
ADDED_M = (0.0, 0.02, 0.05)


def thinned(points, n):
    """Every n-th firing of each beam."""
    sweep = _by_beam(points, find_beams(points))
    column = np.round(sweep.azimuth_deg / describe_sensor(points).azimuth_step_deg).astype(int)
    return points[np.sort(sweep.row[column % n == 0])]


def noisy(points, noise_m, rng):
    range_m = np.linalg.norm(points, axis=1, keepdims=True)
    return points * (1 + rng.normal(0, noise_m, (len(points), 1)) / range_m)


def main(data):
    scans = {name: read_scan(data / name, None, {}).points for name in FILES}
    for sensor in STREETS:
        scans[f"synth, {sensor}"] = make_pair(0, 3, SENSORS[sensor]).sim.rows[:, :3].astype(float)
    rng = np.random.default_rng(0)
    print("| scan | added (mm) | full | half | third |\n|---|---|---|---|---|")
    for name, read in scans.items():
        points = read[np.isfinite(read).all(axis=1) & read.any(axis=1)]
        for added_m in ADDED_M:
            cells = []
            for n in (1, 2, 3):
                sensor = describe_sensor(thinned(noisy(points, added_m, rng), n))
                cells.append(f"{1e3 * sensor.range_noise_low_m:.0f} to {1e3 * sensor.range_noise_m:.0f}")
            print(f"| {name} | {1e3 * added_m:.0f} | {' | '.join(cells)} |", flush=True)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
