"""Triangle meshes of the objects of a street: houses, parked cars, poles, trees, bushes and hedges.

First meshes and their parts (grids, tubes, walls), then the objects. Wood is a welded mesh, foliage is loose leaves;
they are kept separate because a digital twin treats them differently.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ...schemas.data_files import read_data
from ..arrays import BoolArray, FloatArray, IndexArray

#: Class names by number, as in `.label` files.
KINDS = ("ground", "wall", "car", "tree", "vegetation", "pole")
UP = np.array([0.0, 0.0, 1.0])
GLASS = 0.02
_EDGE_M = 0.01
_CARS = [*read_data("cars").values()]
_LEAF_AREA = 0.72  # mean area of a triangle with three random corners on the unit sphere, in squared radii


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

    def range_m(self) -> float:
        """Distance of the mean of its vertices from the sensor, metres."""
        return float(np.linalg.norm(np.concatenate([self.solid.vertices, self.leaves.vertices]).mean(axis=0)))


def join_meshes(meshes: Sequence[Mesh]) -> Mesh:
    """Join meshes into one; vertices and faces keep their order."""
    first = np.cumsum([0] + [len(mesh.vertices) for mesh in meshes[:-1]])
    return Mesh(
        np.concatenate([mesh.vertices for mesh in meshes]),
        np.concatenate([mesh.faces + start for mesh, start in zip(meshes, first, strict=True)]),
        np.concatenate([mesh.reflectivity for mesh in meshes]),
    )


def build_grid(points: FloatArray, reflectivity: float, *, closed: bool = False) -> Mesh:
    """The surface through a grid of points, two triangles per cell.

    Parameters
    ----------
    points : (a, b, 3) float64, metres
    closed : the last column is connected to the first
    """
    a, b = points.shape[:2]
    ids = np.arange(a * b).reshape(a, b)
    if closed:
        ids = np.column_stack([ids, ids[:, 0]])
    p, q, r, s = (corner.ravel() for corner in (ids[:-1, :-1], ids[:-1, 1:], ids[1:, 1:], ids[1:, :-1]))
    faces = np.concatenate([np.column_stack([p, q, r]), np.column_stack([p, r, s])])
    return Mesh(points.reshape(-1, 3), faces, np.full(len(faces), reflectivity))


def build_tube(
    start: FloatArray, end: FloatArray, radii_m: tuple[float, float], reflectivity: float, sides: int = 7
) -> Mesh:
    """A tapered tube in segments of about a metre, open at its ends.

    Parameters
    ----------
    start, end : (3,) float64, metres, different
    radii_m : at the start and at the end
    sides : of the cross section
    """
    along = end - start
    length = float(np.linalg.norm(along))
    x, y, z = along / length
    side = np.array([y, -x, 0.0] if abs(z) < 0.9 else [0.0, z, -y])
    side /= np.linalg.norm(side)
    other = np.array([y * side[2] - z * side[1], z * side[0] - x * side[2], x * side[1] - y * side[0]])
    turn = 2 * np.pi * np.arange(sides) / sides
    ring = np.cos(turn)[:, None] * side + np.sin(turn)[:, None] * other
    share = np.linspace(0.0, 1.0, max(2, int(length) + 1))[:, None, None]
    radius = radii_m[0] + share * (radii_m[1] - radii_m[0])
    return build_grid(start + share * along + radius * ring, reflectivity, closed=True)


def build_wall(line: FloatArray, width_m: float, height_m: float, reflectivity: float) -> Mesh:
    """A wall of equal height along a line of feet, with a top and closed ends.

    Parameters
    ----------
    line : (n, 3) float64, metres, n at least 2
    """
    across = left_of(line)
    profile = [(-0.5, -0.3), (-0.5, height_m / 2), (-0.5, height_m), (0.5, height_m), (0.5, height_m / 2), (0.5, -0.3)]
    rows = np.stack([line + share * width_m * across + z * UP for share, z in profile], axis=1)
    ends = [build_grid(rows[end, [[0, 1, 2], [5, 4, 3]]], reflectivity) for end in (0, -1)]
    return join_meshes([build_grid(rows, reflectivity), *ends])


def left_of(line: FloatArray) -> FloatArray:
    """(n, 3) float64, horizontal unit vectors to the left of a line.

    Parameters
    ----------
    line : (n, 3) float64, metres, n at least 2, no two neighbours above each other
    """
    along = np.gradient(line[:, :2], axis=0)
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    return np.column_stack([-along[:, 1], along[:, 0], np.zeros(len(line))])


def build_house(corner: FloatArray, front: FloatArray, size_m: tuple[float, float, float], reflectivity: float) -> Mesh:
    """A house with recessed windows on all sides and a gable roof.

    Parameters
    ----------
    corner : (3,) float64, foot of the front's first corner
    front : (3,) float64, unit vector along the front; the house is on its left
    size_m : length of the front, depth, height of the eaves
    """
    length, depth, eaves = size_m
    back = np.array([-front[1], front[0], 0.0])
    heights, in_storey = _rows(eaves)
    points, recessed = [], []
    foot = corner
    for along, extent in ((front, length), (back, depth), (-front, length), (-back, depth)):
        inward = np.array([-along[1], along[0], 0.0])
        places, in_window = _columns(extent)
        sunk = in_storey[:, None] & in_window
        flat = foot + places[None, :, None] * along + heights[:, None, None] * UP
        points.append(flat + 0.2 * sunk[..., None] * inward)
        recessed.append(sunk)
        foot = foot + extent * along
    shell = build_grid(np.concatenate(points, axis=1), reflectivity, closed=True)
    is_glass = np.concatenate(recessed, axis=1).ravel()[shell.faces].all(axis=1)
    shell = Mesh(shell.vertices, shell.faces, np.where(is_glass, GLASS, shell.reflectivity))
    base = corner + eaves * UP
    ridge = base + depth / 2 * back + 0.35 * depth * UP
    edges = np.array([[base, base + length * front], [ridge, ridge + length * front]])
    rear = np.array([[base + depth * back, base + depth * back + length * front], [ridge, ridge + length * front]])
    gables = [np.array([[side, side + depth * back], [top, top]]) for side, top in zip(edges[0], edges[1], strict=True)]
    return join_meshes([shell, *(build_grid(part, 0.35) for part in (edges, rear, *gables))])


def build_car(foot: FloatArray, heading_rad: float, style: int, reflectivity: float, rng: np.random.Generator) -> Mesh:
    """A parked car: body, glass and wheels. Styles as in `cars.toml`: 0 saloon, 1 hatchback, 2 estate, 3 van."""
    length, width, height = _CARS[style]["size_m"] * rng.uniform(0.95, 1.05, 3)
    profile = np.array(_CARS[style]["profile"])
    x, top = (profile[:, 0] - 0.5) * length, profile[:, 1] * height
    belt = np.minimum(0.62 * height if style < 3 else 0.55 * height, top - 0.03)
    half = width / 2 * np.clip(1.08 - 1.6 * np.abs(profile[:, 0] - 0.5) ** 3, 0.0, 1.0)
    roof = half * np.where(top > belt + 0.05, 0.78, 0.92)
    y = np.stack([-0.9 * half, -half, -half, -roof - 0.04, -roof, roof, roof + 0.04, half, half, 0.9 * half], axis=1)
    low, sill, under = np.full_like(x, 0.22), np.full_like(x, 0.42), top - 0.06 * (top > belt + 0.05)
    z = np.stack([low, sill, belt, under, top, top, under, belt, sill, low], axis=1)
    body = build_grid(np.stack([np.broadcast_to(x[:, None], y.shape), y, z], axis=2), reflectivity, closed=True)
    middle = body.vertices[body.faces].mean(axis=1)
    in_cabin = (middle[:, 2] > 0.68 * height) & (middle[:, 2] < 0.93 * height) & (np.abs(middle[:, 0]) < 0.36 * length)
    body = Mesh(body.vertices, body.faces, np.where(in_cabin, GLASS, body.reflectivity))
    rings = body.vertices.reshape(len(x), -1, 3)
    parts = [body, *(build_grid(np.stack([end[:5], end[:4:-1]]), reflectivity) for end in (rings[0], rings[-1]))]
    for axle in (-0.31, 0.31):
        for side in (-1.0, 1.0):
            hub = np.array([axle * length, side * (width / 2 - 0.2), 0.32])
            parts.append(_build_wheel(hub, side))
    mesh = join_meshes(parts)
    cos, sin = np.cos(heading_rad), np.sin(heading_rad)
    return Mesh(
        mesh.vertices @ np.array([[cos, sin, 0.0], [-sin, cos, 0.0], [0.0, 0.0, 1.0]]) + foot,
        mesh.faces,
        mesh.reflectivity,
    )


def build_pole(foot: FloatArray, height_m: float, radius_m: float, arm: FloatArray | None, plate_m: float) -> Mesh:
    """A post, with the arm of a street lamp or the plate of a sign if given."""
    top = foot + height_m * UP
    parts = [build_tube(foot - 0.3 * UP, top, (radius_m, 0.8 * radius_m), 0.4, sides=8)]
    if arm is not None:
        parts.append(build_tube(top, top + arm, (0.7 * radius_m, 0.7 * radius_m), 0.4, sides=6))
    if plate_m > 0:
        y, z = np.meshgrid(plate_m * np.array([-0.5, 0.5]), -plate_m * np.array([0.0, 1.2]))
        parts.append(build_grid(top + np.stack([np.full_like(y, -radius_m), y, z], axis=2), 0.9))
    return join_meshes(parts)


def _build_wheel(hub: FloatArray, side: float) -> Mesh:
    """A wheel and the disc that closes it; it protrudes from the body by two centimetres."""
    outside = hub + np.array([0.0, side * 0.22, 0.0])
    tread = build_tube(hub, outside, (0.31, 0.31), 0.08, sides=10)
    rim = tread.vertices[-10:]
    disc = build_grid(np.stack([rim, np.broadcast_to(outside, rim.shape)]), 0.3, closed=True)
    return join_meshes([tread, disc])


def _rows(eaves_m: float) -> tuple[FloatArray, BoolArray]:
    """Heights of a facade's grid lines, and True for those inside windows."""
    lines: list[tuple[float, bool]] = [(-0.3, False), (0.4, False)]
    for floor in range(max(1, int(eaves_m / 2.8))):
        sill, head = 2.8 * floor + 1.0, min(2.8 * floor + 2.3, eaves_m - 0.1)
        lines += [(sill, False), (sill + _EDGE_M, True), (head - _EDGE_M, True), (head, False)]
    lines.append((eaves_m, False))
    return np.array([height for height, _ in lines]), np.array([inside for _, inside in lines])


