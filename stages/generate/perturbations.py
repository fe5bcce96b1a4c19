"""Perturbations of known kind and amount (paper, section "Controlled Perturbation Analysis").

Noise, dropout and rigid motion are the paper's; it names hallucination and local density change but
does not sweep them, so their definitions are ours.
"""

from __future__ import annotations

import numpy as np
from numpy.random import Generator
from scipy.spatial import cKDTree

from ..arrays import BoolArray, FloatArray, IndexArray

CLUSTER_POINTS = 20
CLUSTER_STD_M = 0.15
CLUSTER_DISTANCE_M = 0.5
REGION_RADIUS_M = 2.0
REGION_SHARE = 0.3
SURFACE_NEIGHBOURS = 5


def reorder(points: FloatArray, n_lost: float, rng: Generator) -> FloatArray:
    """All points except a few, in a random order: the scene is the same, but Louvain visits nodes in their order."""
    return points[rng.permutation(len(points))[round(n_lost) :]]


def add_noise(points: FloatArray, std_m: float, rng: Generator) -> FloatArray:
    """Points with independent Gaussian noise on each coordinate."""
    return points + rng.normal(0.0, std_m, points.shape)


def drop_points(points: FloatArray, share: float, rng: Generator) -> FloatArray:
    """The points without those lost, each independently with the same probability."""
    return points[rng.random(len(points)) >= share]


def remeasure(
    points: FloatArray,
    noise_m: float,
    lost_share: float,
    rng: Generator,
) -> tuple[FloatArray, IndexArray]:
    """A simulated second measurement of the points by the same beams.

    p' = p (1 + e / |p|) with e ~ N(0, noise_m): noise along the ray alone; then each is lost
    independently with the probability `lost_share`. Under one seed the noise of a point is
    proportional to `noise_m`, and points lost at a share are lost at each larger one. Without noise
    the coordinates stay equal to the last bit.

    Parameters
    ----------
    points : (n, 3) float64, metres, sensor at the origin; finite and not zero
    noise_m : standard deviation of the difference of two measured ranges, 0 or more
    lost_share : 0 to 1
    rng : source of all randomness

    Returns
    -------
    points : (m, 3) float64
    rows : (m,) intp, of the input, ascending

    Examples
    --------
    >>> import numpy as np
    >>> again, rows = remeasure(np.array([[3.0, 4.0, 0.0]]), 0.5, 0.0, np.random.default_rng(0))
    >>> bool(np.isclose(again[0, 1] / again[0, 0], 4 / 3)), rows.tolist()
    (True, [0])
    """
    range_m = np.linalg.norm(points, axis=1)
    again = points * (1.0 + noise_m * rng.standard_normal(len(points)) / range_m)[:, None]
    rows = np.flatnonzero(rng.random(len(points)) >= lost_share)
    return again[rows], rows


def fill_gaps(
    points: FloatArray,
    rows: IndexArray,
    n_lost: IndexArray,
) -> tuple[FloatArray, IndexArray]:
    """The returns of lost pulses, evenly spaced in direction and range between two returns of one beam.

    Parameters
    ----------
    points : (n, 3) float64, metres, sensor at the origin
    rows : (g, 2) intp, points before and after each gap
    n_lost : (g,) intp, pulses lost in each gap

    Returns
    -------
    points : (m, 3) float64
    rows : (m,) intp, the nearer end of its gap for each point

    Examples
    --------
    >>> import numpy as np
    >>> filled, rows = fill_gaps(np.array([[4.0, 3, 0], [4, -3, 0]]), np.array([[0, 1]]), np.array([1]))
    >>> filled.tolist(), rows.tolist()
    ([[5.0, 0.0, 0.0]], [1])
    """
    gap = np.repeat(np.arange(len(rows)), n_lost)
    number = np.arange(len(gap)) - np.repeat(np.cumsum(n_lost) - n_lost, n_lost)
    share = ((number + 1) / (n_lost[gap] + 1))[:, None]
    range_m = np.linalg.norm(points[rows], axis=2, keepdims=True)
    direction = (points[rows] / range_m)[gap]
    range_m = range_m[gap]
    middle = (1 - share) * direction[:, 0] + share * direction[:, 1]
    middle_m = (1 - share) * range_m[:, 0] + share * range_m[:, 1]
    filled: FloatArray = middle / np.linalg.norm(middle, axis=1)[:, None] * middle_m
    return filled, rows[gap, (share[:, 0] >= 0.5).astype(np.intp)]


