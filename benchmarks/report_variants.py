"""Are faults of recordings named, and is nothing else prescribed, on scans of other sensors and in other amounts?

    python benchmarks/report_variants.py ../shared/data          # or with a part of the names of variants

Variants of the kinds of input in `../shared/data/reports`. Each real scan is compared with itself re-measured (2 cm
noise, 3 % loss), of which the simulated or both sides have the fault, so that every cause besides those of the fault is
a wrong prescription. Prints errors and warnings of `fidpipe check`, and causes, of each.
"""

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("OMP_NUM_THREADS", "1")

import re
import sys
import tempfile
from collections import Counter
from dataclasses import dataclass
from itertools import permutations, product
from pathlib import Path

import numpy as np
from flawed_scans import along_ray, random, ranges
from scipy.spatial.transform import Rotation

from fidpipe.pipeline.datasets.pairs import scans_of
from fidpipe.pipeline.datasets.readers import read_scan
from fidpipe.pipeline.inspect.scan_checks import check_dataset
from fidpipe.schemas.settings import load
from fidpipe.stages.sensor_description import describe_sensor

NOISE_M, LOSS = 0.02, 0.03
MIN_RANGE_M = 2.5  # nearer first returns are dropped, and their second ones would be left
DATA = Path(sys.argv[1])
UNITS = "units of|in feet"
ANGLES = "angles and ranges|not in the sensor's frame|do not show the same place"
SCANS = {
    "HDL-64E": "kitti_sequence/000004.bin",
    "HDL-64E thinned": "kitti_twin/real/000002.bin",
    "OS1-64": "rellis/000104.bin",
    "VLP-32C": "velodyne_vlp32c/sweeps.pcap",
    "HDL-32E": "registration/*.ply",
}


@dataclass
class Variant:
    """Fault of one or both sides.

    named : regular expression that an error or warning must have; "" if none is needed
    allowed : causes that are right
    scans : names of the scans to which it is applied; all by default
    fault : function of points, (n, 3), and a generator that returns points; of the simulated side
    real_fault : the same of the real side, None for none
    """

    named: str
    fault: object
    real_fault: object = None
    allowed: tuple = ()
    scans: tuple = ()


def remeasured(points, rng):
    kept = points[rng.random(len(points)) >= LOSS]
    return along_ray(kept, ranges(kept) + rng.normal(0, NOISE_M, len(kept)))


def misses(range_m, share, jitter_m=0.0):
    """Further rays, of random directions of the scan, without a return: written at one range, or around it."""

    def write(points, rng):
        n = int(share / (1 - share) * len(points))
        rows = rng.choice(len(points), n)
        rays = points[rows] + rng.normal(0, 0.3, (n, 3))
        near = points[ranges(points) < range_m - 1]
        return np.concatenate([near, along_ray(rays, rng.normal(range_m, jitter_m, n))])

    return write


def far_misses(range_m, share):
    """Further rays without a return beyond all others."""
    return lambda points, rng: np.concatenate(
        [points, misses(range_m, share)(points, rng)[-int(share * len(points)) :]]
    )


def lossy(share):
    """No fault: a share of the returns is lost at random."""
    return lambda points, rng: points[rng.random(len(points)) >= share]


def sweeps(n_sweeps):
    """Sweeps of a parked sensor in one scan, with random phases."""

    def accumulate(points, rng):
        turns = [
            Rotation.from_euler("z", rng.uniform(0, 0.4), degrees=True).as_matrix()
            for _ in range(n_sweeps)
        ]
        return np.concatenate([remeasured(points @ turn.T, rng) for turn in turns])

    return accumulate


def with_next_sweep(points, rng):
    """The next frames of `kitti_sequence`, 10 Hz at 8 m/s, in one scan without their poses."""
    return np.concatenate([points, points_of(DATA / "kitti_sequence/000005.bin")])


def each_twice(apart_m):
    """Second returns, at the same place or behind the first."""

    def repeat(points, rng):
        behind = along_ray(
            points, ranges(points) + rng.exponential(apart_m, len(points)) + 1e-4
        )
        return np.concatenate([points, behind[ranges(points) > MIN_RANGE_M]])

    return repeat