def _columns(length_m: float) -> tuple[FloatArray, BoolArray]:
    """Offsets of a facade's grid lines from its first corner, without the last one, and True for those in windows."""
    n_windows = max(1, int(length_m / 3.2))
    lines: list[tuple[float, bool]] = [(0.0, False)]
    for middle in length_m * (np.arange(n_windows) + 0.5) / n_windows:
        start, end = middle - 0.6, middle + 0.6
        lines += [(start, False), (start + _EDGE_M, True), (end - _EDGE_M, True), (end, False)]
        if end + 0.7 < length_m:
            lines.append((end + 0.5, False))
    return np.array([place for place, _ in lines]), np.array([inside for _, inside in lines])


def build_tree(foot: FloatArray, height_m: float, leaf_m: float, rng: np.random.Generator) -> tuple[Mesh, Mesh]:
    """A tree: trunk and branches, and the foliage.

    Parameters
    ----------
    foot : (3,) float64, metres
    leaf_m : radius of a leaf
    """
    bole = height_m * rng.uniform(0.25, 0.4)
    radius = 0.028 * height_m * rng.uniform(0.7, 1.3)
    width = height_m * rng.uniform(0.2, 0.33)
    centre = foot + np.array([*rng.normal(0.0, 0.03 * height_m, 2), (height_m + bole) / 2])
    fork = foot + bole * UP
    wood = [build_tube(foot - 0.3 * UP, fork, (1.15 * radius, 0.85 * radius), 0.3)]
    half = np.array([width, width * rng.uniform(0.8, 1.2), (height_m - bole) / 2 * 1.1])
    tips = centre + 0.7 * _in_ball(6, 0.3, rng) * half
    wood += [build_tube(fork, tip, (0.5 * radius, 0.15 * radius), 0.3, sides=5) for tip in tips]
    wood.append(build_tube(fork, centre, (0.8 * radius, 0.3 * radius), 0.3))
    return join_meshes(wood), build_crown(centre, half, leaf_m, rng)


