"""Estimates of the flaws of one pair: each compares the simulated scan, without its displacement, with the real one."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from ..arrays import BoolArray, FloatArray, IndexArray
from ..inspect.sensor_description import describe_sensor, sensor_row
from ..inspect.surfels import fit_planes
from .motion import PARAMETERS, Displacement, fit_displacement

Sensor = Mapping[str, Any]

#: Amount that is not a cause: returns lost at random are lost evenly.
UNEVEN = "unevenness of returns"
#: Returns beyond this range are far.
FAR_M = 25.0
#: Simulated returns nearer than this, without a real counterpart, are clutter.
CLUTTER_M = 6.0
_CELL_DEG = 2.0
_DOUBTFUL_BEAMS = 3
_FEWEST = 5  # returns of a cell
_ALIKE = 0.1  # relative difference of the median ranges of a cell in which both sides see one surface
_APART_M, _APART_PER_M = 0.25, 0.01  # a point without a counterpart is farther than this, and this times its range
_CLUSTER_M, _CLUSTER = 0.6, 5  # a piece: other points without a counterpart around one, at 6 m and beyond
_MOVED_M = 1.5  # from a missing to an invented piece
_FEWEST_FAR = 100  # far returns
_LEAVES, _FEWEST_LEAVES, _LEAF_SPREAD_M = 20, 50, 1.0
SCATTERED = 0.1  # l3 / l1 of foliage, and more
_RAY_DEG, _LEAF_STEP_M = 0.4, 0.3
_AROUND = 8  # neighbours in direction
_SMOOTH = 0.01  # relative residual of inverse ranges on smooth surface
_STRAY_M, _STRAY_STDS = 0.15, 6.0
_SECTOR_DEG, _SECTOR_POINTS = 5, 10


@dataclass(frozen=True)
class Side:
    """A side's clean points with what is derived from them once.

    points : (n, 3) float64, metres
    is_ground, range_m : (n,)
    cell : (n,) direction, by cells of 2 degrees
    """

    points: FloatArray
    is_ground: BoolArray
    range_m: FloatArray
    cell: IndexArray

    @property
    def rays(self) -> FloatArray:
        """(n, 3) directions."""
        return self.points / self.range_m[:, None]

    @classmethod
    def of(cls, points: FloatArray, is_ground: BoolArray) -> Side:
        """A side from its points."""
        range_m = np.maximum(np.linalg.norm(points, axis=1), 1e-9)
        azimuth = np.degrees(np.arctan2(points[:, 1], points[:, 0])) + 180.0
        elevation = np.degrees(np.arcsin(points[:, 2] / range_m)) + 90.0
        n_around = round(360.0 / _CELL_DEG)
        cell = (elevation // _CELL_DEG).astype(np.intp) * n_around + (azimuth // _CELL_DEG).astype(np.intp) % n_around
        return cls(points, is_ground, range_m, cell)

    def without(self, is_left_out: BoolArray) -> Side:
        """The side without some points."""
        keep = ~is_left_out
        return Side(self.points[keep], self.is_ground[keep], self.range_m[keep], self.cell[keep])


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


def find_unmatched(a: Side, b: Side, step_deg: float = 0.0) -> tuple[Unmatched, Unmatched]:
    """Points of both sides that are farther from the other side than 0.25 m and 1 % of their range.

    Road is not moved: it is seen where an object is missing.
    """
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
class PairScans:
    """The clean points of a pair, metres, in the real sensor's frame, and what is known of the sensors.

    real, sim : (n, 3), (m, 3) float64
    real_is_ground, sim_is_ground : (n,), (m,) bool
    sensors : columns of table `sensor` of both sides
    """

    real: FloatArray
    sim: FloatArray
    real_is_ground: BoolArray
    sim_is_ground: BoolArray
    sensors: tuple[Sensor, Sensor]

    @property
    def by_side(self) -> dict[str, FloatArray]:
        """The points of both sides."""
        return {"real": self.real, "sim": self.sim}

    def sides(self, displacement: Displacement) -> tuple[Side, Side]:
        """Both sides, the simulated one without its displacement."""
        sim = displacement.undo(self.sim, self.sim_is_ground)
        return Side.of(self.real, self.real_is_ground), Side.of(sim, self.sim_is_ground)


@dataclass(frozen=True)
class PairEstimates:
    """Estimates of one pair.

    displacement : of the simulated side
    sensors : of both sides, the simulated one as it is without the displacement
    amounts : by name of the cause, simulated minus real, 0 without the flaw; those that cannot be estimated are left
        out
    """

    displacement: Displacement
    sensors: tuple[Sensor, Sensor]
    amounts: dict[str, float]

    @property
    def step_deg(self) -> float:
        """The wider azimuth step of both sensors; 0 if unknown."""
        return max(side["azimuth_step_deg"] or 0.0 for side in self.sensors)


def estimate(scans: PairScans) -> PairEstimates | None:
    """Estimate the flaws of one pair; None if the scans have too little surface in common."""
    displacement = fit_displacement(scans.real, scans.sim, scans.real_is_ground)
    if displacement is None:
        return None
    real, sim = scans.sides(displacement)
    real_sensor, sim_sensor = scans.sensors
    n_real, n_sim = (side["n_beams"] or 0.0 for side in scans.sensors)
    if n_real and abs(n_sim - n_real) > _DOUBTFUL_BEAMS:  # a displaced scan has blurred beams
        again = sensor_row(describe_sensor(sim.points))
        sim_sensor = {**sim_sensor, "n_beams": again["n_beams"] or sim_sensor["n_beams"]} if n_sim else again
    found = PairEstimates(displacement, (real_sensor, sim_sensor), {})
    found.amounts.update(_amounts(real, sim, found))
    return found


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
    moved = fit_displacement(floor.sim, scans.sim, floor.sim_is_ground)
    if moved is None:
        return dict(of_floor)
    return {**of_floor, **dict(zip(PARAMETERS, (found.displacement.values - moved.values).tolist(), strict=True))}


def _amounts(a: Side, b: Side, found_so_far: PairEstimates) -> dict[str, float]:
    """The amounts of a pair whose simulated side is without its displacement."""
    sensors, displacement, step_deg = found_so_far.sensors, found_so_far.displacement, found_so_far.step_deg
    found: dict[str, float] = dict(zip(PARAMETERS, displacement.values.tolist(), strict=True))
    for name, column in (("beams", "n_beams"), ("azimuth step", "azimuth_step_deg")):
        real, sim = (side[column] for side in sensors)
        if real is not None and sim is not None:
            found[name] = sim - real
    real, sim = (noise_without_steps(side) for side in sensors)
    if real is not None and sim is not None:
        found["range noise"] = sim - real
    if sensors[1]["n_beams"]:
        found["range steps"] = (sensors[1]["range_quantum_m"] or 0.0) - (sensors[0]["range_quantum_m"] or 0.0)
    missing, invented = find_unmatched(a, b, step_deg)
    found |= _losses(
        a.without(missing.is_piece | missing.is_moved | missing.is_beyond),
        b.without(invented.is_piece | invented.is_moved),
        _density(sensors),
    )
    _, step_m = foliage_steps(a, b)
    if len(step_m) >= _FEWEST_LEAVES:
        found["solid foliage"] = float((step_m < -_LEAF_STEP_M).mean() - (step_m > _LEAF_STEP_M).mean())
    found["maximum range"] = float(b.range_m.max() - a.range_m.max())
    found["minimum range"] = float(np.quantile(b.range_m, 0.001) - np.quantile(a.range_m, 0.001))
    found["moved pieces"] = float(missing.is_moved.mean())
    found["missing pieces"] = float(missing.is_piece.mean())
    found["invented pieces"] = float(invented.is_piece.mean())
    found["clutter"] = float(invented.is_clutter.mean())
    found["mixed pixels"] = _stray_share(b) - _stray_share(a)
    found["blind sector"] = _blind_deg(a, b)
    return found


def noise_without_steps(sensor: Sensor) -> float | None:
    """Range noise of a sensor without that of rounding to its range steps, q / sqrt(12)."""
    noise_m, step_m = sensor["range_noise_m"], sensor["range_quantum_m"] or 0.0
    return None if noise_m is None else float(np.sqrt(max(noise_m**2 - step_m**2 / 12, 0.0)))


def _density(sensors: tuple[Sensor, Sensor]) -> float:
    """Firings of the simulated sensor per firing of the real one."""
    real, sim = (side["azimuth_step_deg"] for side in sensors)
    return real / sim if real and sim else 1.0


def _losses(a: Side, b: Side, density: float) -> dict[str, float]:
    """Share of the returns lost within 25 m, and the further share lost beyond, on surface that both sides see."""
    n_cells = int(max(a.cell.max(), b.cell.max())) + 1
    n_real, n_sim = (np.bincount(side.cell, minlength=n_cells) for side in (a, b))
    middle_real, middle_sim = (_middle_m(side, n_cells) for side in (a, b))
    with np.errstate(invalid="ignore"):
        is_alike = (n_real >= _FEWEST) & (np.abs(middle_sim - middle_real) <= _ALIKE * middle_real)
        is_far = middle_real > FAR_M
    near, far = (
        n_sim[own].sum() / max(n_real[own].sum(), 1) / density for own in (is_alike & ~is_far, is_alike & is_far)
    )
    found = {"lost returns": 1.0 - near, UNEVEN: _unevenness(n_real[is_alike], n_sim[is_alike])}
    if n_real[is_alike & is_far].sum() >= _FEWEST_FAR and near:
        found["lost far returns"] = 1.0 - far / near
    return found


def _unevenness(n_real: IndexArray, n_sim: IndexArray) -> float:
    """Variance of the share of returns between directions, beyond that of counting; at most 0 if lost at random."""
    expected = n_real * (n_sim.sum() / max(n_real.sum(), 1))
    return float((((n_sim - expected) ** 2).sum() - expected.sum()) / max((expected**2).sum(), 1.0))


def _middle_m(side: Side, n_cells: int) -> FloatArray:
    """(n_cells,) median range of the returns of each cell, NaN for none."""
    order = np.lexsort((side.range_m, side.cell))
    n = np.bincount(side.cell, minlength=n_cells)
    middle = np.full(n_cells, np.nan)
    middle[n > 0] = side.range_m[order][(np.cumsum(n) - n + n // 2)[n > 0]]
    return middle


def foliage_steps(a: Side, b: Side) -> tuple[IndexArray, FloatArray]:
    """Simulated returns in the direction of real foliage, (k,) rows, and their range minus that of the real return."""
    planes = fit_planes(a.points, a.points, _LEAVES)
    is_leaf = (planes.scattering >= SCATTERED) & (planes.variance[:, 2] < _LEAF_SPREAD_M**2)
    angle, near = cKDTree(b.rays).query(a.rays[is_leaf])
    is_met = angle < np.radians(_RAY_DEG)
    return near[is_met], b.range_m[near[is_met]] - a.range_m[is_leaf][is_met]


def is_stray(side: Side) -> tuple[BoolArray, BoolArray]:
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


def _stray_share(side: Side) -> float:
    """Share of stray returns among those on smooth surface."""
    strays, smooth = is_stray(side)
    return float(strays.sum() / max(smooth.sum(), 1))


def _blind_deg(a: Side, b: Side) -> float:
    """Degrees of azimuth in which only the real side has returns."""
    counts = [
        np.histogram(np.degrees(np.arctan2(side.points[:, 1], side.points[:, 0])), np.arange(-180, 181, _SECTOR_DEG))[0]
        for side in (a, b)
    ]
    return float(_SECTOR_DEG * ((counts[0] >= _SECTOR_POINTS) & (counts[1] == 0)).sum())
