"""Boxes instead of shapes: can they be named by how flat simulated objects are where real ones are curved?

    fidpipe twin ../shared/data/kitti_sequence .cache/twins
    python benchmarks/boxes.py ../shared/data/kitti_twin .cache/twins --every-pair 2

The flaw replaces cars by the faces of their bounding boxes that the sensor sees. Measured is the share of curved real
surface (within 25 m, up to 2.5 m above the road, no foliage) at which the simulated surface is less than half as thick,
its change against the same base without the flaw, for boxes (power), for healthy re-measurements and for all other
flaws of `diagnosis.py` in their middle amount (false alarms). The limit was set on `kitti_twin`.
"""

import argparse
from pathlib import Path

import numpy as np
from diagnosis import FLAWS, altered, is_possible, random, read, read_scenes, remeasured
from diagnosis import SCENES as scenes_by_folder
from flawed_scans import Scan, is_ground, road_height
from scipy import stats
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from fidpipe.stages.displacement import fit_displacement
from fidpipe.stages.surfels import fit_planes

LIMIT, N_HEALTHY = 0.02, 5
RANGE_M, TOP_M = 25.0, 2.5
LENGTH_M, WIDTH_M, HEIGHT_M = (2.5, 5.5), (0.8, 2.5), (1.1, 2.3)


def smallest_rectangle(level):
    """Turn into the axes of the smallest upright box around points, its lower and its upper corner."""
    boxes = []
    for angle in np.radians(np.arange(0, 90, 2)):
        turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
        low, high = (level @ turn.T).min(axis=0), (level @ turn.T).max(axis=0)
        boxes.append((np.prod(high - low), turn, low, high))
    return min(boxes, key=lambda box: box[0])[1:]


def find_cars(points):
    """Points and box of each car-sized cluster within 25 m."""
    road_m = road_height(points)
    height_m = points[:, 2] - road_m
    is_near = (height_m > -0.5) & (height_m < TOP_M) & (np.hypot(*points.T[:2]) < RANGE_M)
    near = points[~is_ground(points) & is_near]
    links = cKDTree(near).query_pairs(0.35, output_type="ndarray")
    graph = coo_matrix((np.ones(len(links)), links.T), shape=(len(near), len(near)))
    _, cluster = connected_components(graph, directed=False)
    for one in np.flatnonzero(np.bincount(cluster) >= 100):
        own = near[cluster == one]
        turn, low, high = smallest_rectangle(own[:, :2])
        sizes = (*np.sort(high - low)[::-1], own[:, 2].max() - road_m)
        limits = (LENGTH_M, WIDTH_M, HEIGHT_M)
        if all(least <= size <= most for size, (least, most) in zip(sizes, limits, strict=True)):
            yield own, turn, np.array([*low, road_m + 0.2]), np.array([*high, own[:, 2].max()])


def boxed(points, cars):
    """Returns of cars lie on the box where their ray enters it."""
    points, is_road = points.copy(), is_ground(points)
    for own, turn, low, high in cars:
        rows = np.flatnonzero(~is_road & (cKDTree(own).query(points)[0] < 0.4))
        turned = np.column_stack([points[rows, :2] @ turn.T, points[rows, 2]])
        turned[turned == 0] = 1e-9
        sides = np.sort([low / turned, high / turned], axis=0)
        enter, leave = sides[0].max(axis=1), sides[1].min(axis=1)
        is_hit = (enter < leave) & (enter > 0)
        points[rows[is_hit]] *= enter[is_hit, None]
    return points


def flat_share(real, is_road, sim):
    """Share of curved real surface at which the simulated surface is less than half as thick."""
    found = fit_displacement(real, sim, is_road)
    sim = found.undo(sim, is_ground(sim)) if found else sim
    is_low = (real[:, 2] - np.median(real[is_road, 2]) < TOP_M) & (np.hypot(*real.T[:2]) < RANGE_M)
    places = real[~is_road & is_low]
    a, b = (fit_planes(points, places, 24, 0.6) for points in (real, sim))
    thick_a, thick_b = (np.sqrt(own.variance[:, 0]) for own in (a, b))
    is_known = (a.n_neighbours >= 10) & (b.n_neighbours >= 10)
    is_broad = a.variance[:, 1] > 0.05 * a.variance[:, 2]
    is_curved = is_known & is_broad & (thick_a > 0.03) & (a.scattering < 0.15)
    return (thick_b[is_curved] < 0.5 * thick_a[is_curved]).mean()


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("datasets", type=Path, nargs="+", help="folders with real/ and sim/")
    parser.add_argument("--every-pair", type=int, default=1, help="take each n-th pair")
    args = parser.parse_args()
    print("| scenes | base | flaw | change | 95 % interval | named |\n" + "|---" * 6 + "|")
    for folder in args.datasets:
        scenes = scenes_by_folder[folder] = read_scenes(folder, args.every_pair)
        paths = sorted((folder / "real").glob("*.bin"))[:: args.every_pair]
        cars = [[*find_cars(read(path))] for path, _ in zip(paths, scenes, strict=False)]
        flaws = {name: amounts[min(1, len(amounts) - 1)][0] for name, (_, amounts) in FLAWS.items()}
        flaws = {name: alter for name, alter in flaws.items() if is_possible(name, folder)}
        for base in ("good", "poor"):
            before = [flat_share(scan.points, is_road, bases[base]) for _, scan, bases, is_road, _ in scenes]
            sims = {"boxes": [boxed(scene[2][base], own) for scene, own in zip(scenes, cars, strict=True)]}
            for i in range(N_HEALTHY):  # the good base is made again, the poor one measured again
                sims[f"healthy {i}"] = [
                    remeasured(
                        scan if base == "good" else Scan(bases[base], None, None), random(name, i), 0.02 - 0.002 * i
                    )
                    for name, scan, bases, *_ in scenes
                ]
            for name, alter in flaws.items():
                sims[name] = [altered(scene, base, [(name, alter)]) for scene in scenes]
            for name, own in sims.items():
                shares = [flat_share(scene[1].points, scene[3], sim) for scene, sim in zip(scenes, own, strict=True)]
                change = np.array(shares) - before
                half = stats.t.ppf(0.975, len(change) - 1) * change.std(ddof=1) / np.sqrt(len(change))
                is_named = max(change.mean() - half, change.min() if len(change) >= 4 else -1) > LIMIT
                shown = f"{change.mean():.3f} | {change.mean() - half:.3f} to {change.mean() + half:.3f}"
                print(f"| {folder.name} | {base} | {name} | {shown} | {'yes' if is_named else 'no'} |", flush=True)


if __name__ == "__main__":
    main()
