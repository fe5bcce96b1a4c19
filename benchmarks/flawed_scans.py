"""Flaws of a simulated scan, built from scratch: numpy and scipy on points, nothing of fidpipe.

Each flaw takes a `Scan` and a source of random numbers and returns the flawed points. Used by the benchmarks of
decisions and causes.
"""

import zlib
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import minimum_filter
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

CAR_LENGTH_M = (3.0, 5.5)
CAR_WIDTH_M = (1.0, 2.3)
CAR_TOP_M = (1.3, 2.2)
CAR_RANGE_M = (4.0, 15.0)


@dataclass
class Scan:
    """What flaws act on.

    points : (n, 3) float64, metres, simulated side, sensor at the origin, z up
    car : (m, 3) points of the car-sized object, found on the real scan at full density
    poles : (k, 2) x, y of thin poles, found there too
    cars : points and box of all car-sized objects, for flaws that need them
    """

    points: np.ndarray
    car: np.ndarray
    poles: np.ndarray
    cars: tuple = ()


# Geometry of a scan, for the flaws that need to know what is where


def ranges(points):
    return np.linalg.norm(points, axis=1)


def read(path):
    """The points of a KITTI file beyond 0.5 m."""
    points = np.fromfile(path, np.float32).reshape(-1, 4)[:, :3].astype(float)
    return points[ranges(points) > 0.5]


def write(path, points):
    path.parent.mkdir(parents=True, exist_ok=True)
    np.column_stack([points, np.zeros(len(points))]).astype(np.float32).tofile(path)


def random(*names):
    """A generator that depends on the names alone."""
    return np.random.default_rng(zlib.crc32(" ".join(map(str, names)).encode()))


def along_ray(points, new_range_m):
    return points * (new_range_m / ranges(points))[:, None]


def road_height(points):
    """The fullest 0.1 m of height within 20 m."""
    z = np.sort(points[ranges(points) < 20, 2])
    first = (np.searchsorted(z, z + 0.1) - np.arange(len(z))).argmax()
    return np.median(z[first : np.searchsorted(z, z[first] + 0.1)])


def is_ground(points):
    """Less than 0.25 m above the lowest point of the nine 1 m cells around it, or above the road if that is far off."""
    cells = np.floor(points[:, :2]).astype(int)
    cells -= cells.min(axis=0)
    lowest = np.full(cells.max(axis=0) + 1, np.inf)
    np.minimum.at(lowest, tuple(cells.T), points[:, 2])
    floor_m = minimum_filter(lowest, 3)[tuple(cells.T)]
    road_m = road_height(points)
    is_near = np.abs(floor_m - road_m) < 0.3 + 0.03 * ranges(points)
    return points[:, 2] < np.where(is_near, floor_m, road_m) + 0.25


def rectangle(points):
    """Width, length and centre of the smallest upright box around points, seen from above."""
    boxes = []
    for angle in np.radians(np.arange(0, 90, 2)):
        turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
        level = points[:, :2] @ turn.T
        low = level.min(axis=0)
        high = level.max(axis=0)
        boxes.append((np.prod(high - low), *np.sort(high - low), (low + high) / 2 @ turn))
    return min(boxes, key=lambda box: box[0])[1:]


def find_car(points):
    """Points of the car-sized cluster with the most points: 4 to 15 m away, 3 to 5.5 m long, 1.3 to 2.2 m high."""
    road_m = road_height(points)
    height_m = points[:, 2] - road_m
    near = points[
        ~is_ground(points)
        & (height_m > -0.5)
        & (height_m < 2.5)
        & (np.hypot(*points.T[:2]) < 22)
    ]
    links = cKDTree(near).query_pairs(0.35, output_type="ndarray")
    graph = coo_matrix((np.ones(len(links)), links.T), shape=(len(near), len(near)))
    _, cluster = connected_components(graph, directed=False)
    sizes = np.bincount(cluster)
    for one in np.argsort(-sizes)[: (sizes >= 100).sum()]:
        own = near[cluster == one]
        width_m, length_m, centre = rectangle(own)
        found = (length_m, width_m, own[:, 2].max() - road_m, np.hypot(*centre))
        limits = (CAR_LENGTH_M, CAR_WIDTH_M, CAR_TOP_M, CAR_RANGE_M)
        if all(low <= value <= high for value, (low, high) in zip(found, limits, strict=True)):
            return own
    raise SystemExit("no car-sized cluster found")


