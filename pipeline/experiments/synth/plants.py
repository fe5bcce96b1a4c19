"""Trees, bushes and hedges as triangle meshes: wood is a welded mesh, foliage a soup of loose leaves.

The two are kept apart, because a digital twin treats them differently. Leaves to others: where plants stand (`scene`).
"""

from __future__ import annotations

import numpy as np

from ....stages.arrays import FloatArray
from .meshes import UP, Mesh, join, left_of, tube, wall

_LEAF_AREA = 0.72  # mean area of a triangle with three random corners on the unit sphere, in squared radii


def tree(foot: FloatArray, height_m: float, leaf_m: float, rng: np.random.Generator) -> tuple[Mesh, Mesh]:
    """Trunk and branches, and the foliage."""
    bole = height_m * rng.uniform(0.25, 0.4)
    radius = 0.028 * height_m * rng.uniform(0.7, 1.3)
    width = height_m * rng.uniform(0.2, 0.33)
    centre = foot + np.array([*rng.normal(0.0, 0.03 * height_m, 2), (height_m + bole) / 2])
    fork = foot + bole * UP
    wood = [tube(foot - 0.3 * UP, fork, (1.15 * radius, 0.85 * radius), 0.3)]
    half = np.array([width, width * rng.uniform(0.8, 1.2), (height_m - bole) / 2 * 1.1])
    tips = centre + 0.7 * _in_ball(6, 0.3, rng) * half
    wood += [tube(fork, tip, (0.5 * radius, 0.15 * radius), 0.3, sides=5) for tip in tips]
    wood.append(tube(fork, centre, (0.8 * radius, 0.3 * radius), 0.3))
    return join(wood), crown(centre, half, leaf_m, rng)


def bush(foot: FloatArray, radius_m: float, leaf_m: float, rng: np.random.Generator) -> Mesh:
    """A rounded clump of leaves."""
    radii = radius_m * np.array([1.0, rng.uniform(0.7, 1.3), rng.uniform(0.8, 1.2)])
    return crown(foot + 0.8 * radii[2] * UP, radii, leaf_m, rng)


def hedge(line: FloatArray, width_m: float, height_m: float, leaf_m: float, rng: np.random.Generator) -> Mesh:
    """A clipped hedge along a line of feet: leaves in its outer layer, opaque inside.

    Parameters
    ----------
    line : (n, 3) float64, metres, a point a metre or so
    """
    across = left_of(line)
    length = float(np.linalg.norm(np.diff(line, axis=0), axis=1).sum())
    n_leaves = int(np.clip(1.2 * length * (2 * height_m + width_m) / (_LEAF_AREA * leaf_m**2), 40, 6000))
    place = rng.uniform(0.0, len(line) - 1.0, n_leaves)
    before = np.minimum(place.astype(np.intp), len(line) - 2)
    foot = line[before] + (place - before)[:, None] * (line[before + 1] - line[before])
    # Around the profile: up one side, over the top, down the other.
    girth = rng.uniform(0.0, 2 * height_m + width_m, n_leaves)
    up = np.minimum(np.minimum(girth, 2 * height_m + width_m - girth), height_m)
    side = np.clip(girth - height_m - width_m / 2, -width_m / 2, width_m / 2)
    depth = rng.exponential(0.08, n_leaves) - 0.06
    up = np.where(np.abs(side) < width_m / 2, up - 3 * depth, up)
    side = np.where(np.abs(side) < width_m / 2, side, side - np.sign(side) * depth)
    places = foot + side[:, None] * across[before] + up[:, None] * UP
    reflectivity = float(rng.uniform(0.25, 0.5))
    core = wall(line, width_m - 0.3, height_m - 0.15, reflectivity)
    cut = leaves(places, leaf_m, reflectivity, rng)
    return join([cut, core])


def crown(centre: FloatArray, radii_m: FloatArray, leaf_m: float, rng: np.random.Generator) -> Mesh:
    """Foliage in an ellipsoid: clumps of leaves, thicker towards the rim, two layers of leaf on the way through.

    Parameters
    ----------
    centre, radii_m : (3,) float64
    leaf_m : radius of a leaf
    """
    area = np.pi * float(radii_m[0] * (radii_m[1] + radii_m[2])) / 2
    n_leaves = int(np.clip(2.0 * area / (_LEAF_AREA * leaf_m**2), 40, 4000))
    n_clumps = 9
    clumps = 0.62 * _in_ball(n_clumps, 0.3, rng)
    places = clumps[rng.integers(n_clumps, size=n_leaves)] + 0.42 * _in_ball(n_leaves, 0.5, rng)
    return leaves(centre + places * radii_m, leaf_m, float(rng.uniform(0.25, 0.5)), rng)


def leaves(places: FloatArray, size_m: float, reflectivity: float, rng: np.random.Generator) -> Mesh:
    """One triangle a place, its corners `size_m` away in random directions.

    Parameters
    ----------
    places : (n, 3) float64, metres
    """
    corners = rng.normal(size=(len(places), 3, 3))
    corners *= size_m / np.linalg.norm(corners, axis=2, keepdims=True)
    vertices = (places[:, None] + corners).reshape(-1, 3)
    return Mesh(vertices, np.arange(len(vertices)).reshape(-1, 3), np.full(len(places), reflectivity))


def _in_ball(n: int, power: float, rng: np.random.Generator) -> FloatArray:
    """Random points in the unit ball; a power of 1/3 fills it evenly, a smaller one crowds the rim."""
    direction = rng.normal(size=(n, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    radius: FloatArray = rng.uniform(size=(n, 1)) ** power
    return direction * radius