def interleaved(share):
    """Second returns of some rays, each in the row after the first."""

    def repeat(points, rng):
        behind = along_ray(points, ranges(points) + rng.uniform(0.5, 3.0, len(points)))
        behind[(rng.random(len(points)) >= share) | (ranges(points) < MIN_RANGE_M)] = np.nan
        rows = np.stack([points, behind], axis=1).reshape(-1, 3)
        return rows[np.isfinite(rows).all(axis=1)]

    return repeat


def gridded(voxel_m):
    """The first point of each voxel."""

    def thin(points, rng):
        _, first = np.unique(np.floor(points / voxel_m), axis=0, return_index=True)
        return points[np.sort(first)]

    return thin


def after(*faults):
    """Several faults, one after the other."""

    def change(points, rng):
        for fault in faults:
            points = fault(points, rng)
        return points

    return change


def moved(x, y, z=0.0, turned_deg=0.0):
    matrix = Rotation.from_euler("z", turned_deg, degrees=True).as_matrix()
    return lambda points, rng: points @ matrix.T + [x, y, z]


def axes(order, signs):
    return lambda points, rng: points[:, order] * np.array(signs)


def scaled(factor):
    return lambda points, rng: factor * points


def not_rings(points, rng):
    """The same surface in directions of no pattern: pairs of near points, anywhere between both."""
    from scipy.spatial import cKDTree

    _, rows = cKDTree(points).query(points, k=6)
    partner = rows[np.arange(len(points)), rng.integers(1, 6, len(points))]
    is_near = ranges(points[partner] - points) < 0.05 * ranges(points)
    part = rng.random((len(points), 1))
    return (points + part * (points[partner] - points))[is_near]


def as_angles(unit, from_zenith=False):
    def convert(points, rng):
        azimuth = np.arctan2(points[:, 1], points[:, 0]) % (2 * np.pi)
        elevation = np.arcsin(points[:, 2] / ranges(points))
        if from_zenith:
            elevation = np.pi / 2 - elevation
        if unit == "deg":
            azimuth, elevation = np.degrees(azimuth), np.degrees(elevation)
        return np.column_stack([azimuth, elevation, ranges(points)])

    return convert


def gaps(n_gaps, width_deg):
    def cut(points, rng):
        azimuth_deg = np.degrees(np.arctan2(points[:, 1], points[:, 0])) % (360 / n_gaps)
        return points[azimuth_deg > width_deg]

    return cut


def repeated(place, share):
    def add(points, rng):
        n = int(share / (1 - share) * len(points))
        return np.concatenate([points, np.tile(place, (n, 1))])

    return add


