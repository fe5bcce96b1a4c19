"""Houses, parked cars and poles as triangle meshes at their places.

Decides what each looks like. Leaves to others: plants (`plants`), where things stand (`scene`).
"""

from __future__ import annotations

import numpy as np

from ....stages.arrays import BoolArray, FloatArray
from .meshes import UP, Mesh, grid, join, tube

GLASS = 0.02
_EDGE_M = 0.01
_CAR_SIZES_M = np.array([[4.6, 1.82, 1.45], [4.0, 1.76, 1.48], [4.6, 1.88, 1.66], [5.2, 2.0, 2.1]])
#: Place along the car from its rear (share of its length) and height there (share of its height).
# fmt: off
_CAR_PROFILES = (
    ((0, 0.4), (0.01, 0.62), (0.04, 0.7), (0.16, 0.73), (0.3, 0.96), (0.42, 1), (0.55, 0.98), (0.7, 0.7), (0.85, 0.65),
     (0.96, 0.57), (1, 0.4)),
    ((0, 0.4), (0.01, 0.66), (0.05, 0.85), (0.14, 0.97), (0.3, 1), (0.52, 0.98), (0.7, 0.72), (0.85, 0.66),
     (0.96, 0.57), (1, 0.4)),
    ((0, 0.4), (0.01, 0.66), (0.06, 0.95), (0.12, 0.99), (0.35, 1), (0.54, 0.98), (0.69, 0.72), (0.86, 0.68),
     (0.97, 0.58), (1, 0.4)),
    ((0, 0.3), (0.01, 0.96), (0.03, 1), (0.3, 1), (0.6, 1), (0.74, 0.96), (0.86, 0.62), (0.96, 0.52), (1, 0.3)),
)
# fmt: on


