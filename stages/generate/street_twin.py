"""A flawed digital twin of a street: the geometry of a simulator, and the density of its points.

The paper's twin (sections "Data Collection" and "Real experiments") is a mesh of the street made
from registered scans. Its flaws: surfaces displaced and rounded, thin objects thickened, foliage
merged into lumps or missing at a distance, distant objects missing, surfaces invented near foliage
and between distant objects, and densities above or below those of the real sensor.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..arrays import BoolArray, FloatArray
from .street_objects import EMPTY_MESH, Mesh, StreetObject, build_grid, join_meshes

_DENSITY_BOUNDS = (0.1, 8.0)
_GROUND_REACH_M = 45.0
_NEIGHBOUR_M = 8.0  # surfaces are invented between objects at most so far apart
_N_WAVES = 24
_MAX_ROUNDING_M = 0.1
_FOLIAGE = ("tree", "vegetation")


@dataclass(frozen=True)
class TwinSurface:
    """Surface of an object in the twin, or invented surface next to it.

    object_id : index of the object in the scene
    kind : of that object
    mesh : its surface
    density : points per beam of the sensor that hits it
    """

    object_id: int
    kind: str
    mesh: Mesh
    density: float


def build_twin(
    objects: Sequence[StreetObject],
    rng: np.random.Generator,
) -> tuple[TwinSurface, ...]:
    """The flawed surfaces of a scene's objects; objects missing in the twin have none.

    Parameters
    ----------
    objects : the scene, sensor frame
    rng : source of all flaws
    """
    surfaces = []
    for object_id, item in enumerate(objects):
        range_m = float(np.linalg.norm(item.mesh().vertices.mean(axis=0)))
        if item.kind == "ground":
            near = np.linalg.norm(_face_centres(item.solid), axis=1) <= _GROUND_REACH_M
            mesh = _keep_faces(item.solid, near)
            density = 0.8
        else:
            mesh = _remesh(item, range_m, rng)
            spread = 0.4 + 0.8 * min(range_m / 40.0, 1.0)  # mostly too few points nearby
            density = float(np.clip(rng.lognormal(-0.6, spread), *_DENSITY_BOUNDS))
        if len(mesh.faces):
            surfaces.append(TwinSurface(object_id, item.kind, mesh, density))
    surfaces += _invent_sheets(surfaces, rng)
    return _displace(surfaces, rng)


def _remesh(item: StreetObject, range_m: float, rng: np.random.Generator) -> Mesh:
    """The object after meshing; empty if it is lost."""
    if rng.uniform() < np.clip((range_m - 25.0) / 80.0, 0.0, 0.5):
        return EMPTY_MESH
    is_bare = rng.uniform() < np.clip((range_m - 12.0) / 35.0, 0.0, 0.9)
    if is_bare and item.kind in _FOLIAGE:
        is_trunk_left = item.kind == "tree" and rng.uniform() < 0.5
        if not is_trunk_left:
            return EMPTY_MESH
    share = float(np.clip(0.03 + 0.003 * range_m, 0.0, 0.25))
    mesh = item.solid
    if len(mesh.faces):
        is_thin = item.kind in ("tree", "pole")
        mesh = _thicken(mesh, 0.04 + 0.002 * range_m) if is_thin else _round_off(mesh)
        mesh = _tear_holes(mesh, share, rng)
    if len(item.leaves.faces) and not is_bare:
        mesh = join_meshes([mesh, _merge_leaves(item.leaves, 0.2 + 0.004 * range_m)])
    return mesh


def _invent_sheets(
    surfaces: Sequence[TwinSurface],
    rng: np.random.Generator,
) -> Iterator[TwinSurface]:
    """Sheets within foliage, and sheets between neighbours far from the sensor."""
    upright = [surface for surface in surfaces if surface.kind != "ground"]
    middles = np.array([surface.mesh.vertices.mean(axis=0) for surface in upright]).reshape(-1, 3)
    for surface, middle in zip(upright, middles, strict=True):
        near = np.flatnonzero(np.linalg.norm(middles - middle, axis=1) < _NEIGHBOUR_M)
        neighbour = upright[rng.choice(near)]
        others = []
        if surface.kind in _FOLIAGE and rng.uniform() < 0.5:
            others.append(surface)
        if rng.uniform() < np.clip((np.linalg.norm(middle) - 12.0) / 60.0, 0.0, 0.5):
            others.append(neighbour)
        for other in others:
            sheet = _span_sheet(surface.mesh, other.mesh, rng)
            yield replace(surface, mesh=sheet, density=rng.uniform(0.5, 2.0))


def _span_sheet(first: Mesh, second: Mesh, rng: np.random.Generator) -> Mesh:
    """The surface spanned by two random vertices of each of two meshes, subdivided so that it can be bent."""
    share = np.linspace(0.0, 1.0, 6)[:, None]
    edges = []
    for mesh in (first, second):
        start, end = mesh.vertices[rng.integers(len(mesh.vertices), size=2)]
        edges.append(start + share * (end - start))
    left, right = edges
    return build_grid(left + share[:, None] * (right - left), 0.3)


def _displace(surfaces: Sequence[TwinSurface], rng: np.random.Generator) -> tuple[TwinSurface, ...]:
    """All surfaces shifted by one smooth random field of centimetres near the sensor and decimetres far away.

    The ground, which the scanner has passed over, is displaced by the same few centimetres
    everywhere.
    """
    whole = join_meshes([surface.mesh for surface in surfaces])
    field = _smooth_field(whole.vertices, rng) * [1.0, 1.0, 0.25]
    displaced = []
    first = 0
    for surface in surfaces:
        vertices = surface.mesh.vertices
        error_m = np.full(len(vertices), 0.05)
        if surface.kind != "ground":
            error_m += 0.004 * np.linalg.norm(vertices, axis=1)
        shift_m = error_m[:, None] * field[first : first + len(vertices)]
        mesh = replace(surface.mesh, vertices=vertices + shift_m)
        displaced.append(replace(surface, mesh=mesh))
        first += len(vertices)
    return tuple(displaced)


def _smooth_field(places: FloatArray, rng: np.random.Generator) -> FloatArray:
    """A random vector at each place, of unit variance on each axis, that varies over 2 to 30 metres.

    F(x) = sqrt(2 / m) sum_k a_k cos(q_k . x + phi_k), m = 24 waves in random directions.

    Parameters
    ----------
    places : (n, 3) float64, metres
    """
    directions = rng.normal(size=(_N_WAVES, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    wavelengths_m = 2.0 * 15.0 ** rng.uniform(size=(_N_WAVES, 1))
    phases = rng.uniform(0.0, 2 * np.pi, _N_WAVES)
    amplitudes = rng.normal(size=(_N_WAVES, 3))
    waves = 2 * np.pi * directions / wavelengths_m
    return np.sqrt(2.0 / _N_WAVES) * np.cos(places @ waves.T + phases) @ amplitudes


def _round_off(mesh: Mesh) -> Mesh:
    """The mesh with each vertex moved half way to the mean of its neighbours, but at most a decimetre per axis."""
    from trimesh import Trimesh
    from trimesh.smoothing import laplacian_calculation

    means = laplacian_calculation(Trimesh(mesh.vertices, mesh.faces, process=False)) @ mesh.vertices
    step_m = np.clip((means - mesh.vertices) / 2, -_MAX_ROUNDING_M, _MAX_ROUNDING_M)
    return replace(mesh, vertices=mesh.vertices + step_m)


def _thicken(mesh: Mesh, by_m: float) -> Mesh:
    """The mesh with each vertex pushed out along its normal."""
    from trimesh import Trimesh

    normals = Trimesh(mesh.vertices, mesh.faces, process=False).vertex_normals
    return replace(mesh, vertices=mesh.vertices + by_m * normals)


def _tear_holes(mesh: Mesh, share: float, rng: np.random.Generator) -> Mesh:
    """The mesh with holes, a few metres wide, that take about this share of its faces."""
    height = _smooth_field(_face_centres(mesh), rng)[:, 0]
    return _keep_faces(mesh, height <= np.quantile(height, 1.0 - share * rng.uniform(0.0, 2.0)))


def _face_centres(mesh: Mesh) -> FloatArray:
    """(f, 3) float64"""
    return np.asarray(mesh.vertices[mesh.faces].mean(axis=1))


def _keep_faces(mesh: Mesh, is_kept: BoolArray) -> Mesh:
    return Mesh(mesh.vertices, mesh.faces[is_kept], mesh.reflectivity[is_kept])


def _merge_leaves(leaves: Mesh, cell_m: float) -> Mesh:
    """Lumps in place of loose triangles: the cells that they occupy, rounded off."""
    from trimesh.voxel.ops import multibox

    cells = np.unique(np.floor(_face_centres(leaves) / cell_m), axis=0)
    boxes = multibox((cells + 0.5) * cell_m, cell_m)
    boxes.merge_vertices()
    reflectivity = np.full(len(boxes.faces), leaves.reflectivity[0])
    return _round_off(Mesh(boxes.vertices, boxes.faces, reflectivity))
