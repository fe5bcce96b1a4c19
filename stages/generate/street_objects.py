"""Triangle meshes of the objects of a street: houses, walls, parked cars, poles, trees, bushes and hedges.

Coordinates are those of a straight street: x along it, y to the left, z above the ground, in
metres. Opaque surfaces are prisms, foliage is loose leaves; they are kept separate because a
digital twin treats them differently.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..arrays import FloatArray, IndexArray

#: Class names by number, as in `.label` files.
KINDS = ("ground", "wall", "car", "tree", "vegetation", "pole")
_UP = np.array([0.0, 0.0, 1.0])
_GLASS = 0.02
_WOOD = 0.3
_METAL = 0.4
_WINDOW_M = np.array([1.2, 0.12, 1.3])
_FLOOR_M = 2.8
_MAX_EDGE_M = 1.5
_SIDES = 8  # of a round pole or trunk
_CLUMPS = 9  # of leaves in a crown
_LEAF_M = 0.22  # radius of a leaf


@dataclass(frozen=True)
class Mesh:
    """Triangles.

    vertices : (v, 3) float64, metres
    faces : (f, 3) intp, rows of `vertices`
    reflectivity : (f,) float64, 0 to 1
    """

    vertices: FloatArray
    faces: IndexArray
    reflectivity: FloatArray


EMPTY_MESH = Mesh(np.empty((0, 3)), np.empty((0, 3), dtype=np.intp), np.empty(0))


@dataclass(frozen=True)
class StreetObject:
    """One object of a scene.

    kind : one of `KINDS`
    solid : opaque surfaces: walls, bodywork, wood
    leaves : loose triangles, empty for most objects
    """

    kind: str
    solid: Mesh = EMPTY_MESH
    leaves: Mesh = EMPTY_MESH

    def mesh(self) -> Mesh:
        """Opaque surfaces and leaves as one mesh."""
        return join_meshes([self.solid, self.leaves])


#: Saloon, hatchback and estate: length, width and height, and places of the rear window's foot and
#: top and of the windscreen's top and foot, shares of the length.
CAR_SHAPES = (
    ((4.6, 1.82, 1.45), (0.14, 0.3, 0.56, 0.72)),
    ((4.0, 1.76, 1.48), (0.02, 0.1, 0.54, 0.72)),
    ((4.6, 1.88, 1.66), (0.02, 0.07, 0.55, 0.7)),
)


def join_meshes(meshes: Sequence[Mesh]) -> Mesh:
    """Join meshes into one; vertices and faces keep their order."""
    faces = []
    n_vertices = 0
    for mesh in meshes:
        faces.append(mesh.faces + n_vertices)
        n_vertices += len(mesh.vertices)
    return Mesh(
        np.concatenate([mesh.vertices for mesh in meshes]),
        np.concatenate(faces),
        np.concatenate([mesh.reflectivity for mesh in meshes]),
    )


def build_grid(points: FloatArray, reflectivity: float) -> Mesh:
    """The surface through a grid of points, two triangles per cell.

    Parameters
    ----------
    points : (a, b, 3) float64, metres
    """
    ids = np.arange(points.shape[0] * points.shape[1]).reshape(points.shape[:2])
    corners = [ids[:-1, :-1], ids[:-1, 1:], ids[1:, 1:], ids[1:, :-1]]
    p, q, r, s = np.reshape(corners, (4, -1))
    faces = np.concatenate([np.column_stack([p, q, r]), np.column_stack([p, r, s])])
    return Mesh(points.reshape(-1, 3), faces, np.full(len(faces), reflectivity))


def build_prism(outline: FloatArray, sweep: FloatArray, reflectivity: float) -> Mesh:
    """A convex outline swept along a straight line, closed, with edges of at most a metre and a half.

    Parameters
    ----------
    outline : (n, 3) float64, corners
    sweep : (3,) float64, metres
    """
    from trimesh.convex import convex_hull

    hull = convex_hull(np.concatenate([outline, outline + sweep]))
    fine = hull.subdivide_to_size(_MAX_EDGE_M)
    fine.merge_vertices()
    faces = np.asarray(fine.faces, dtype=np.intp)
    return Mesh(np.asarray(fine.vertices), faces, np.full(len(faces), reflectivity))


def build_box(foot: FloatArray, size_m: FloatArray, reflectivity: float) -> Mesh:
    """An upright box.

    Parameters
    ----------
    foot : (3,) float64, centre of its base
    size_m : (3,) float64, along x, y and z
    """
    length, width, height = size_m
    corners = [[0, -1, 0], [0, 1, 0], [0, 1, 1], [0, -1, 1]]
    outline = foot + np.array(corners) * [0.0, width / 2, height]
    along = np.array([length, 0.0, 0.0])
    return build_prism(outline - along / 2, along, reflectivity)


def build_house(
    foot: FloatArray,
    size_m: FloatArray,
    street_side: int,
    reflectivity: float,
) -> Mesh:
    """A house with a gable roof, and windows in the front.

    Parameters
    ----------
    foot : (3,) float64, centre of its base
    size_m : (3,) float64, along the street, across it, and up to the eaves
    street_side : direction of the front, 1 for growing y, -1 for falling
    """
    length, depth, eaves = size_m
    gable = [[0, -1, 0], [0, 1, 0], [0, 1, 1], [0, 0, 1.7], [0, -1, 1]]
    along = np.array([length, 0.0, 0.0])
    outline = foot + np.array(gable) * [0.0, depth / 2, eaves]
    parts = [build_prism(outline - along / 2, along, reflectivity)]
    n_windows = int(length / 3.2)
    for sill in np.arange(1.0, eaves - _WINDOW_M[2], _FLOOR_M):
        for share in (np.arange(n_windows) + 0.5) / n_windows:
            place = np.array([(share - 0.5) * length, street_side * depth / 2, sill])
            parts.append(build_box(foot + place, _WINDOW_M, _GLASS))
    return join_meshes(parts)


def build_car(foot: FloatArray, shape: int, heading_rad: float, reflectivity: float) -> Mesh:
    """A parked car: a body, and a cabin of glass.

    Parameters
    ----------
    shape : index in `CAR_SHAPES`
    """
    (length, width, height), (rear, rear_top, front_top, front) = CAR_SHAPES[shape]
    belt = 0.62 * height
    bonnet = 0.95 * belt
    body = [(0.0, 0.25), (1.0, 0.25), (1.0, 0.6 * belt), (0.97, 0.85 * belt)]
    body += [(front, bonnet), (rear, belt), (0.01, 0.9 * belt)]
    cabin = [(rear, bonnet), (front, bonnet), (front_top, height), (rear_top, height)]
    parts = []
    for profile, share, shade in ((body, 1.0, reflectivity), (cabin, 0.85, _GLASS)):
        place, above = np.array(profile).T
        left = np.full(len(place), share * width / 2)
        outline = np.column_stack([(place - 0.5) * length, left, above])
        parts.append(build_prism(outline, np.array([0.0, -share * width, 0.0]), shade))
    mesh = join_meshes(parts)
    cos = np.cos(heading_rad)
    sin = np.sin(heading_rad)
    turned = mesh.vertices @ np.array([[cos, sin, 0.0], [-sin, cos, 0.0], [0.0, 0.0, 1.0]])
    return Mesh(turned + foot, mesh.faces, mesh.reflectivity)


def build_pole(foot: FloatArray, height_m: float, head_m: FloatArray) -> StreetObject:
    """A lamp or a traffic sign: a post with a box on its top.

    Parameters
    ----------
    foot : (3,) float64
    head_m : (3,) float64, size of the box
    """
    head = build_box(foot + height_m * _UP, head_m, _METAL)
    return StreetObject("pole", join_meshes([_build_post(foot, height_m, 0.07, _METAL), head]))


def _build_post(foot: FloatArray, height_m: float, radius_m: float, reflectivity: float) -> Mesh:
    """A round post, a third of a metre of it in the ground."""
    turn = 2 * np.pi * np.arange(_SIDES) / _SIDES
    circle = radius_m * np.column_stack([np.cos(turn), np.sin(turn), np.zeros(_SIDES)])
    return build_prism(foot - 0.3 * _UP + circle, (height_m + 0.3) * _UP, reflectivity)


def build_tree(foot: FloatArray, height_m: float, rng: np.random.Generator) -> StreetObject:
    """A tree: a trunk, and a crown on its upper two thirds."""
    bole_m = height_m * rng.uniform(0.25, 0.4)
    width_m = height_m * rng.uniform(0.2, 0.33)
    middle = (bole_m + height_m) / 2
    radii_m = np.array([width_m, width_m * rng.uniform(0.8, 1.2), 0.55 * (height_m - bole_m)])
    trunk = _build_post(foot, middle, 0.028 * height_m * rng.uniform(0.7, 1.3), _WOOD)
    return StreetObject("tree", trunk, build_crown(foot + middle * _UP, radii_m, rng))


def build_bush(foot: FloatArray, radius_m: float, rng: np.random.Generator) -> StreetObject:
    """A bush: a rounded clump of leaves, about twice `radius_m` high."""
    radii_m = radius_m * rng.uniform(0.8, 1.2, 3)
    crown = build_crown(foot + 0.8 * radii_m[2] * _UP, radii_m, rng)
    return StreetObject("vegetation", leaves=crown)


def build_hedge(foot: FloatArray, size_m: FloatArray, rng: np.random.Generator) -> StreetObject:
    """A clipped hedge along the street: leaves, opaque inside.

    Parameters
    ----------
    foot : (3,) float64, centre of its base
    size_m : (3,) float64, along the street, across it, and its height
    """
    core = build_box(foot, size_m - [0.3, 0.3, 0.15], 0.35)
    n_leaves = int(90 * size_m[0] * size_m[2])
    places = rng.uniform(-0.5, 0.5, (n_leaves, 3)) * size_m
    leaves = _scatter_leaves(foot + size_m[2] / 2 * _UP + places, rng)
    return StreetObject("vegetation", core, leaves)


def build_crown(centre: FloatArray, radii_m: FloatArray, rng: np.random.Generator) -> Mesh:
    """Foliage in an ellipsoid: clumps of leaves, about two leaves deep along a line of sight."""
    area_m2 = np.pi * radii_m[0] * (radii_m[1] + radii_m[2])
    n_leaves = int(np.clip(1.4 * area_m2 / _LEAF_M**2, 40, 4000))
    clumps = 0.62 * _in_ball(_CLUMPS, rng)
    places = clumps[rng.integers(_CLUMPS, size=n_leaves)] + 0.42 * _in_ball(n_leaves, rng)
    return _scatter_leaves(centre + places * radii_m, rng)


def _scatter_leaves(places: FloatArray, rng: np.random.Generator) -> Mesh:
    """One triangle at each place, in a random direction.

    Parameters
    ----------
    places : (n, 3) float64, metres
    """
    corners = rng.normal(size=(len(places), 3, 3))
    corners *= _LEAF_M / np.linalg.norm(corners, axis=2, keepdims=True)
    vertices = (places[:, None] + corners).reshape(-1, 3)
    faces = np.arange(len(vertices)).reshape(-1, 3)
    return Mesh(vertices, faces, np.full(len(places), rng.uniform(0.25, 0.5)))


def _in_ball(n: int, rng: np.random.Generator) -> FloatArray:
    """(n, 3) float64, random points in the unit ball."""
    directions = rng.normal(size=(n, 3))
    lengths = np.linalg.norm(directions, axis=1, keepdims=True)
    return np.asarray(directions / lengths * np.cbrt(rng.uniform(size=(n, 1))))