def find_poles(points):
    """x, y of upright things at least 1.5 m tall and under 0.5 m wide that stand alone, within 50 m, (k, 2)."""
    height_m = points[:, 2] - road_height(points)
    tall = points[(height_m > 0.6) & (height_m < 2.6) & (np.hypot(*points.T[:2]) < 50)]
    tree = cKDTree(tall[:, :2])
    poles = []
    for candidate in np.unique(np.round(tall[:, :2] / 0.2), axis=0) * 0.2:
        own = tall[tree.query_ball_point(candidate, 0.25)]
        if len(own) < 5 or np.ptp(own[:, 2]) < 1.5:
            continue
        centre = own[:, :2].mean(axis=0)
        inside = len(tree.query_ball_point(centre, 0.3))
        around = len(tree.query_ball_point(centre, 0.8))
        if around <= 1.3 * inside and all(np.hypot(*(centre - pole)) > 0.5 for pole in poles):
            poles.append(centre)
    return np.array(poles).reshape(-1, 2)


def belongs_to_car(scan):
    """Simulated points above the ground within 0.6 m of the real car (twins are up to 0.4 m off)."""
    return ~is_ground(scan.points) & (cKDTree(scan.car).query(scan.points)[0] < 0.6)


# The flaws: a scan and a source of random numbers in, points out


def drop(share):
    return lambda scan, rng: scan.points[rng.random(len(scan.points)) >= share]


def far_drop(scan, rng):
    return scan.points[(ranges(scan.points) < 25) | (rng.random(len(scan.points)) >= 0.6)]


def holes(scan, rng):
    """Centres are points drawn at random from all points, ground included."""
    centres = scan.points[rng.choice(len(scan.points), 12, replace=False)]
    return scan.points[cKDTree(centres).query(scan.points)[0] > 1.5]


def ghosts(scan, rng):
    """Clusters of 20 points, 0.2 m std, in the air between the sensor and a surface, 1.5 m from every point."""
    tree = cKDTree(scan.points)
    road_m = road_height(scan.points)
    n_clusters = round(0.05 * len(scan.points) / 20)
    clusters = []
    while len(clusters) < n_clusters:
        surface = scan.points[rng.integers(len(scan.points))]
        centre = surface * rng.uniform(0.2, 0.9)
        if (
            tree.query(centre)[0] > 1.5
            and centre[2] > road_m + 0.8
            and ranges(centre[None])[0] > 4
        ):
            clusters.append(centre + rng.normal(0, 0.2, (20, 3)))
    return np.vstack([scan.points, *clusters])


def ray_noise(std_m):
    return lambda scan, rng: along_ray(
        scan.points, ranges(scan.points) + rng.normal(0, std_m, len(scan.points))
    )


def offset(scan, rng):
    return scan.points + np.array([0.12, 0.16, 0.0])


def solid_foliage(scan, rng):
    """Rays that enter scattered surface stop at the nearest foliage of their neighbourhood (2 degrees, 3 m deep)."""
    points = scan.points
    range_m = ranges(scan.points)
    distance, near = cKDTree(points).query(points, k=20)
    neighbours = points[near] - points[near].mean(axis=1, keepdims=True)
    spread = np.linalg.eigvalsh(np.einsum("nki,nkj->nij", neighbours, neighbours))
    is_leaf = (spread[:, 0] > 0.1 * spread[:, 2]) & (distance[:, -1] < 2) & ~is_ground(points)
    directions = points / range_m[:, None]
    angle, around = cKDTree(directions).query(directions, k=16)
    is_leaf_near = (
        is_leaf[around] & (angle < np.radians(2)) & (range_m[around] <= range_m[:, None])
    )
    is_hull = is_leaf_near & (range_m[around] >= range_m[:, None] - 3) & is_leaf[:, None]
    is_before = is_leaf_near & (range_m[around] < range_m[:, None] - 0.5)
    shadowed = is_before.sum(axis=1) >= 0.5 * (angle < np.radians(2)).sum(axis=1)
    hull_m = np.where(is_hull | (is_before & shadowed[:, None]), range_m[around], np.inf).min(
        axis=1
    )
    return along_ray(points, np.minimum(range_m, hull_m))


def pitch(scan, rng):
    c = np.cos(np.radians(1))
    s = np.sin(np.radians(1))
    return scan.points @ np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]]).T


def range_scale(scan, rng):
    return scan.points * 1.03