def build_bush(foot: FloatArray, radius_m: float, leaf_m: float, rng: np.random.Generator) -> Mesh:
    """A bush: a rounded clump of leaves, about twice `radius_m` high.

    Parameters
    ----------
    foot : (3,) float64, metres
    leaf_m : radius of a leaf
    """
    radii = radius_m * np.array([1.0, rng.uniform(0.7, 1.3), rng.uniform(0.8, 1.2)])
    return build_crown(foot + 0.8 * radii[2] * UP, radii, leaf_m, rng)


def build_hedge(line: FloatArray, width_m: float, height_m: float, leaf_m: float, rng: np.random.Generator) -> Mesh:
    """A clipped hedge along a line of feet: leaves in its outer layer, opaque inside.

    Parameters
    ----------
    line : (n, 3) float64, metres, one point every metre or so
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
    core = build_wall(line, width_m - 0.3, height_m - 0.15, reflectivity)
    cut = scatter_leaves(places, leaf_m, reflectivity, rng)
    return join_meshes([cut, core])


def build_crown(centre: FloatArray, radii_m: FloatArray, leaf_m: float, rng: np.random.Generator) -> Mesh:
    """Foliage in an ellipsoid: clumps of leaves, denser towards the rim, about two leaves deep along a line of sight.

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
    return scatter_leaves(centre + places * radii_m, leaf_m, float(rng.uniform(0.25, 0.5)), rng)


def scatter_leaves(places: FloatArray, size_m: float, reflectivity: float, rng: np.random.Generator) -> Mesh:
    """One triangle at each place, with corners at a distance of `size_m` in random directions.

    Parameters
    ----------
    places : (n, 3) float64, metres
    """
    corners = rng.normal(size=(len(places), 3, 3))
    corners *= size_m / np.linalg.norm(corners, axis=2, keepdims=True)
    vertices = (places[:, None] + corners).reshape(-1, 3)
    return Mesh(vertices, np.arange(len(vertices)).reshape(-1, 3), np.full(len(places), reflectivity))


def _in_ball(n: int, power: float, rng: np.random.Generator) -> FloatArray:
    """(n, 3) float64, random points in the unit ball; uniform for a power of 1/3, denser at the rim for less."""
    direction = rng.normal(size=(n, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    radius: FloatArray = rng.uniform(size=(n, 1)) ** power
    return direction * radius
