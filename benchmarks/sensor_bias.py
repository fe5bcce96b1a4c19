"""Range noise, beams, azimuth step and loss of scans in which they are known, at full, half and third density.

python benchmarks/sensor_bias.py ../shared/data
"""

import sys
from pathlib import Path

import numpy as np

from fidpipe.pipeline.datasets.readers import read_scan
from fidpipe.schemas.sensor_models import SENSORS
from fidpipe.stages.beam_patterns import find_beams
from fidpipe.stages.generate.street_scans import make_pair
from fidpipe.stages.sensor_description import describe_sensor
from fidpipe.stages.sweep import sweep_of

FILES = (
    "kitti_twin/sim/000000.bin",
    "kitti_twin/real/000000.bin",
    "kitti_sequence/000000.bin",
    "rellis/000104.bin",
)
STREETS = ("vlp32c", "os1-64", "xt32", "hdl64")
ADDED_M = (0.0, 0.02, 0.05)


def thinned(points, n):
    """Every n-th firing of each beam."""
    sweep = sweep_of(points, find_beams(points))
    column = np.round(sweep.azimuth_deg / describe_sensor(points).azimuth_step_deg).astype(int)
    return points[np.sort(sweep.row[column % n == 0])]


def noisy(points, noise_m, rng):
    range_m = np.linalg.norm(points, axis=1, keepdims=True)
    return points * (1 + rng.normal(0, noise_m, (len(points), 1)) / range_m)


def noise_table(scans, rng):
    """Lower and upper estimate of the range noise of scans with added noise."""
    print("| scan | added (mm) | full | half | third |\n|---|---|---|---|---|")
    for name, points in scans.items():
        for added_m in ADDED_M:
            cells = []
            for n in (1, 2, 3):
                sensor = describe_sensor(thinned(noisy(points, added_m, rng), n))
                cells.append(
                    f"{1e3 * sensor.range_noise_low_m:.0f} to {1e3 * sensor.range_noise_m:.0f}"
                )
            print(f"| {name} | {1e3 * added_m:.0f} | {' | '.join(cells)} |", flush=True)


def properties_table(scans, rng):
    """Number of beams, azimuth step over the true one, and lost share, without beams and returns that were removed."""
    print("| scan | beams removed | lost | full | half | third |\n|---|---|---|---|---|---|")
    for name, points in scans.items():
        whole = describe_sensor(points)
        beam, _ = find_beams(points).beam_of(points)
        for n_removed, lost in ((0, 0.0), (0, 0.1), (0, 0.3), (6, 0.0), (6, 0.1)):
            removed = rng.permutation(np.arange(4, beam.max() - 4))[:n_removed]
            kept = points[~np.isin(beam, removed)]
            cells = []
            for n in (1, 2, 3):
                sparse = thinned(kept, n)
                sensor = describe_sensor(sparse[rng.random(len(sparse)) >= lost])
                share = 1 - (1 - sensor.lost_share) / (1 - whole.lost_share)
                step = sensor.azimuth_step_deg / (n * whole.azimuth_step_deg)
                cells.append(
                    f"{len(sensor.elevation_deg) - len(whole.elevation_deg):+d}, {step:.3f}, {share:.0%}"
                )
            print(f"| {name} | {n_removed} | {lost:.0%} | {' | '.join(cells)} |", flush=True)


def main(data):
    scans = {name: read_scan(data / name, None, {}).points for name in FILES}
    for sensor in STREETS:
        scans[f"synth, {sensor}"] = (
            make_pair(0, 3, SENSORS[sensor]).sim.rows[:, :3].astype(float)
        )
    scans = {
        name: points[np.isfinite(points).all(axis=1) & points.any(axis=1)]
        for name, points in scans.items()
    }
    rng = np.random.default_rng(0)
    noise_table(scans, rng)
    properties_table(scans, rng)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