def house(corner: FloatArray, front: FloatArray, size_m: tuple[float, float, float], reflectivity: float) -> Mesh:
    """A house with recessed windows on all sides and a gable roof.

    Parameters
    ----------
    corner : (3,) float64, foot of the front's first corner
    front : (3,) float64, unit vector along the front; the house lies on its left
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
    shell = grid(np.concatenate(points, axis=1), reflectivity, closed=True)
    is_glass = np.concatenate(recessed, axis=1).ravel()[shell.faces].all(axis=1)
    shell = Mesh(shell.vertices, shell.faces, np.where(is_glass, GLASS, shell.reflectivity))
    base = corner + eaves * UP
    ridge = base + depth / 2 * back + 0.35 * depth * UP
    edges = np.array([[base, base + length * front], [ridge, ridge + length * front]])
    rear = np.array([[base + depth * back, base + depth * back + length * front], [ridge, ridge + length * front]])
    gables = [np.array([[side, side + depth * back], [top, top]]) for side, top in zip(edges[0], edges[1], strict=True)]
    return join([shell, *(grid(part, 0.35) for part in (edges, rear, *gables))])


def car(foot: FloatArray, heading_rad: float, style: int, reflectivity: float, rng: np.random.Generator) -> Mesh:
    """A parked car: body, glass and wheels. Styles: 0 saloon, 1 hatchback, 2 estate or off-roader, 3 van."""
    length, width, height = _CAR_SIZES_M[style] * rng.uniform(0.95, 1.05, 3)
    profile = np.array(_CAR_PROFILES[style])
    x, top = (profile[:, 0] - 0.5) * length, profile[:, 1] * height
    belt = np.minimum(0.62 * height if style < 3 else 0.55 * height, top - 0.03)
    half = width / 2 * np.clip(1.08 - 1.6 * np.abs(profile[:, 0] - 0.5) ** 3, 0.0, 1.0)
    roof = half * np.where(top > belt + 0.05, 0.78, 0.92)
    y = np.stack([-0.9 * half, -half, -half, -roof - 0.04, -roof, roof, roof + 0.04, half, half, 0.9 * half], axis=1)
    low, sill, under = np.full_like(x, 0.22), np.full_like(x, 0.42), top - 0.06 * (top > belt + 0.05)
    z = np.stack([low, sill, belt, under, top, top, under, belt, sill, low], axis=1)
    body = grid(np.stack([np.broadcast_to(x[:, None], y.shape), y, z], axis=2), reflectivity, closed=True)
    middle = body.vertices[body.faces].mean(axis=1)
    in_cabin = (middle[:, 2] > 0.68 * height) & (middle[:, 2] < 0.93 * height) & (np.abs(middle[:, 0]) < 0.36 * length)
    body = Mesh(body.vertices, body.faces, np.where(in_cabin, GLASS, body.reflectivity))
    rings = body.vertices.reshape(len(x), -1, 3)
    parts = [body, *(grid(np.stack([end[:5], end[:4:-1]]), reflectivity) for end in (rings[0], rings[-1]))]
    for axle in (-0.31, 0.31):
        for side in (-1.0, 1.0):
            hub = np.array([axle * length, side * (width / 2 - 0.2), 0.32])
            parts.append(_wheel(hub, side))
    mesh = join(parts)
    cos, sin = np.cos(heading_rad), np.sin(heading_rad)
    return Mesh(
        mesh.vertices @ np.array([[cos, sin, 0.0], [-sin, cos, 0.0], [0.0, 0.0, 1.0]]) + foot,
        mesh.faces,
        mesh.reflectivity,
    )


def pole(foot: FloatArray, height_m: float, radius_m: float, arm: FloatArray | None, plate_m: float) -> Mesh:
    """A post, with the arm of a street lamp or the plate of a sign if there is one."""
    top = foot + height_m * UP
    parts = [tube(foot - 0.3 * UP, top, (radius_m, 0.8 * radius_m), 0.4, sides=8)]
    if arm is not None:
        parts.append(tube(top, top + arm, (0.7 * radius_m, 0.7 * radius_m), 0.4, sides=6))
    if plate_m > 0:
        y, z = np.meshgrid(plate_m * np.array([-0.5, 0.5]), -plate_m * np.array([0.0, 1.2]))
        parts.append(grid(top + np.stack([np.full_like(y, -radius_m), y, z], axis=2), 0.9))
    return join(parts)


def _wheel(hub: FloatArray, side: float) -> Mesh:
    """A wheel and the disc that closes it outside; it stands out of the body by two centimetres."""
    outside = hub + np.array([0.0, side * 0.22, 0.0])
    tread = tube(hub, outside, (0.31, 0.31), 0.08, sides=10)
    rim = tread.vertices[-10:]
    disc = grid(np.stack([rim, np.broadcast_to(outside, rim.shape)]), 0.3, closed=True)
    return join([tread, disc])


def _rows(eaves_m: float) -> tuple[FloatArray, BoolArray]:
    """Heights of a facade's grid lines, and which of them lie inside windows."""
    lines: list[tuple[float, bool]] = [(-0.3, False), (0.4, False)]
    for floor in range(max(1, int(eaves_m / 2.8))):
        sill, head = 2.8 * floor + 1.0, min(2.8 * floor + 2.3, eaves_m - 0.1)
        lines += [(sill, False), (sill + _EDGE_M, True), (head - _EDGE_M, True), (head, False)]
    lines.append((eaves_m, False))
    return np.array([height for height, _ in lines]), np.array([inside for _, inside in lines])


def _columns(length_m: float) -> tuple[FloatArray, BoolArray]:
    """Places of a facade's grid lines from its first corner, the last corner left out; which lie inside windows."""
    n_windows = max(1, int(length_m / 3.2))
    lines: list[tuple[float, bool]] = [(0.0, False)]
    for middle in length_m * (np.arange(n_windows) + 0.5) / n_windows:
        start, end = middle - 0.6, middle + 0.6
        lines += [(start, False), (start + _EDGE_M, True), (end - _EDGE_M, True), (end, False)]
        if end + 0.7 < length_m:
            lines.append((end + 0.5, False))
    return np.array([place for place, _ in lines]), np.array([inside for _, inside in lines])