def variants():
    found = {
        "misses at 120 m, 15 %": Variant(
            "rays without a return", misses(120, 0.15), allowed=("maximum range",)
        ),
        "misses at 60 m, 40 %": Variant(
            "rays without a return", misses(60, 0.4), allowed=("maximum range",)
        ),
        "misses at 200 m, 5 %": Variant("rays without a return", misses(200, 0.05)),
        "two sweeps, parked": Variant("two or more", sweeps(2)),
        "three sweeps, parked": Variant("two or more", sweeps(3)),
        "two sweeps, 8 m/s": Variant("two or more", with_next_sweep, scans=("HDL-64E",)),
        "each return twice": Variant("second returns", each_twice(0.0)),
        "second returns 1 m behind": Variant(
            "second returns", each_twice(1.0), allowed=("second returns",)
        ),
        "both in the world, 200 m off": Variant(
            "not in the sensor's frame", moved(200, 120, 3, 30), moved(200, 120, 3, 30)
        ),
        "both in the world, 25 m off": Variant(
            "not in the sensor's frame", moved(-25, 10), moved(-25, 10)
        ),
        "simulated in the world, 60 m off": Variant("frame", moved(60, -40, 0, 45)),
        "simulated size 0.5": Variant(UNITS, scaled(0.5)),
        "simulated size 0.9": Variant("", scaled(0.9), allowed=("range scale",)),
        "simulated size 1.12": Variant("", scaled(1.12), allowed=("range scale",)),
        "simulated size 0.8": Variant(UNITS, scaled(0.8)),
        "simulated size 1.3": Variant(UNITS, scaled(1.3)),
        "simulated size 3.28": Variant(UNITS, scaled(3.28)),
        "points without rings": Variant(
            "", not_rings, allowed=("maximum range", "elevation noise")
        ),
        "degrees and range as x y z": Variant(ANGLES, as_angles("deg")),
        "radians and range as x y z": Variant(ANGLES, as_angles("rad")),
        "gaps of 4 deg in 10 directions, both": Variant(
            "", gaps(10, 4), gaps(10, 4), ("blind sector",)
        ),
        "gaps of 4 deg in 10 directions, simulated": Variant(
            "", gaps(10, 4), allowed=("blind sector",)
        ),
        "gaps of 8 deg in 5 directions, simulated": Variant(
            "", gaps(5, 8), allowed=("blind sector",)
        ),
        "one point repeated, 30 %": Variant("one repeated point", repeated([1.2, 0, 1.8], 0.3)),
        "misses around 80 m, 25 %": Variant("rays without", misses(80, 0.25, 0.3)),
        "misses at 60 and 120 m": Variant(
            "rays without",
            after(misses(60, 0.15), far_misses(120, 0.15)),
            allowed=("maximum range",),
        ),
        "second returns interleaved, 30 %": Variant(
            "second returns", interleaved(0.3), allowed=("second returns",)
        ),
        "voxel grid of 0.1 m": Variant("voxel grid", gridded(0.1)),
        "voxel grid of 0.2 m": Variant("voxel grid|not in the sensor's frame", gridded(0.2)),
        "simulated in inches": Variant("in inches", scaled(39.37)),
        "simulated in decimetres": Variant("in decimetres", scaled(10.0)),
        "zenith angle, range as x y z": Variant(ANGLES, as_angles("rad", from_zenith=True)),
        "y up, left-handed, turned by 90 deg": Variant(
            "frame|read as", after(moved(0, 0, 0, 90), axes([1, 2, 0], (-1, 1, 1)))
        ),
        "simulated turned by 45 deg": Variant(
            "the same place|frame", moved(0, 0, 0, 45), allowed=("yaw",)
        ),
        "both 1.5 m above base_link": Variant("", moved(0, 0, 1.5), moved(0, 0, 1.5)),
        "gaps of 2 deg in 20 directions, simulated": Variant(
            "", gaps(20, 2), allowed=("blind sector",)
        ),
        "one point repeated, 10 %": Variant(
            "one repeated point", repeated([-0.4, 0, 2.1], 0.1)
        ),
    }
    found |= {
        "two even sweeps, sorted": Variant("finer sensor", even_sweeps(2, "azimuth")),
        "two even sweeps, shuffled": Variant("finer sensor", even_sweeps(2, "random")),
        "three even sweeps, shuffled": Variant("finer sensor", even_sweeps(3, "random")),
        "without road": Variant("", without_road, allowed=("missing parts",)),
        "second returns in other beams, 30 %": Variant("", in_other_beams(0.3)),
        "rounded to 1 cm": Variant("rounded", rounded(0.01)),
        "rounded to 10 cm": Variant("rounded", rounded(0.1)),
        "float32 of projected coordinates": Variant("rounded", projected),
        "simulated cropped to a box": Variant("", cropped(40, 40)),
        "real cropped to a box": Variant("", unchanged, cropped(40, 40)),
        "real of 90 degrees": Variant("", unchanged, ahead(90)),
        "simulated of 90 degrees": Variant("", ahead(90), allowed=("blind sector",)),
        "pitched by 3 degrees": Variant("", pitched(3), allowed=("pitch",)),
    }
    for number in range(12):
        share = (0.0, 0.1, 0.3, 0.5)[number % 4]
        allowed = ("lost returns",) if share else ()
        found[f"healthy {number}, {share:.0%} lost"] = Variant(
            "", lossy(share), allowed=allowed
        )
    orders = [(o, s) for o in permutations(range(3)) for s in product((1, -1), repeat=3)]
    for number in (5, 13, 22, 29, 38, 46):
        order, signs = orders[number]
        found[f"axes {order} {signs}"] = Variant("frame|read as", axes(order, signs))
    return found


