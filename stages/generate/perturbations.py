"""Alters a scan in a known way and by a known amount (paper, section "Controlled Perturbation Analysis").

Noise, dropout and rigid motion are the paper's; it names hallucination and local density change and does not sweep
them, so that their definitions here are ours.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.random import Generator
from scipy.spatial import cKDTree

from ..arrays import BoolArray, FloatArray, IndexArray

KINDS = ("noise", "dropout", "rigid", "hallucination", "density", "null")

CLUSTER_POINTS = 20
CLUSTER_STD_M = 0.15
CLUSTER_DISTANCE_M = 0.5
REGION_RADIUS_M = 2.0
REGION_SHARE = 0.3
SURFACE_NEIGHBOURS = 5


@dataclass(frozen=True)
class Perturbation:
    """One way and amount of altering points.

    kind : one of `KINDS`
    amount : null: points lost, the others in another order; noise: standard deviation in metres; dropout: share of
        points lost; rigid: angle in degrees; hallucination: spurious points over true ones; density: factor of the
        local density
    shift_m : rigid only, length of the translation
    """

    kind: str
    amount: float
    shift_m: float = 0.0


def perturb(points: FloatArray, perturbation: Perturbation, rng: Generator) -> FloatArray:
    """The altered points, (m, 3); points that stay keep their order (but for `null`), new ones follow them.

    Parameters
    ----------
    points : (n, 3) float64, metres, sensor at the origin
    perturbation : kind and amount
    rng : decides all that is random

    Raises
    ------
    ValueError
        The kind is unknown.

    Examples
    --------
    >>> import numpy as np
    >>> line = np.arange(30.0).reshape(10, 3)
    >>> len(perturb(line, Perturbation("dropout", 0.4), np.random.default_rng(0)))
    7
    """
    amount = perturbation.amount
    if perturbation.kind == "null":
        return reorder(points, round(amount), rng)
    if perturbation.kind == "noise":
        return add_noise(points, amount, rng)
    if perturbation.kind == "dropout":
        return drop_points(points, amount, rng)
    if perturbation.kind == "rigid":
        return move_rigidly(points, amount, perturbation.shift_m, rng)
    if perturbation.kind == "hallucination":
        return add_clusters(points, amount, rng)
    if perturbation.kind == "density":
        return change_density(points, amount, rng)
    raise ValueError(f"perturbation {perturbation.kind!r}: no such kind; known are {', '.join(KINDS)}")


def reorder(points: FloatArray, n_lost: int, rng: Generator) -> FloatArray:
    """All points but a few, in a random order: nothing has changed, but Louvain visits nodes in their order."""
    return points[rng.permutation(len(points))[n_lost:]]


def add_noise(points: FloatArray, std_m: float, rng: Generator) -> FloatArray:
    """Points with independent Gaussian noise on each coordinate."""
    return points + rng.normal(0.0, std_m, points.shape)


def drop_points(points: FloatArray, share: float, rng: Generator) -> FloatArray:
    """The points that are left when each is lost with the same probability, independently."""
    return points[rng.random(len(points)) >= share]


def measure_again(
    points: FloatArray, noise_m: float, lost_share: float, rng: Generator
) -> tuple[FloatArray, IndexArray]:
    """The points as a second measurement by the same beams would have them, and which of the points these are.

    p' = p (1 + e / |p|) with e ~ N(0, noise_m): noise along the ray alone; then each is lost independently with the
    probability `lost_share`. Under one seed the noise of a point is in proportion to `noise_m`, and what is lost at a
    share is lost at each larger one. Without noise the coordinates stay to the last bit.

    Parameters
    ----------
    points : (n, 3) float64, metres, sensor at the origin, finite, none of them there
    noise_m : standard deviation of the difference of two measured ranges, 0 or more
    lost_share : 0 to 1
    rng : decides all that is random

    Returns
    -------
    points : (m, 3) float64
    rows : (m,) intp, of the input, ascending

    Examples
    --------
    >>> import numpy as np
    >>> again, rows = measure_again(np.array([[3.0, 4.0, 0.0]]), 0.5, 0.0, np.random.default_rng(0))
    >>> bool(np.isclose(again[0, 1] / again[0, 0], 4 / 3)), rows.tolist()
    (True, [0])
    """
    range_m = np.sqrt((points**2).sum(axis=1))
    again = points * (1.0 + noise_m * rng.standard_normal(len(points)) / range_m)[:, None]
    rows = np.flatnonzero(rng.random(len(points)) >= lost_share)
    return again[rows], rows


def move_rigidly(points: FloatArray, angle_deg: float, shift_m: float, rng: Generator) -> FloatArray:
    """Points turned about +Z through the sensor, then moved in a random horizontal direction."""
    angle, heading = np.radians(angle_deg), rng.uniform(0.0, 2 * np.pi)
    cos, sin = np.cos(angle), np.sin(angle)
    R = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
    moved: FloatArray = points @ R.T + shift_m * np.array([np.cos(heading), np.sin(heading), 0.0])
    return moved


def add_clusters(points: FloatArray, share: float, rng: Generator) -> FloatArray:
    """The points and round(share n) spurious ones, in clusters of 20 (the last one smaller).

    A cluster lies about a centre 0.5 m from a random point in a random direction, its points Gaussian about the
    centre with 0.15 m on each coordinate: a blob of foliage or mesh where there is nothing.
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
    """The points with another density in some regions that together hold 30 % of them.

    Regions grow about random points: each takes the nearest points within 2 m that are not taken yet, until the
    share is reached. Below 1, a point of a region stays with probability `factor`. Above 1, a region of m points
    gets round((factor - 1) m) more, each on the line from a random point of the region to a random one of its 5
    nearest neighbours in the scan, so that they lie on the surface.
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
    return np.vstack([points, points[start] + rng.random((n_new, 1)) * (points[end] - points[start])])


def grow_regions(points: FloatArray, n_wanted: int, rng: Generator) -> BoolArray:
    """Which points lie in regions of 2 m about random points, (n,) bool with exactly `n_wanted` True."""
    chosen = np.zeros(len(points), dtype=np.bool_)
    tree = cKDTree(points)
    n_left = n_wanted
    while n_left:
        centre = points[rng.choice(np.flatnonzero(~chosen))]
        inside = np.array(tree.query_ball_point(centre, REGION_RADIUS_M), dtype=np.intp)
        inside = inside[~chosen[inside]]
        distance = np.linalg.norm(points[inside] - centre, axis=1)
        taken = inside[np.lexsort((inside, distance))[:n_left]]
        chosen[taken] = True
        n_left -= len(taken)
    return chosen
