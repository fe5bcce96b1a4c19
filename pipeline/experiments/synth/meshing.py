"""What becomes of a surface that is measured by a moving scanner and meshed: blurred, rounded, thickened, merged.

Pure functions of meshes. Leaves to others: which thing suffers which of them, and how much (`twin`).
"""

from __future__ import annotations

import numpy as np

from ....stages.arrays import FloatArray, IndexArray
from .meshes import NOTHING, Mesh

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


def smooth_field(places: FloatArray, rng: np.random.Generator) -> FloatArray:
    """A random vector at each place, of unit variance an axis, that varies over 2 to 30 metres.

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
    field: FloatArray = np.sqrt(2.0 / n_waves) * np.cos(places @ waves.T + phases) @ amplitudes
    return field


def rounded(mesh: Mesh, times: int = 1) -> Mesh:
    """The mesh with each vertex moved half the way to the mean of its neighbours, so many times."""
    a, b = np.concatenate([mesh.faces[:, [0, 1]], mesh.faces[:, [1, 2]], mesh.faces[:, [2, 0]]]).T
    ends, others = np.concatenate([a, b]), np.concatenate([b, a])
    degree = np.maximum(np.bincount(ends, minlength=len(mesh.vertices)), 1)[:, None]
    vertices = mesh.vertices
    for _ in range(times):
        vertices = (vertices + _sums(ends, vertices[others], len(vertices)) / degree) / 2
    return Mesh(vertices, mesh.faces, mesh.reflectivity)


def thickened(mesh: Mesh, by_m: float) -> Mesh:
    """The mesh with each vertex pushed out along its normal."""
    a, b, c = (mesh.vertices[mesh.faces[:, corner]] for corner in range(3))
    of_faces = np.cross(b - a, c - a)
    normals = _sums(mesh.faces.ravel(), np.repeat(of_faces, 3, axis=0), len(mesh.vertices))
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    return Mesh(mesh.vertices + by_m * normals, mesh.faces, mesh.reflectivity)


def torn(mesh: Mesh, share: float, rng: np.random.Generator) -> Mesh:
    """The mesh with holes, a few metres wide, where about this share of its faces was.

    The faces are left out where a wave field is highest.
    """
    if not len(mesh.faces):
        return mesh
    height = smooth_field(mesh.vertices[mesh.faces].mean(axis=1), rng)[:, 0]
    holds = height <= np.quantile(height, 1.0 - share * rng.uniform(0.0, 2.0))
    return Mesh(mesh.vertices, mesh.faces[holds], mesh.reflectivity[holds])


def within(mesh: Mesh, range_m: float) -> Mesh:
    """The faces whose middle is at most so far from the sensor."""
    near = np.linalg.norm(mesh.vertices[mesh.faces].mean(axis=1), axis=1) <= range_m
    return Mesh(mesh.vertices, mesh.faces[near], mesh.reflectivity[near])


def merged(leaves: Mesh, cell_m: float, swollen: float, rng: np.random.Generator) -> Mesh:
    """A closed, lumpy surface around loose triangles: the border of the cells that they occupy, smoothed.

    Parameters
    ----------
    leaves : loose triangles
    cell_m : edge of a cell
    swollen : share of the occupied cells from which a random neighbour is taken in as well
    """
    if not len(leaves.faces):
        return NOTHING
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
    return rounded(Mesh(vertices, faces, np.full(len(faces), leaves.reflectivity[0])), times=3)


def _sums(ids: IndexArray, rows: FloatArray, n: int) -> FloatArray:
    """(n, 3) float64, sum of the rows of each id."""
    return np.column_stack([np.bincount(ids, rows[:, axis], n) for axis in range(3)])