def even_sweeps(n_sweeps, order):
    """Sweeps of a parked sensor whose azimuths lie evenly between each other, in rows that tell nothing."""

    def accumulate(points, rng):
        step_deg = describe_sensor(points).azimuth_step_deg or 0.2
        turns = [moved(0, 0, 0, step_deg * k / n_sweeps) for k in range(n_sweeps)]
        sweeps = np.concatenate([remeasured(turn(points, rng), rng) for turn in turns])
        if order == "random":
            return rng.permutation(sweeps)
        return sweeps[np.argsort(np.arctan2(sweeps[:, 1], sweeps[:, 0]))]

    return accumulate


def without_road(points, rng):
    heights = np.histogram(points[ranges(points) < 25, 2], bins=np.arange(-3, 2, 0.1))
    return points[points[:, 2] > heights[1][heights[0].argmax()] + 0.3]


def in_other_beams(share):
    """Second returns of some rays, half a degree higher than the first."""

    def repeat(points, rng):
        second = points[(rng.random(len(points)) < share) & (ranges(points) > MIN_RANGE_M)]
        second = along_ray(second, ranges(second) + rng.uniform(0.5, 3.0, len(second)))
        second[:, 2] += np.radians(0.45) * ranges(second)
        return np.concatenate([points, second])

    return repeat


def rounded(step_m):
    return lambda points, rng: step_m * np.round(points / step_m)


def projected(points, rng):
    """As in a float32 file of projected coordinates."""
    origin = np.array([448262.0, 5411932.0, 115.0])
    return (points + origin).astype(np.float32) - origin


def cropped(x, y):
    return lambda points, rng: points[(np.abs(points[:, :2]) < [x, y]).all(axis=1)]


def ahead(width_deg):
    return lambda points, rng: points[
        np.abs(np.degrees(np.arctan2(points[:, 1], points[:, 0]))) < width_deg / 2
    ]


def pitched(angle_deg):
    matrix = Rotation.from_euler("y", angle_deg, degrees=True).as_matrix()
    return lambda points, rng: points @ matrix.T


def unchanged(points, rng):
    return points


def points_of(path):
    points = np.asarray(read_scan(scans_of(path)[0]).points, dtype=float)
    return points[np.isfinite(points).all(axis=1) & points.any(axis=1)]


def check(folder, points, variant, rng, settings):
    """Warnings, reasons of unknown causes, and named causes of a scan and itself re-measured with a fault."""
    sim = variant.fault(remeasured(points, rng), rng)
    real = points if variant.real_fault is None else variant.real_fault(points, rng)
    np.save(folder / "real.npy", real)
    np.save(folder / "sim.npy", sim)
    (folder / "pairs.csv").write_text("pair_id,real,sim\n0,real.npy,sim.npy\n")
    checked = check_dataset(folder, settings)
    texts = [*checked.doubts, *checked.faults, *checked.warnings]
    reasons = [unknown.reason for unknown in checked.unknown]
    return (
        texts,
        reasons,
        [cause.words for cause in checked.causes],
        [cause.name for cause in checked.causes],
    )


def main(only=""):
    settings = load(None, [], preset="reference")
    number = Counter()
    print("| variant | scan | named | right causes | wrong causes |\n|---|---|---|---|---|")
    for name, variant in variants().items():
        if only not in name:
            continue
        for scan, pattern in SCANS.items():
            if variant.scans and scan not in variant.scans:
                continue
            points = points_of(sorted(DATA.glob(pattern))[0])
            with tempfile.TemporaryDirectory() as folder:
                texts, reasons, words, names = check(
                    Path(folder), points, variant, random(name, scan), settings
                )
            is_named = not variant.named or any(
                re.search(variant.named, text) for text in [*texts, *reasons]
            )
            right = [w for w, n in zip(words, names, strict=True) if n in variant.allowed]
            wrong = [w for w, n in zip(words, names, strict=True) if n not in variant.allowed]
            number["all"] += 1
            number["named"] += is_named
            number["wrong"] += bool(wrong)
            number["warnings of healthy scans"] += "healthy" in name and bool(texts)
            print(
                f"| {name} | {scan} | {is_named} | {'; '.join(right)} | {'; '.join(wrong)} |",
                flush=True,
            )
            if not is_named or only:
                print("    ", texts, reasons, flush=True)
    print(dict(number))


if __name__ == "__main__":
    main(*sys.argv[2:])
