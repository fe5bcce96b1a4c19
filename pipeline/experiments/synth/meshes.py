"""Triangle meshes and the simple surfaces that things are put together from: grids, tubes, walls.

Leaves to others: what is made of them (`buildings`, `plants`), and what a simulator makes of that (`twin`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ....stages.arrays import FloatArray, IndexArray

UP = np.array([0.0, 0.0, 1.0])


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


NOTHING = Mesh(np.empty((0, 3)), np.empty((0, 3), dtype=np.intp), np.empty(0))


def join(meshes: Sequence[Mesh]) -> Mesh:
    """One mesh of several; vertices and faces in their order."""
    if not meshes:
        return NOTHING
    first = np.cumsum([0] + [len(mesh.vertices) for mesh in meshes[:-1]])
    return Mesh(
        np.concatenate([mesh.vertices for mesh in meshes]),
        np.concatenate([mesh.faces + start for mesh, start in zip(meshes, first, strict=True)]),
        np.concatenate([mesh.reflectivity for mesh in meshes]),
    )


def grid(points: FloatArray, reflectivity: float, *, closed: bool = False) -> Mesh:
    """The surface through a grid of points, two triangles a cell.

    Parameters
    ----------
    points : (a, b, 3) float64, metres
    closed : the last column is joined to the first
    """
    a, b = points.shape[:2]
    ids = np.arange(a * b).reshape(a, b)
    if closed:
        ids = np.column_stack([ids, ids[:, 0]])
    p, q, r, s = (of.ravel() for of in (ids[:-1, :-1], ids[:-1, 1:], ids[1:, 1:], ids[1:, :-1]))
    faces = np.concatenate([np.column_stack([p, q, r]), np.column_stack([p, r, s])])
    return Mesh(points.reshape(-1, 3), faces, np.full(len(faces), reflectivity))


def tube(start: FloatArray, end: FloatArray, radii_m: tuple[float, float], reflectivity: float, sides: int = 7) -> Mesh:
    """A tapered tube, cut into pieces of about a metre and open at its ends."""
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
    return grid(start + share * along + radius * ring, reflectivity, closed=True)


def wall(line: FloatArray, width_m: float, height_m: float, reflectivity: float) -> Mesh:
    """A wall of equal height along a line of feet, with a top and closed ends."""
    across = left_of(line)
    profile = [(-0.5, -0.3), (-0.5, height_m / 2), (-0.5, height_m), (0.5, height_m), (0.5, height_m / 2), (0.5, -0.3)]
    rows = np.stack([line + share * width_m * across + z * UP for share, z in profile], axis=1)
    ends = [grid(rows[end, [[0, 1, 2], [5, 4, 3]]], reflectivity) for end in (0, -1)]
    return join([grid(rows, reflectivity), *ends])


def left_of(line: FloatArray) -> FloatArray:
    """Unit vectors to the left of a line, level."""
    along = np.gradient(line[:, :2], axis=0)
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    return np.column_stack([-along[:, 1], along[:, 0], np.zeros(len(line))])
