"""Estimates of the flaws of one pair: each compares the simulated scan, without its displacement, with the real one."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from scipy.spatial import cKDTree
from sklearn.linear_model import PoissonRegressor

from ..arrays import BoolArray, FloatArray, IndexArray
from ..displacement import PARAMETERS, Displacement, fit_displacement
from ..sensor_description import describe_sensor, sensor_row
from ..surfels import LocalPlanes, fit_planes, voxel_means

Sensor = Mapping[str, Any]

#: Amount that is not a cause: variance of the share of returns between directions, beyond that of counting and of the
#: fit of the losses; at most 0 if they are lost at random.
UNEVEN = "unevenness of returns"
#: Amount: share of curved real surface where the simulated surface is much flatter.
FLAT = "flat shapes"
#: Returns beyond this range are far.
FAR_M = 25.0
#: Returns at a larger angle to the normal of the surface are grazing.
GRAZING_DEG = 75.0
#: Simulated returns nearer than this, without a real counterpart, are clutter.
CLUTTER_M = 6.0
_CELL_DEG = 2.0
_DOUBTFUL_BEAMS, _BLURRED_DEG = 3, 0.005
_BLUR, _JITTER = "elevation_noise_deg", "azimuth_noise_deg"
_OF_SENSOR = {
    "beams": "n_beams",
    "azimuth step": "azimuth_step_deg",
    "elevation noise": _BLUR,
    "azimuth noise": _JITTER,
}
_FEWEST = 5  # returns of a cell
_ALIKE = 0.1  # relative difference of the median ranges of a cell in which both sides see one surface
_APART_M, _APART_PER_M = 0.25, 0.01  # a point without a counterpart is farther than this, and this times its range
_CLUSTER_M, _CLUSTER = 0.6, 5  # a piece: other points without a counterpart around one, at 6 m and beyond
_MOVED_M = 1.5  # from a missing to an invented piece
_KINDS = ("lost far returns", "lost grazing returns")
#: Causes that lose a share of the returns: over a floor, of what the floor returns.
LOSSES = ("lost returns", *_KINDS)
_FEWEST_OF_KIND = 100  # returns, far or grazing
_LEAVES, _FEWEST_LEAVES, _LEAF_SPREAD_M = 20, 50, 1.0
SCATTERED = 0.1  # l3 / l1 of foliage, and more
_RAY_DEG, _LEAF_STEP_M = 0.4, 0.3
#: Neighbourhood of a shape.
SHAPE_M = 0.6
_SHAPE_TOP_M = 2.5  # above the road, up to which shapes are compared
_SHAPE_POINTS, _SHAPE_VOXEL_M = 10, 0.1
_CURVED_M, _CURVED, _FLATTER = 0.03, 0.15, 0.5  # thickness and scattering of curved surface; of which flat is less
_AROUND = 8  # neighbours in direction
_SMOOTH = 0.01  # relative residual of inverse ranges on smooth surface
_STRAY_M, _STRAY_STDS = 0.15, 6.0
_SECTOR_DEG, _SECTOR_POINTS = 5, 10


class Side:
    """Clean points of a side with what is derived from them.

    points : (n, 3) float64, metres, in the real sensor's frame
    is_ground, range_m, azimuth_deg, elevation_deg : (n,)
    rays : (n, 3) directions
    sensor : columns of table `sensor`
    """

    def __init__(self, points: FloatArray, is_ground: BoolArray, sensor: Sensor) -> None:
        self.points, self.is_ground, self.sensor = points, is_ground, sensor
        self.range_m: FloatArray = np.maximum(np.linalg.norm(points, axis=1), 1e-9)
        self.rays = points / self.range_m[:, None]
        self.azimuth_deg = np.degrees(np.arctan2(points[:, 1], points[:, 0]))
        self.elevation_deg = np.degrees(np.arcsin(self.rays[:, 2]))

    @cached_property
    def planes(self) -> LocalPlanes:
        """Planes through the neighbours of each point."""
        return fit_planes(self.points, self.points, _LEAVES)

    @cached_property
    def incidence_deg(self) -> FloatArray:
        """(n,) angle between the ray and the normal of its plane, of road to the vertical; NaN on no plane."""
        is_plane = (self.planes.scattering < SCATTERED) & ~self.planes.is_line
        normal = np.where(self.is_ground[:, None], [0.0, 0.0, 1.0], self.planes.normal)
        angle = np.degrees(np.arccos(np.minimum(np.abs((normal * self.rays).sum(axis=1)), 1.0)))
        return np.where(self.is_ground | is_plane, angle, np.nan)

    def concerned(self, cause: str) -> BoolArray:
        """(n,) True for the returns of which a cause loses some: far ones, grazing ones, or all."""
        if cause == "lost far returns":
            return self.range_m > FAR_M
        return self.incidence_deg > GRAZING_DEG if cause == "lost grazing returns" else self.range_m > 0


@dataclass(frozen=True)
class PairScans:
    """Both sides of a pair."""

    real: Side
    sim: Side


@dataclass(frozen=True)
class Unmatched:
    """Points without a counterpart on the other side, by kind; (n,) bool over the points of a side.

    is_beyond : farther than the other side ever returns
    is_clutter : near the sensor
    is_piece : others, in groups
    is_moved : those of objects that have one of the other side next to them
    """

    is_beyond: BoolArray
    is_clutter: BoolArray
    is_piece: BoolArray
    is_moved: BoolArray


def find_unmatched(a: Side, b: Side) -> tuple[Unmatched, Unmatched]:
    """Points of both sides that are farther from the other side than 0.25 m and 1 % of their range or an azimuth step.

    Road is not moved: it is seen where an object is missing.
    """
    step_deg = max(side.sensor["azimuth_step_deg"] or 0.0 for side in (a, b))
    found = _unmatched(a, b, step_deg), _unmatched(b, a, step_deg)
    objects = [own.is_piece & ~side.is_ground for side, own in zip((a, b), found, strict=True)]
    others = b.points[objects[1]], a.points[objects[0]]
    for own, side, is_object, points in zip(found, (a, b), objects, others, strict=True):
        apart, _ = cKDTree(points).query(side.points[is_object], distance_upper_bound=_MOVED_M)
        own.is_moved[is_object] = np.isfinite(apart)
        own.is_piece[own.is_moved] = False
    return found


def _unmatched(side: Side, other: Side, step_deg: float) -> Unmatched:
    apart, _ = cKDTree(other.points).query(side.points)
    is_apart = apart > _APART_M + max(_APART_PER_M, np.radians(step_deg)) * side.range_m
    is_beyond = side.range_m > other.range_m.max()
    is_piece = is_apart & ~is_beyond
    rows = np.flatnonzero(is_piece)
    n_near = cKDTree(side.points[rows]).query_ball_point(side.points[rows], _CLUSTER_M, return_length=True)
    is_piece[rows] = n_near > _CLUSTER * np.maximum(CLUTTER_M / side.range_m[rows], 1.0) ** 2
    is_clutter = is_apart & ~is_piece & (side.range_m < CLUTTER_M)
    return Unmatched(is_beyond, is_clutter, is_piece, np.zeros(len(is_piece), np.bool_))


@dataclass(frozen=True)
class PairEstimates:
    """Estimates of one pair.

    displacement : of the simulated side
    sensor : of the simulated side, as it is without the displacement
    amounts : by name of the cause, simulated minus real, 0 without the flaw; those that cannot be estimated are left
        out
    """

    displacement: Displacement
    sensor: Sensor
    amounts: dict[str, float]

    def undisplaced(self, sim: Side) -> Side:
        """The simulated side without its displacement."""
        return Side(self.displacement.undo(sim.points, sim.is_ground), sim.is_ground, self.sensor)


def estimate(scans: PairScans) -> PairEstimates | None:
    """Estimate the flaws of one pair; None if the scans have too little surface in common."""
    displacement = fit_displacement(scans.real.points, scans.sim.points, scans.real.is_ground)
    if displacement is None:
        return None
    found = PairEstimates(displacement, scans.sim.sensor, {})
    sim = found.undisplaced(scans.sim)
    n_real, n_sim = (side.sensor["n_beams"] or 0.0 for side in (scans.real, sim))
    if n_real and abs(n_sim - n_real) > _DOUBTFUL_BEAMS:  # a displaced scan has blurred beams
        again = sensor_row(describe_sensor(sim.points))
        sim.sensor = {**sim.sensor, "n_beams": again["n_beams"] or n_sim} if n_sim else again
    moved = dict(zip(PARAMETERS, displacement.values.tolist(), strict=True))
    return PairEstimates(displacement, sim.sensor, moved | _amounts(scans.real, sim))


def amounts_of_floor(
    found: PairEstimates, scans: PairScans, floor: PairScans, of_floor: Mapping[str, float]
) -> dict[str, float]:
    """Amounts to subtract from those of a pair: of its floor, except for displacements.

    These are fitted between both simulated scans, of which most surface is the same, so that the difference is far more
    accurate than that of two displacements against the real scan.

    Parameters
    ----------
    of_floor : amounts of the pair of the floor
    """
    moved = fit_displacement(floor.sim.points, scans.sim.points, floor.sim.is_ground)
    if moved is None:
        return dict(of_floor)
    return dict(of_floor) | dict(zip(PARAMETERS, (found.displacement.values - moved.values).tolist(), strict=True))


def _amounts(a: Side, b: Side) -> dict[str, float]:
    """The amounts of a pair whose simulated side is without its displacement, but for the displacement."""
    missing, invented = find_unmatched(a, b)
    strays = [is_stray.sum() / max(is_smooth.sum(), 1) for is_stray, is_smooth in map(find_strays, (a, b))]
    found = {
        "maximum range": b.range_m.max() - a.range_m.max(),
        "minimum range": np.quantile(b.range_m, 0.001) - np.quantile(a.range_m, 0.001),
        "moved pieces": missing.is_moved.mean(),
        "missing pieces": missing.is_piece.mean(),
        "invented pieces": invented.is_piece.mean(),
        "clutter": invented.is_clutter.mean(),
        "mixed pixels": strays[1] - strays[0],
        "blind sector": _blind_deg(a, b),
        **_losses(
            a, b, ~(missing.is_piece | missing.is_moved | missing.is_beyond), ~(invented.is_piece | invented.is_moved)
        ),
    }
    _, step_m = foliage_steps(a, b)
    if len(step_m) >= _FEWEST_LEAVES:
        found["solid foliage"] = (step_m < -_LEAF_STEP_M).mean() - (step_m > _LEAF_STEP_M).mean()
    _, is_flat = flat_shapes(a, b)
    if len(is_flat) >= _FEWEST_LEAVES:
        found[FLAT] = is_flat.mean()
    if b.sensor["n_beams"]:
        found["range steps"] = (b.sensor["range_quantum_m"] or 0.0) - (a.sensor["range_quantum_m"] or 0.0)
    of_sensor = {name: [side.sensor[column] for side in (a, b)] for name, column in _OF_SENSOR.items()}
    of_sensor["range noise"] = [noise_without_steps(side.sensor) for side in (a, b)]
    found |= {name: sim - real for name, (real, sim) in of_sensor.items() if real is not None and sim is not None}
    return {name: float(amount) for name, amount in found.items()}


def noise_without_steps(sensor: Sensor) -> float | None:
    """Range noise of a sensor without that of rounding to its range steps, q / sqrt(12)."""
    noise_m, step_m = sensor["range_noise_m"], sensor["range_quantum_m"] or 0.0
    return None if noise_m is None else float(np.sqrt(max(noise_m**2 - step_m**2 / 12, 0.0)))


def _losses(a: Side, b: Side, is_used_a: BoolArray, is_used_b: BoolArray) -> dict[str, float]:
    """Share of the returns lost within 25 m at less than 75 degrees, and the further shares lost beyond each.

    Shares of returns by cell of direction on surface that both sides see, fitted by Poisson regression with a
    logarithmic link: the shares that remain are multiplied.
    """
    real, sim = (side.sensor["azimuth_step_deg"] for side in (a, b))
    firings = real / sim if real and sim else 1.0  # of the simulated sensor per firing of the real one
    (n_real, range_m, n_kinds), (n_sim, sim_range_m, _) = _by_cell(a, is_used_a), _by_cell(b, is_used_b)
    is_alike = (n_real >= _FEWEST) & (n_sim > 0) & (np.abs(sim_range_m - range_m) <= _ALIKE * range_m)
    n_real, n_sim, kinds = n_real[is_alike], n_sim[is_alike], {}
    for name, n_all in n_kinds.items():
        share = n_all[is_alike] / n_real
        n_in = n_real[share > 0.5].sum()
        if min(n_in, n_real.sum() - n_in) >= _FEWEST_OF_KIND:
            kinds[name] = share
    if not len(n_real):
        return {UNEVEN: 0.0}
    columns = np.column_stack([*kinds.values()]) if kinds else np.zeros((len(n_real), 1))
    fit = PoissonRegressor(alpha=0.0, tol=1e-8, max_iter=1000).fit(columns, n_sim / n_real / firings, n_real)
    found = dict(zip(kinds, (1.0 - np.exp(fit.coef_)).tolist(), strict=False))
    expected = n_real * firings * fit.predict(columns)
    unevenness = (((n_sim - expected) ** 2).sum() - expected.sum()) / max((expected**2).sum(), 1.0)
    return found | {"lost returns": 1.0 - float(np.exp(fit.intercept_)), UNEVEN: float(unevenness)}


def _by_cell(side: Side, is_used: BoolArray) -> tuple[IndexArray, FloatArray, dict[str, IndexArray]]:
    """By cell of 2 degrees of direction: number of used returns, their median range (longer of two), number by kind."""
    used = np.flatnonzero(is_used)
    rows, columns = (side.elevation_deg[used] + 90.0) // _CELL_DEG, (side.azimuth_deg[used] + 180.0) // _CELL_DEG
    n_around = round(360.0 / _CELL_DEG)
    cell = (rows * n_around + columns % n_around).astype(np.intp)
    n_cells, range_m = n_around * (n_around // 2 + 1), side.range_m[used]
    n = np.bincount(cell, minlength=n_cells)
    middle = np.minimum(np.cumsum(n) - n + n // 2, len(cell) - 1)
    by_kind = {name: np.bincount(cell[side.concerned(name)[used]], minlength=n_cells) for name in _KINDS}
    return n, range_m[np.lexsort((range_m, cell))][middle], by_kind


def foliage_steps(a: Side, b: Side) -> tuple[IndexArray, FloatArray]:
    """Simulated returns in the direction of real foliage, (k,) rows, and their range minus that of the real return."""
    is_leaf = (a.planes.scattering >= SCATTERED) & (a.planes.variance[:, 2] < _LEAF_SPREAD_M**2)
    angle, near = cKDTree(b.rays).query(a.rays[is_leaf])
    is_met = angle < np.radians(_RAY_DEG)
    return near[is_met], b.range_m[near[is_met]] - a.range_m[is_leaf][is_met]


def flat_shapes(a: Side, b: Side) -> tuple[FloatArray, BoolArray]:
    """Places of curved real surface near the road, (k, 3) metres, and where the simulated surface is much flatter.

    Both sides have one point per voxel, so that the size of a neighbourhood does not depend on the density.
    """
    road_m = np.median(a.points[a.is_ground, 2]) if a.is_ground.any() else -np.inf
    is_shape = ~a.is_ground & (a.points[:, 2] < road_m + _SHAPE_TOP_M) & (a.range_m < FAR_M)
    places = voxel_means(a.points[is_shape], _SHAPE_VOXEL_M)
    surfaces = [voxel_means(side.points[side.range_m < FAR_M + SHAPE_M], _SHAPE_VOXEL_M) for side in (a, b)]
    mine, other = (fit_planes(points, places, _LEAVES, SHAPE_M) for points in surfaces)
    is_known = np.minimum(mine.n_neighbours, other.n_neighbours) >= _SHAPE_POINTS
    is_broad = (mine.variance[:, 1] > 0.05 * mine.variance[:, 2]) & (mine.scattering < _CURVED)
    is_curved = is_known & is_broad & (mine.variance[:, 0] > _CURVED_M**2)
    return places[is_curved], other.variance[is_curved, 0] < _FLATTER**2 * mine.variance[is_curved, 0]


def find_strays(side: Side) -> tuple[BoolArray, BoolArray]:
    """Returns on smooth surface whose range is not that of the surface, and all returns on smooth surface.

    The inverse range is linear over directions on a plane: it is fitted to the eight nearest directions.
    """
    ray = side.rays
    _, near = cKDTree(ray).query(ray, k=_AROUND + 1)
    near = near[:, 1:]
    off = ray[near] - ray[:, None]
    level = np.cross(ray, [0.0, 0.0, 1.0])
    level /= np.maximum(np.linalg.norm(level, axis=1), 1e-9)[:, None]
    columns = np.stack([np.ones(near.shape), np.einsum("nkd,nd->nk", off, level), off[:, :, 2]], axis=2)
    inverse = 1.0 / side.range_m
    gram = np.einsum("nki,nkj->nij", columns, columns) + 1e-9 * np.eye(3)
    fit = np.linalg.solve(gram, np.einsum("nki,nk->ni", columns, inverse[near])[..., None])[..., 0]
    residual = np.sqrt(((np.einsum("nki,ni->nk", columns, fit) - inverse[near]) ** 2).mean(axis=1)) * side.range_m
    is_smooth = (residual < _SMOOTH) & (fit[:, 0] > 0)
    if not is_smooth.any():
        return is_smooth, is_smooth
    error = np.abs(side.range_m - 1.0 / np.where(is_smooth, fit[:, 0], 1.0))
    limit_m = max(_STRAY_M, _STRAY_STDS * 1.4826 * float(np.median(error[is_smooth])))
    return is_smooth & (error > limit_m), is_smooth


def _blind_deg(a: Side, b: Side) -> float:
    """Degrees of azimuth in which only the real side has returns."""
    edges = np.arange(-180, 181, _SECTOR_DEG)
    n_real, n_sim = (np.histogram(side.azimuth_deg, edges)[0] for side in (a, b))
    return float(_SECTOR_DEG * ((n_real >= _SECTOR_POINTS) & (n_sim == 0)).sum())
