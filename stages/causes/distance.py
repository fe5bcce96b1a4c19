"""Distance between the surfaces of two scans, and that of a perfect second measurement."""

from __future__ import annotations

import numpy as np
from numpy.random import Generator
from scipy.spatial import cKDTree

from ...schemas.cause_catalogue import CAUSES
from ..arrays import FloatArray, IndexArray
from ..linalg.nearest import search_tree
from ..surfels import fit_planes
from .sides import SCATTERED, Side, most_noise_m

#: Distances to the other side count up to this.
REACH_M = 1.0
_SAMPLE = 4000
_NEIGHBOURS = 16
_AROUND = 2  # nearest rays that another ray may lie next to
#: Cosine between ray and normal from which on a turned ray meets the same plane; of the ground within some 11 m.
_LEAST_TOWARD, _LEAST_TOWARD_GROUND = 0.1, 0.15
_OFF_STDS, _LEAST_STD_M = 3.0, 0.02  # of a flat surface, from which a point is off


def surface_distance(real: cKDTree, sim: cKDTree) -> float:
    """Mean distance to the other side, counted up to 1 m, averaged over both directions; metres.

    It is also the mean uncovered share over all reaches from 0 to 1 m, since the integral of P(d > r) over r in
    [0, 1 m] is the mean of min(d, 1 m). Of both sides, every k-th point is used, 4000 at most.

    Parameters
    ----------
    real, sim : search trees of the points of both sides, metres; the simulated side may have none
    """
    if not sim.n:
        return REACH_M
    to_sim = distances(sim, real.data[sample_rows(real.n)])
    to_real = distances(real, sim.data[sample_rows(sim.n)])
    return (float(to_sim.mean()) + float(to_real.mean())) / 2


def distances(tree: cKDTree, points: FloatArray) -> FloatArray:
    """(n,) metres, distance of each point to the nearest of a tree, counted up to 1 m."""
    apart_m, _ = tree.query(points, distance_upper_bound=REACH_M)
    return np.minimum(apart_m, REACH_M)


def best_case_distance(real: Side, sim: Side, aligned: Side, rng: Generator) -> float:
    """Surface distance of a perfect second measurement of the real scan, with rays like the simulated ones; metres.

    Real rays are turned in random directions by the angle between the simulated rays and the real ones: the median,
    with or without the displacement, whichever is smaller, as small displacements are errors of the fit; and at most
    half of the angle between real rays. Their returns are moved along the ray by the range noise of the real sensor, or
    of the simulated one as far as that is within the tolerance, and lost in the share that the real sensor loses. So
    neither the spacing of points nor the noise of a measurement counts as a difference.

    Parameters
    ----------
    sim, aligned : the simulated side, and without its displacement
    """
    rows = sample_rows(len(real.points))
    rays = real.rays[rows]
    steps = [float(np.median(side.ray_tree.query(rays)[0])) for side in (sim, aligned)]
    chord, _ = real.near_rays(rows, 1)
    step = min(*steps, float(np.median(chord)) / 2)
    moved = _by_other_rays(real, step, rng)
    real_noise_m = real.sensor.range_noise_m or 0.0
    sim_noise_m = most_noise_m(aligned.sensor)
    noise_m = min(
        max(sim_noise_m, real_noise_m), real_noise_m + CAUSES["range noise"].tolerance
    )
    moved += real.rays * rng.normal(0.0, noise_m, len(moved))[:, None]
    is_kept = rng.random(len(moved)) >= (real.sensor.lost_share or 0.0)
    return surface_distance(real.tree, search_tree(moved[is_kept]))


def sample_rows(n: int) -> IndexArray:
    """Every k-th row of n, 4000 at most."""
    return np.arange(0, n, n // _SAMPLE + 1)


def _by_other_rays(side: Side, step: float, rng: Generator) -> FloatArray:
    """(n, 3) returns of rays that are turned by an angle, radians, in random directions.

    On the plane of an object, and on the ground near the sensor, they lie in it. Elsewhere, as in foliage, a ray
    between two others sees what either of them sees: its range is that of a neighbouring ray, the more often the nearer
    it comes to the middle.
    """
    random = rng.normal(size=side.points.shape)
    across = random - (random * side.rays).sum(axis=1, keepdims=True) * side.rays
    across /= np.maximum(np.linalg.norm(across, axis=1), 1e-9)[:, None]
    toward = (side.rays * side.normals).sum(axis=1)
    least = np.where(side.is_ground, _LEAST_TOWARD_GROUND, _LEAST_TOWARD)
    is_plane = np.abs(toward) > least  # NaN is not
    # the ray turns across by a small angle: it meets the plane where the offset along the ray cancels that along n
    along_ray = np.zeros(len(toward))
    np.divide(-(across * side.normals).sum(axis=1), toward, out=along_ray, where=is_plane)
    direction = across + along_ray[:, None] * side.rays
    returns: FloatArray = side.points + direction * (step * side.range_m)[:, None]
    rows = np.flatnonzero(~is_plane)
    chord, near = side.near_rays(rows, _AROUND)
    chosen = np.arange(len(rows)), rng.integers(_AROUND, size=len(rows))
    is_other = rng.random(len(rows)) < 2 * step / np.maximum(chord[chosen], 1e-9)
    others = rows[is_other]
    ratio = side.range_m[near[chosen][is_other]] / side.range_m[others]
    returns[others] *= ratio[:, None]
    return returns


def off_share(a: FloatArray, b: FloatArray) -> float:
    """Share of the flat surface of two scans that the other has elsewhere, averaged over both directions.

    A point is off if the plane through the 16 nearest points of the other scan is farther than three times their
    standard deviation, and 6 cm. It does not depend on which rays both scans have; points more than 1 m from the mean
    of those neighbours, and neighbours that are scattered or on a line, do not count. Of both, every k-th point is
    used, 4000 at most.
    """
    return (_off_share_of(a, b) + _off_share_of(b, a)) / 2


def _off_share_of(points: FloatArray, other: FloatArray) -> float:
    chosen = points[sample_rows(len(points))]
    planes = fit_planes(other, chosen, _NEIGHBOURS)
    offset = chosen - planes.mean
    is_flat = (
        (planes.scattering < SCATTERED)
        & ~planes.is_line
        & ((offset**2).sum(axis=1) < REACH_M**2)
    )
    limit_m = _OFF_STDS * np.maximum(np.sqrt(planes.variance[:, 0]), _LEAST_STD_M)
    is_off = np.abs((offset * planes.normal).sum(axis=1)) > limit_m
    return float(is_off[is_flat].mean()) if is_flat.any() else 0.0
