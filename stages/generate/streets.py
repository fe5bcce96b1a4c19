"""A random street around a sensor, and a flawed digital twin of it.

Coordinates are metres: x along the street, y to the left, z up. Objects are built on a straight
street with z above the ground, which is then bent and moved into the frame of the sensor.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from numpy.random import Generator
from scipy.spatial import cKDTree
from scipy.stats import norm

from ..arrays import FloatArray, IndexArray

#: Class names by number, as in `.label` files.
KINDS = ("ground", "wall", "car", "tree", "vegetation", "pole")
_REACH_M = 95.0  # length of the built-up street in both directions
_GROUND_REACH_M = 45.0
_MAX_EDGE_M = 1.5
_LEAF_M = 0.22  # radius of a leaf
_MAX_LEAVES = 4000
_CLUMPS = 9  # of leaves in a crown
_UP = np.array([0.0, 0.0, 1.0])
_N_WAVES = 24
_SHEETS_PER_OBJECT = 0.8
_NEIGHBOUR_M = 4.0  # faces joined by an invented sheet are at most so far from its start
MAX_DENSITY = 8  # points per beam


@dataclass(frozen=True)
class Scene:
    """Surfaces of a street or of its twin.

    triangles : (f, 3, 3) float64, corners, sensor frame
    object_ids : (f,) intp, object of each triangle
    kinds : one of `KINDS` for each object
    reflectivity : (k,) float64, 0 to 1, of each object
    density : (k,) float64, points per beam that hits an object
    """

    triangles: FloatArray
    object_ids: IndexArray
    kinds: tuple[str, ...]
    reflectivity: FloatArray
    density: FloatArray


def build_street(rng: Generator) -> Scene:
    """A road with parked cars, trees, poles, gardens and houses on both sides."""
    kerb_m = rng.uniform(3.4, 5.2)
    garden_m = kerb_m + rng.uniform(1.6, 3.2)
    house_m = garden_m + rng.uniform(9.0, 17.0)
    parts = [_ground()]
    kinds = ["ground"]
    rows = [
        # kind, object, distance from the middle of the road, distance and used share of the places
        ("car", _car, kerb_m - 1.0, 6.2, rng.uniform(0.1, 0.7)),
        ("tree", _tree, kerb_m + 0.5, rng.uniform(9.0, 24.0), rng.uniform(0.4, 1.0)),
        ("pole", _pole, kerb_m + 0.5, 25.0, 0.9),
        ("vegetation", _fence, garden_m, 19.0, 0.2),
        ("wall", _fence, garden_m, 21.0, 0.2),
        ("vegetation", _bush, garden_m + 2.0, 11.0, 0.5),
        ("tree", _tree, garden_m + 5.0, 17.0, 0.5),
        ("wall", _house, house_m, 18.0, rng.uniform(0.25, 0.6)),
        ("tree", _tree, house_m + 9.0, 14.0, 0.6),
    ]
    for (kind, build, distance_m, step_m, share), side in product(rows, (1, -1)):
        for x in np.arange(-_REACH_M + rng.uniform(0.0, step_m), _REACH_M, step_m):
            is_sensor_lane = kind == "car" and side < 0 and abs(x) < 7.0
            if rng.uniform() < share and not is_sensor_lane:
                y = side * distance_m * rng.uniform(1.0, 1.1)
                parts.append(build(rng) + np.array([x, y, 0.0]))
                kinds.append(kind)
    bend_per_m = rng.choice([-1.0, 1.0]) / rng.choice([75.0, 120.0, 200.0, 1e4])
    sensor_m = np.array([0.0, -0.45 * kerb_m, rng.uniform(1.72, 1.9)])
    return Scene(
        triangles=_bend(np.concatenate(parts), bend_per_m) - sensor_m,
        object_ids=np.repeat(np.arange(len(parts)), [len(part) for part in parts]),
        kinds=tuple(kinds),
        reflectivity=rng.uniform(0.15, 0.6, len(parts)),
        density=np.ones(len(parts)),
    )


def _bend(points: FloatArray, per_m: float) -> FloatArray:
    """Points of a straight street on one of this curvature, positive to the left."""
    x, y, z = np.moveaxis(points, -1, 0)
    radius_m = 1 / per_m
    angle = x * per_m
    bent_x = (radius_m - y) * np.sin(angle)
    bent_y = radius_m - (radius_m - y) * np.cos(angle)
    return np.stack([bent_x, bent_y, z], axis=-1)


def _ground() -> FloatArray:
    """Ground that rises gently to both sides, with a swell of a centimetre."""
    x, y = np.mgrid[-130:131:2.5, -65:66:2.5]
    z = 0.005 * np.abs(y) + 0.01 * np.sin(x / 7.0) * np.cos(y / 5.0)
    grid = np.stack([x, y, z], axis=-1)
    first = grid[:-1, :-1]
    last = grid[1:, 1:]
    right = np.stack([first, grid[1:, :-1], last], axis=2)
    left = np.stack([first, last, grid[:-1, 1:]], axis=2)
    return np.concatenate([right, left]).reshape(-1, 3, 3)


def _prism(profile: FloatArray, length_m: float) -> FloatArray:
    """A convex profile of y and z, swept along x in both directions, in small triangles."""
    from trimesh.convex import convex_hull

    half_m = np.full((len(profile), 1), length_m / 2)
    ends = [np.column_stack([x, profile]) for x in (half_m, -half_m)]
    return np.asarray(
        convex_hull(np.concatenate(ends)).subdivide_to_size(_MAX_EDGE_M).triangles
    )


def _box(length_m: float, width_m: float, height_m: float) -> FloatArray:
    """An upright box; the origin is the middle of its base."""
    corners = np.array([[-0.5, 0.0], [0.5, 0.0], [0.5, 1.0], [-0.5, 1.0]])
    return _prism(corners * [width_m, height_m], length_m)


def _house(rng: Generator) -> FloatArray:
    """A house with a gable roof."""
    gable = np.array([[-1.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.7], [-1.0, 1.0]])
    profile = gable * rng.uniform([3.5, 2.8], [5.0, 5.0])
    return _prism(profile, rng.uniform(8.0, 14.0))


def _fence(rng: Generator) -> FloatArray:
    """A low wall or a clipped hedge along the street."""
    length_m, width_m, height_m = rng.uniform([8.0, 0.25, 0.5], [16.0, 0.9, 1.7])
    return _box(length_m, width_m, height_m)


def _car(rng: Generator) -> FloatArray:
    """A car: its side view, swept across."""
    length = np.array([-0.5, 0.5, 0.5, 0.22, 0.06, -0.4, -0.5])
    height = np.array([0.17, 0.17, 0.5, 0.62, 1.0, 1.0, 0.6])
    side_view = np.column_stack([length, height]) * rng.uniform([3.9, 1.4], [4.7, 1.7])
    return _prism(side_view, 1.8)[..., [1, 0, 2]]


def _post(height_m: float, radius_m: float) -> FloatArray:
    """A round post, to the same depth below the ground as above it."""
    turn = np.arange(8) * np.pi / 4
    circle = radius_m * np.column_stack([np.cos(turn), np.sin(turn)])
    return _prism(circle, 2 * height_m)[..., [1, 2, 0]]


def _pole(rng: Generator) -> FloatArray:
    """A lamp or a traffic sign: a post with a box on its top."""
    height_m = rng.uniform(2.0, 7.0)
    top = _box(0.1, 1.0, 0.5) + height_m * _UP
    return np.concatenate([_post(height_m, 0.07), top])


def _tree(rng: Generator) -> FloatArray:
    """A trunk, and a crown on its upper two thirds."""
    height_m = rng.uniform(4.0, 10.0)
    radii_m = height_m * rng.uniform([0.2, 0.2, 0.3], [0.33, 0.33, 0.4])
    middle_m = 0.65 * height_m
    crown = _crown(radii_m, rng) + middle_m * _UP
    return np.concatenate([_post(middle_m, 0.028 * height_m), crown])


def _bush(rng: Generator) -> FloatArray:
    radii_m = rng.uniform(0.5, 1.3, 3)
    return _crown(radii_m, rng) + 0.8 * radii_m[2] * _UP


def _crown(radii_m: FloatArray, rng: Generator) -> FloatArray:
    """Clumps of triangular leaves, about two leaves deep along a line of sight."""
    area_m2 = np.pi * radii_m[0] * (radii_m[1] + radii_m[2])
    n_leaves = min(int(1.4 * area_m2 / _LEAF_M**2), _MAX_LEAVES)
    clumps = rng.normal(0.0, 0.35, (_CLUMPS, 3))
    clump_of = rng.integers(_CLUMPS, size=n_leaves)
    places = (clumps[clump_of] + rng.normal(0.0, 0.2, (n_leaves, 3))) * radii_m
    corners = rng.normal(size=(n_leaves, 3, 3))
    corners *= _LEAF_M / np.linalg.norm(corners, axis=2, keepdims=True)
    return places[:, None] + corners


def build_twin(street: Scene, rng: Generator) -> Scene:
    """The street as a mesh of registered scans has it.

    Its flaws are those of the paper's twin (sections "Data Collection" and "Real experiments"):
    objects and foliage missing at a distance, holes, thin objects and leaves too large, surfaces
    invented between neighbours, all displaced by centimetres nearby and decimetres far away, and
    densities unlike those of the real sensor.
    """
    kinds = np.array(street.kinds)
    is_foliage = np.isin(kinds, ["tree", "vegetation"])
    centres = street.triangles.mean(axis=1)
    distance_m = np.linalg.norm(centres, axis=1)
    range_m = np.bincount(street.object_ids, distance_m) / np.bincount(street.object_ids)

    loss = np.where(is_foliage, (range_m - 12.0) / 39.0, (range_m - 25.0) / 80.0)
    is_lost = rng.uniform(size=len(kinds)) < np.clip(loss, 0.0, 0.9)
    hole_share = np.minimum(0.04 + 0.003 * range_m, 0.25) * rng.uniform(0.0, 2.0, len(kinds))
    is_whole = _smooth_field(centres, rng)[:, 0] < norm.isf(hole_share)[street.object_ids]
    is_ground = street.object_ids == 0
    is_upright = is_whole & ~is_lost[street.object_ids] & ~is_ground
    is_kept = is_upright | (is_ground & (distance_m < _GROUND_REACH_M))

    factor = np.where(is_foliage | (kinds == "pole"), 1.6, 1.0)[street.object_ids, None, None]
    swollen = centres[:, None] + factor * (street.triangles - centres[:, None])
    sheets, sheet_ids = _invent_sheets(centres[is_upright], street.object_ids[is_upright], rng)
    triangles = np.concatenate([swollen[is_kept], sheets])
    object_ids = np.concatenate([street.object_ids[is_kept], sheet_ids])
    error_m = 0.05 + 0.004 * range_m
    error_m[0] = 0.05  # the scanner has passed over the ground
    shift = error_m[object_ids, None, None] * _smooth_field(triangles, rng) * [1.0, 1.0, 0.25]
    density = np.clip(rng.lognormal(-0.3, 1.0, len(kinds)), 0.1, MAX_DENSITY)
    density[0] = 0.8
    return replace(street, triangles=triangles + shift, object_ids=object_ids, density=density)


def _invent_sheets(
    centres: FloatArray, object_ids: IndexArray, rng: Generator
) -> tuple[FloatArray, IndexArray]:
    """Triangles that join random faces within a few metres, and the object that each hangs on.

    Parameters
    ----------
    centres, object_ids : (f, 3) float64 and (f,) intp, of the faces that may be joined
    """
    _, first = np.unique(object_ids, return_index=True)
    starts = first[rng.uniform(size=len(first)) < _SHEETS_PER_OBJECT]
    sheets = []
    for near in cKDTree(centres).query_ball_point(centres[starts], _NEIGHBOUR_M):
        corners = centres[rng.choice(near, 4)]
        sheets += [corners[:3], corners[1:]]
    triangles = np.array(sheets).reshape(-1, 3, 3)
    return triangles, np.repeat(object_ids[starts], 2)


def _smooth_field(places: FloatArray, rng: Generator) -> FloatArray:
    """A random vector at each place, of unit variance on each axis, that varies over 2 to 30 metres.

    F(x) = sqrt(2 / m) sum_k a_k cos(q_k . x + phi_k), m = 24 waves in random directions.

    Parameters
    ----------
    places : (..., 3) float64, metres
    """
    directions = rng.normal(size=(_N_WAVES, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    wavelengths_m = 2.0 * 15.0 ** rng.uniform(size=(_N_WAVES, 1))
    phases = rng.uniform(0.0, 2 * np.pi, _N_WAVES)
    amplitudes = rng.normal(size=(_N_WAVES, 3))
    waves = 2 * np.pi * directions / wavelengths_m
    return np.sqrt(2.0 / _N_WAVES) * np.cos(places @ waves.T + phases) @ amplitudes
