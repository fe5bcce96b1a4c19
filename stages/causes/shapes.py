"""Returns whose range is not that of the surface: foliage, surface that is too flat, and strays."""

from __future__ import annotations

import numpy as np

from ..arrays import BoolArray, FloatArray, IndexArray
from ..surfels import fit_planes, voxel_means
from .sides import FAR_M, PLANE_NEIGHBOURS, SCATTERED, Side

#: Neighbourhood of a shape.
SHAPE_M = 0.6
_LEAF_SPREAD_M = 1.0
_RAY_DEG = 0.4
_SHAPE_TOP_M = 2.5  # above the road, up to which shapes are compared
_SHAPE_POINTS = 10
_SHAPE_VOXEL_M = 0.1
_CURVED_M, _CURVED = 0.03, 0.15  # thickness and scattering of curved surface
_FLATTER = 0.5  # of the thickness
_SMOOTH = 0.01  # relative residual of inverse ranges on smooth surface
_STRAY_M, _STRAY_STDS = 0.15, 6.0
_RAYS_AROUND = 8  # nearest rays to which a surface is fitted


def foliage_steps(real: Side, sim: Side) -> tuple[IndexArray, FloatArray]:
    """Simulated returns in the direction of real foliage, (k,) rows, and their range minus that of the real return."""
    planes = real.object_planes
    is_leaf = (planes.scattering >= SCATTERED) & (planes.variance[:, 2] < _LEAF_SPREAD_M**2)
    leaves = real.object_rows[is_leaf]
    angle, near = sim.ray_tree.query(
        real.rays[leaves], distance_upper_bound=np.radians(_RAY_DEG)
    )
    is_met = np.isfinite(angle)
    return near[is_met], sim.range_m[near[is_met]] - real.range_m[leaves[is_met]]


def flat_shapes(real: Side, sim: Side) -> tuple[FloatArray, BoolArray]:
    """Places of curved real surface near the road, (k, 3) metres, and where the simulated surface is much flatter.

    Both sides have one point per voxel, so that the size of a neighbourhood does not depend on the density.
    """
    road_m = np.median(real.points[real.is_ground, 2]) if real.is_ground.any() else -np.inf
    is_low = real.points[:, 2] < road_m + _SHAPE_TOP_M
    is_shape = ~real.is_ground & is_low & (real.range_m < FAR_M)
    places = voxel_means(real.points[is_shape], _SHAPE_VOXEL_M)
    reach_m = FAR_M + SHAPE_M
    real_surface = voxel_means(real.points[real.range_m < reach_m], _SHAPE_VOXEL_M)
    sim_surface = voxel_means(sim.points[sim.range_m < reach_m], _SHAPE_VOXEL_M)
    shape = fit_planes(real_surface, places, PLANE_NEIGHBOURS, SHAPE_M)
    is_broad = (shape.variance[:, 1] > 0.05 * shape.variance[:, 2]) & (
        shape.scattering < _CURVED
    )
    is_curved = is_broad & (shape.variance[:, 0] > _CURVED_M**2)
    is_curved &= shape.n_neighbours >= _SHAPE_POINTS
    places = places[is_curved]
    other = fit_planes(sim_surface, places, PLANE_NEIGHBOURS, SHAPE_M)
    is_flat = other.variance[:, 0] < _FLATTER**2 * shape.variance[is_curved, 0]
    is_known = other.n_neighbours >= _SHAPE_POINTS
    return places[is_known], is_flat[is_known]


def find_strays(side: Side, rows: IndexArray) -> tuple[BoolArray, BoolArray]:
    """Of some returns, those on smooth surface whose range is not that of the surface, and all on smooth surface."""
    inverse, residual = _fit_inverse_range(side, rows)
    is_smooth = (residual < _SMOOTH) & (inverse > 0)
    if not is_smooth.any():
        return is_smooth, is_smooth
    error = np.abs(side.range_m[rows] - 1.0 / np.where(is_smooth, inverse, 1.0))
    limit_m = max(_STRAY_M, _STRAY_STDS * 1.4826 * float(np.median(error[is_smooth])))
    return is_smooth & (error > limit_m), is_smooth


def _fit_inverse_range(side: Side, rows: IndexArray) -> tuple[FloatArray, FloatArray]:
    """Inverse range of the surface in the direction of some returns, and the relative residual of the fit, (k,) each.

    The inverse range is linear over directions on a plane: it is fitted to the eight nearest directions.
    """
    ray = side.rays[rows]
    _, near = side.near_rays(rows, _RAYS_AROUND)
    offset = side.rays[near] - ray[:, None]
    level = np.cross(ray, [0.0, 0.0, 1.0])
    level /= np.maximum(np.linalg.norm(level, axis=1), 1e-9)[:, None]
    across = np.einsum("nkd,nd->nk", offset, level)
    columns = np.stack([np.ones(near.shape), across, offset[:, :, 2]], axis=2)
    inverse = (1.0 / side.range_m)[near]
    gram = columns.transpose(0, 2, 1) @ columns + 1e-9 * np.eye(3)
    fit = np.linalg.solve(gram, np.einsum("nki,nk->ni", columns, inverse)[..., None])[..., 0]
    error = np.einsum("nki,ni->nk", columns, fit) - inverse
    return fit[:, 0], np.sqrt((error**2).mean(axis=1)) * side.range_m[rows]
