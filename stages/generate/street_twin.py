"""A flawed digital twin of a street: the geometry of a simulator, and the density of its points.

The paper's twin (sections "Data Collection" and "Real experiments") is a mesh of the street made from registered scans.
Its flaws: surfaces displaced and rounded, thin objects thickened, foliage merged into lumps or missing at a distance,
distant objects missing, surfaces invented near foliage and between distant objects, and densities above or below
those of the real sensor.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..arrays import FloatArray, sums_by_id
from .street_objects import EMPTY_MESH, Mesh, StreetObject, build_grid, join_meshes

DENSITY_BOUNDS = (0.1, 8.0)
GROUND_REACH_M = 45.0
_FOLIAGE = ("tree", "vegetation")
_SIDES = np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]])
#: Corners of the square between a cell and its neighbour on each side, in cells from the cell's own corner.
_SQUARES = np.array(
    [
        [[1, 0, 0], [1, 1, 0], [1, 1, 1], [1, 0, 1]],
        [[0, 0, 0], [0, 0, 1], [0, 1, 1], [0, 1, 0]],
        [[0, 1, 0], [0, 1, 1], [1, 1, 1], [1, 1, 0]],
        [[0, 0, 0], [1, 0, 0], [1, 0, 1], [0, 0, 1]],
        [[0, 0, 1], [1, 0, 1], [1, 1, 1], [0, 1, 1]],
        [[0, 0, 0], [0, 1, 0], [1, 1, 0], [1, 0, 0]],
    ]
)


@dataclass(frozen=True)
class TwinSurface:
    """Surface of an object in the twin, or invented surface next to it.

    object_id : index of the object in the scene
    mesh : its surface
    density : points per beam of the sensor that hits it
    """

    object_id: int
    mesh: Mesh
    density: float


def build_twin(objects: Sequence[StreetObject], rng: np.random.Generator) -> tuple[TwinSurface, ...]:
    """The flawed surfaces of a scene's objects; objects missing in the twin have none.

    Parameters
    ----------
    objects : the scene, sensor frame
    rng : source of all flaws
    """
    surfaces = []
    for object_id, each in enumerate(objects):
        mesh = _remesh(each, rng)
        if len(mesh.faces):
            surfaces.append(TwinSurface(object_id, mesh, _draw_density(each, rng)))
    surfaces += _invent_sheets(objects, surfaces, rng)
    return _displace(objects, surfaces, rng)


def _draw_density(item: StreetObject, rng: np.random.Generator) -> float:
    """Points per beam: mostly too few nearby, and the more variable the farther away the object is."""
    if item.kind == "ground":
        return 0.8
    far = min(item.range_m() / 40.0, 1.0)
    return float(np.clip(rng.lognormal(-0.6, 0.4 + 0.8 * far), *DENSITY_BOUNDS))


def _remesh(item: StreetObject, rng: np.random.Generator) -> Mesh:
    """The object after meshing; empty if it is lost."""
    if item.kind == "ground":
        return crop(item.solid, GROUND_REACH_M)
    range_m = item.range_m()
    is_lost = rng.uniform() < np.clip((range_m - 25.0) / 80.0, 0.0, 0.5)
    is_bare = rng.uniform() < np.clip((range_m - 12.0) / 35.0, 0.0, 0.9)
    is_lost |= is_bare and item.kind == "tree" and rng.uniform() < 0.5
    if is_lost or (is_bare and item.kind == "vegetation"):
        return EMPTY_MESH
    parts = []
    if len(item.solid.faces):
        is_thin = item.kind in ("pole", "tree")
        solid = thicken(item.solid, 0.04 + 0.002 * range_m) if is_thin else smooth_mesh(item.solid)
        parts.append(tear_holes(solid, float(np.clip(0.03 + 0.003 * range_m, 0.0, 0.25)), rng))
    if not is_bare:
        parts.append(merge_leaves(item.leaves, 0.28 + 0.005 * range_m, 0.25, rng.spawn(1)[0]))
    return join_meshes(parts)


def _invent_sheets(
    objects: Sequence[StreetObject], surfaces: Sequence[TwinSurface], rng: np.random.Generator
) -> Iterator[TwinSurface]:
    """Sheets hanging from foliage, and sheets between neighbours far from the sensor."""
    upright = [part for part in surfaces if objects[part.object_id].kind != "ground"]
    middles = np.array([part.mesh.vertices.mean(axis=0) for part in upright]).reshape(-1, 3)
    for part, middle in zip(upright, middles, strict=True):
        range_m = float(np.linalg.norm(middle))
        if objects[part.object_id].kind in _FOLIAGE and rng.uniform() < 0.5:
            upper = _draw_edge(part.mesh, rng)
            lower = upper + rng.normal(0.0, 0.5, 3) - [0.0, 0.0, rng.uniform(0.6, 2.0)]
            yield TwinSurface(part.object_id, _span_sheet(upper, lower), rng.uniform(0.5, 2.0))
        apart = np.linalg.norm(middles - middle, axis=1)
        near = np.flatnonzero((apart > 0) & (apart < 8.0))
        if len(near) and rng.uniform() < np.clip((range_m - 12.0) / 60.0, 0.0, 0.5):
            other = upright[int(rng.choice(near))]
            yield TwinSurface(
                part.object_id,
                _span_sheet(_draw_edge(part.mesh, rng), _draw_edge(other.mesh, rng)),
                rng.uniform(0.5, 2.0),
            )


def _draw_edge(mesh: Mesh, rng: np.random.Generator) -> FloatArray:
    """(2, 3) float64, two random vertices of a mesh."""
    return mesh.vertices[rng.integers(len(mesh.vertices), size=2)]


def _span_sheet(start: FloatArray, end: FloatArray) -> Mesh:
    """The surface spanned by two edges, subdivided so that it can be bent."""
    share = np.linspace(0.0, 1.0, 6)
    rails = [edge[0] + share[:, None] * (edge[1] - edge[0]) for edge in (start, end)]
    return build_grid(rails[0] + share[:, None, None] * (rails[1] - rails[0]), 0.3)


def _displace(
    objects: Sequence[StreetObject], surfaces: Sequence[TwinSurface], rng: np.random.Generator
) -> tuple[TwinSurface, ...]:
    """All surfaces shifted by one smooth random field of centimetres near the sensor and decimetres far away.

    The ground, which the scanner has passed over, is displaced by the same few centimetres everywhere.
    """
    vertices = np.concatenate([part.mesh.vertices for part in surfaces])
    is_passed = np.concatenate([np.full(len(c.mesh.vertices), objects[c.object_id].kind == "ground") for c in surfaces])
    error_m = 0.05 + 0.004 * np.where(is_passed, 0.0, np.linalg.norm(vertices, axis=1))[:, None]
    shifted = vertices + error_m * smooth_field(vertices, rng) * np.array([1.0, 1.0, 0.25])
    ends = np.cumsum([len(part.mesh.vertices) for part in surfaces])
    parts = zip(surfaces, np.split(shifted, ends[:-1]), strict=True)
    return tuple(replace(part, mesh=replace(part.mesh, vertices=own)) for part, own in parts)


def smooth_field(places: FloatArray, rng: np.random.Generator) -> FloatArray:
    """A random vector at each place, of unit variance on each axis, that varies over 2 to 30 metres.

    F(x) = sqrt(2 / m) sum_k a_k cos(q_k . x + phi_k), m = 24 waves in random directions.

    Parameters
    ----------
    places : (n, 3) float64, metres
    """
    n_waves = 24
    direction = rng.normal(size=(n_waves, 3))
    wavelength = 2.0 * 15.0 ** rng.uniform(size=(n_waves, 1))
    waves = 2 * np.pi * direction / np.linalg.norm(direction, axis=1, keepdims=True) / wavelength
    phases = rng.uniform(0.0, 2 * np.pi, n_waves)
    amplitudes = rng.normal(size=(n_waves, 3))
    return np.sqrt(2.0 / n_waves) * np.cos(places @ waves.T + phases) @ amplitudes


def smooth_mesh(mesh: Mesh, times: int = 1) -> Mesh:
    """The mesh with each vertex moved half way to the mean of its neighbours, `times` times."""
    a, b = np.concatenate([mesh.faces[:, [0, 1]], mesh.faces[:, [1, 2]], mesh.faces[:, [2, 0]]]).T
    ends, others = np.concatenate([a, b]), np.concatenate([b, a])
    degree = np.maximum(np.bincount(ends, minlength=len(mesh.vertices)), 1)[:, None]
    vertices = mesh.vertices
    for _ in range(times):
        vertices = (vertices + sums_by_id(vertices[others], ends, len(vertices)) / degree) / 2
    return Mesh(vertices, mesh.faces, mesh.reflectivity)


def thicken(mesh: Mesh, by_m: float) -> Mesh:
    """The mesh with each vertex pushed out along its normal; a vertex without a face stays."""
    a, b, c = (mesh.vertices[mesh.faces[:, corner]] for corner in range(3))
    face_normals = np.cross(b - a, c - a)
    normals = sums_by_id(np.repeat(face_normals, 3, axis=0), mesh.faces.ravel(), len(mesh.vertices))
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    return Mesh(mesh.vertices + by_m * normals, mesh.faces, mesh.reflectivity)


def tear_holes(mesh: Mesh, share: float, rng: np.random.Generator) -> Mesh:
    """The mesh with holes, a few metres wide, that take about this share of its faces.

    Faces are removed at the maxima of a random wave field.
    """
    height = smooth_field(mesh.vertices[mesh.faces].mean(axis=1), rng)[:, 0]
    holds = height <= np.quantile(height, 1.0 - share * rng.uniform(0.0, 2.0))
    return Mesh(mesh.vertices, mesh.faces[holds], mesh.reflectivity[holds])


def crop(mesh: Mesh, range_m: float) -> Mesh:
    """The faces whose centre is within `range_m` of the sensor."""
    near = np.linalg.norm(mesh.vertices[mesh.faces].mean(axis=1), axis=1) <= range_m
    return Mesh(mesh.vertices, mesh.faces[near], mesh.reflectivity[near])


def merge_leaves(leaves: Mesh, cell_m: float, swollen: float, rng: np.random.Generator) -> Mesh:
    """A closed, lumpy surface around loose triangles: the border of the cells that they occupy, smoothed.

    Empty without triangles.

    Parameters
    ----------
    leaves : loose triangles
    cell_m : edge of a cell
    swollen : share of the occupied cells that also take in a random neighbour
    """
    if not len(leaves.faces):
        return EMPTY_MESH
    centres = leaves.vertices[leaves.faces].mean(axis=1)
    origin = rng.uniform(0.0, cell_m, 3)
    cells = np.unique(np.floor((centres - origin) / cell_m).astype(np.int64), axis=0)
    growing = cells[rng.uniform(size=len(cells)) < swollen]
    cells = np.unique(np.concatenate([cells, growing + _SIDES[rng.integers(6, size=len(growing))]]), axis=0)
    low = cells.min(axis=0) - 1
    shape = cells.max(axis=0) - low + 3
    occupied = np.zeros(shape, dtype=np.bool_)
    occupied[tuple((cells - low).T)] = True
    squares = []
    for side, square in zip(_SIDES, _SQUARES, strict=True):
        open_to = cells[~occupied[tuple((cells - low + side).T)]]
        squares.append(open_to[:, None] + square)
    corners = np.concatenate(squares) - low
    numbers = np.ravel_multi_index(tuple(corners.reshape(-1, 3).T), tuple(shape + 1))
    kept, ids = np.unique(numbers, return_inverse=True)
    vertices = (np.stack(np.unravel_index(kept, tuple(shape + 1)), axis=1) + low) * cell_m + origin
    p, q, r, s = ids.reshape(-1, 4).T
    faces = np.concatenate([np.column_stack([p, q, r]), np.column_stack([p, r, s])])
    return smooth_mesh(Mesh(vertices, faces, np.full(len(faces), leaves.reflectivity[0])), times=3)