def move_rigidly(
    points: FloatArray,
    angle_deg: float,
    rng: Generator,
    shift_m: float = 0.0,
) -> FloatArray:
    """Points rotated about +Z through the sensor, then moved in a random horizontal direction."""
    angle = np.radians(angle_deg)
    heading = rng.uniform(0.0, 2 * np.pi)
    cos = np.cos(angle)
    sin = np.sin(angle)
    R = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
    return points @ R.T + shift_m * np.array([np.cos(heading), np.sin(heading), 0.0])


def add_clusters(points: FloatArray, share: float, rng: Generator) -> FloatArray:
    """The points and round(share n) spurious ones, in clusters of 20 (the last one smaller).

    The centre of a cluster is 0.5 m from a random point in a random direction, its points are
    Gaussian about the centre with 0.15 m on each coordinate: a blob of foliage or mesh in empty
    space.
    """
    n_new = round(share * len(points))
    if not n_new:
        return points.copy()
    n_clusters = -(-n_new // CLUSTER_POINTS)
    direction = rng.normal(size=(n_clusters, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    centre = points[rng.integers(len(points), size=n_clusters)] + CLUSTER_DISTANCE_M * direction
    cluster_ids = np.arange(n_new) // CLUSTER_POINTS
    return np.vstack([points, centre[cluster_ids] + rng.normal(0.0, CLUSTER_STD_M, (n_new, 3))])


def change_density(points: FloatArray, factor: float, rng: Generator) -> FloatArray:
    """The points with another density in regions that together hold 30 % of them.

    Regions grow about random points: each takes the nearest free points within 2 m until the share
    is reached. Below 1, a point of a region stays with probability `factor`. Above 1, a region of m
    points gets round((factor - 1) m) more, each on the line from a random point of the region to a
    random one of its 5 nearest neighbours in the scan, so that they lie on the surface.
    """
    chosen = grow_regions(points, round(REGION_SHARE * len(points)), rng)
    if factor <= 1:
        return points[~chosen | (rng.random(len(points)) < factor)]
    n_new = round((factor - 1) * np.count_nonzero(chosen))
    if not n_new or len(points) < 2:
        return points.copy()
    start = rng.choice(np.flatnonzero(chosen), size=n_new)
    n_near = min(SURFACE_NEIGHBOURS, len(points) - 1)
    _, near = cKDTree(points).query(points[start], k=n_near + 1)
    end = near[np.arange(n_new), rng.integers(1, n_near + 1, size=n_new)]
    return np.vstack(
        [points, points[start] + rng.random((n_new, 1)) * (points[end] - points[start])],
    )


def grow_regions(points: FloatArray, n_chosen: int, rng: Generator) -> BoolArray:
    """Mask of `n_chosen` points in regions of 2 m about random points, (n,) bool."""
    chosen = np.zeros(len(points), dtype=np.bool_)
    tree = cKDTree(points)
    n_left = n_chosen
    while n_left:
        centre = points[rng.choice(np.flatnonzero(~chosen))]
        inside = np.array(tree.query_ball_point(centre, REGION_RADIUS_M), dtype=np.intp)
        inside = inside[~chosen[inside]]
        distance = np.linalg.norm(points[inside] - centre, axis=1)
        taken = inside[np.lexsort((inside, distance))[:n_left]]
        chosen[taken] = True
        n_left -= len(taken)
    return chosen