def range_quantum(scan, rng):
    return along_ray(scan.points, np.round(ranges(scan.points) / 0.1) * 0.1)


def car_moved(scan, rng):
    angle = rng.uniform(0, 2 * np.pi)
    return scan.points + belongs_to_car(scan)[:, None] * (
        0.5 * np.array([np.cos(angle), np.sin(angle), 0])
    )


def car_removed(scan, rng):
    return scan.points[~belongs_to_car(scan)]


def car_removed_road_seen(scan, rng):
    """As `car_removed`, but rays that would meet the road at most 6 m behind the car return from there."""
    is_car = belongs_to_car(scan)
    road_m = road_height(scan.points)
    car = scan.points[is_car & (scan.points[:, 2] < -0.1)]
    on_road = car * (road_m / car[:, 2])[:, None]
    return np.vstack([scan.points[~is_car], on_road[np.abs(ranges(on_road) - ranges(car)) < 6]])


def poles_removed(scan, rng):
    if not len(scan.poles):
        return scan.points
    is_pole = (cKDTree(scan.poles).query(scan.points[:, :2])[0] < 0.4) & ~is_ground(scan.points)
    return scan.points[~is_pole]


def azimuth_halved(scan, rng):
    """Every second row: rows run along the beams."""
    return scan.points[::2]


def ground_raised(scan, rng):
    return scan.points + is_ground(scan.points)[:, None] * [0, 0, 0.1]


def motion(scan, rng):
    """10 m/s forward during a sweep of 0.1 s that starts behind and is right in front: nearer from -0.5 to 0.5 m."""
    turn = np.arctan2(scan.points[:, 1], scan.points[:, 0]) / (2 * np.pi)
    return scan.points - turn[:, None] * [10 * 0.1, 0, 0]


def rain(scan, rng):
    """200 rays return from a drop 2.5 to 5 m away (nearer returns are cleaned away by default)."""
    points = scan.points.copy()
    rows = rng.choice(np.flatnonzero(ranges(points) > 5), 200, replace=False)
    points[rows] = along_ray(points[rows], rng.uniform(2.5, 5, 200))
    return points


def range_limit(limit_m):
    return lambda scan, rng: scan.points[ranges(scan.points) <= limit_m]


def mixed_pixels(scan, rng):
    is_mixed = rng.random(len(scan.points)) < 0.03
    return along_ray(
        scan.points, ranges(scan.points) + is_mixed * rng.uniform(0.2, 1.5, len(scan.points))
    )


def mixed_edges(scan, rng):
    """As `mixed_pixels`, but only where the next or previous return of the beam is at least 0.5 m farther."""
    range_m = ranges(scan.points)
    step_m = np.diff(range_m, prepend=range_m[0], append=range_m[-1])
    edges = np.flatnonzero((step_m[1:] > 0.5) | (step_m[:-1] < -0.5))
    rows = rng.choice(edges, min(len(edges), round(0.03 * len(range_m))), replace=False)
    range_m[rows] += rng.uniform(0.2, 1.5, len(rows))
    return along_ray(scan.points, range_m)


FLAWS = {
    "drop 10 %": drop(0.1),
    "drop 30 %": drop(0.3),
    "drop 60 % beyond 25 m": far_drop,
    "12 holes of 1.5 m": holes,
    "5 % ghosts in free air": ghosts,
    "10 cm noise along the ray": ray_noise(0.1),
    "20 cm offset": offset,
    "solid foliage": solid_foliage,
    "pitch 1 degree": pitch,
    "range +3 %": range_scale,
    "range quantum 10 cm": range_quantum,
    "car moved by 0.5 m": car_moved,
    "car removed": car_removed,
    "thin poles removed": poles_removed,
    "azimuth resolution halved": azimuth_halved,
    "ground 10 cm higher": ground_raised,
    "motion distortion 10 m/s": motion,
    "rain, 200 points within 5 m": rain,
    "range limited to 50 m": range_limit(50),
    "range limited to 30 m": range_limit(30),
    "3 % mixed pixels": mixed_pixels,
    "control: 1 cm noise": ray_noise(0.01),
}
#: Harder versions of two flaws; not counted.
FURTHER = {
    "car removed, road seen behind": car_removed_road_seen,
    "3 % mixed pixels, at edges": mixed_edges,
}
ALL = FLAWS | FURTHER
CONTROL = "control: 1 cm noise"
