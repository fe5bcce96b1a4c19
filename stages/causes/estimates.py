"""Estimates of the flaws of one pair: each compares the simulated scan, without its displacement, with the real one."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import cKDTree

from ...schemas.cause_catalogue import CAUSES, FLAT, LOSSES, PARAMETERS, UNEVEN
from ..arrays import BoolArray, FloatArray, IndexArray
from ..displacement import Displacement, fit_displacement
from ..sensor_description import SensorDescription, describe_sensor
from ..surfels import fit_planes, voxel_means
from ..trust import BEAMS, FRAME, ONE_SWEEP, RETURNS, SAME_SWEEPS
from .beams import (
    blurred_elevation_deg,
    dead_beams,
    elevation_scale,
    exchanged_beams,
    grid_of,
    road_blur_deg2,
    second_returns,
)
from .distance import best_case_distance, mean_apart, sample_rows, surface_distance
from .sides import FAR_M, PLANE_NEIGHBOURS, SCATTERED, PairScans, Side, noise_bounds

#: Simulated returns nearer than this, without a real counterpart, are clutter.
CLUTTER_M = 6.0
#: A side with fewer points has no surface to compare.
LEAST_POINTS = 50
#: Neighbourhood of a shape.
SHAPE_M = 0.6
_LEAST_MOVED_M = 0.005  # mean displacement whose part in the distance is measured
_NOISY_M = 0.1  # range error that counts as a whole
_CELL_DEG = 2.0
_EDGE_DEG = 0.15  # from a beam to the edge of a cell
_DOUBTFUL_BEAMS = 3
_BEAM_MARGIN_DEG = 0.2  # beyond the outermost beams of both sides
_MANY_SECOND = 0.002  # share of second returns that are removed before anything else is estimated
_LEAST_SCALE, _BETTER = 0.004, 0.97  # elevation scale that is tried, and the distance that confirms it
_FEWEST = 5  # returns of a cell
_ALIKE = 0.1  # relative difference of the median ranges of a cell in which both sides see one surface
_APART_M, _APART_PER_M = 0.25, 0.01  # a point without a counterpart is farther than this, and this times its range
_CLUSTER_M, _CLUSTER = 0.6, 5  # a part: other points without a counterpart around one, at 6 m and beyond
_MOVED_M = 1.5  # from a missing to an invented part
_FEWEST_OF_KIND = 100  # returns, far or grazing
_FEWEST_LEAVES, _LEAF_SPREAD_M = 50, 1.0
_RAY_DEG, _LEAF_STEP_M = 0.4, 0.3
_SHAPE_TOP_M = 2.5  # above the road, up to which shapes are compared
_SHAPE_POINTS, _SHAPE_VOXEL_M = 10, 0.1
_CURVED_M, _CURVED, _FLATTER = 0.03, 0.15, 0.5  # thickness and scattering of curved surface; of which flat is less
_SMOOTH = 0.01  # relative residual of inverse ranges on smooth surface
_STRAY_M, _STRAY_STDS = 0.15, 6.0
_SECTOR_DEG, _FINE_SECTOR_DEG, _SECTOR_POINTS = 5.0, 1.0, 10
_BLIND = 0.1  # of the usual number of returns, in fine sectors
_DENSE_DEG = 0.35  # azimuth step up to which sectors are fine
_FAR_SURFACE_M, _FEWEST_FAR = 20.0, 50
_FEWEST_BEYOND = 10  # returns; fewer may be lost by chance


@dataclass(frozen=True)
class Amount:
    """Amount of one cause in one pair.

    amount : simulated minus real, 0 without the flaw; None if it cannot be known
    real, sim : values of both sides, if the cause has such
    share : share of the surface that is affected
    reason : reason why the amount is unknown
    """

    amount: float | None
    real: float | None = None
    sim: float | None = None
    share: float | None = None
    reason: str | None = None


@dataclass(frozen=True)
class Pose:
    """Pose of a simulated side relative to the real one.

    displacement : of the simulated side
    elevation_scale : by which its elevations are too large
    sensor : its sensor, as it is without the displacement
    """

    displacement: Displacement
    elevation_scale: float
    sensor: SensorDescription

    def undisplaced(self, sim: Side) -> Side:
        """The simulated side without its displacement and the scale of its elevations."""
        points = scale_elevations(sim.points, 1.0 / (1.0 + self.elevation_scale))
        points = self.displacement.undo(points, sim.is_ground)
        return Side(points, sim.is_ground, self.sensor, sim.T_real_sim)


@dataclass(frozen=True)
class PairEstimates:
    """Estimates of one pair.

    amounts : by name of the cause
    distance_m, best_case_m : surface distance of both sides, and of a perfect second measurement
    """

    pose: Pose
    amounts: dict[str, Amount]
    distance_m: float
    best_case_m: float


def estimate(scans: PairScans, seed: int = 0) -> PairEstimates | None:
    """Estimate the flaws of one pair; None if the scans have too little surface in common.

    Specific flaws come first, and take what they explain: second returns, blind directions, dead and exchanged beams
    do not count as missing, invented or lost.
    """
    if min(len(scans.real.points), len(scans.sim.points)) < LEAST_POINTS:
        return None
    doubts = doubts_of(scans.real.sensor, scans.sim.sensor)
    real, real_second_share = _without_second_returns(scans.real)
    sim, second_share = _without_second_returns(scans.sim)
    pose = fit_pose(real, sim)
    if pose is None:
        return None
    aligned = pose.undisplaced(sim)
    distance_m = surface_distance(scans.real.points, scans.sim.points, scans.real.tree)
    best_case_m = best_case_distance(scans.real, sim, aligned, np.random.default_rng(seed))
    amounts = _pose_amounts(pose, real, sim, best_case_m)
    amounts["second returns"] = _difference(real_second_share, second_share, share=second_share - real_second_share)
    amounts |= _amounts(real, aligned, sim)
    if text := _unlike_patterns(real, aligned, sim):
        doubts.setdefault(BEAMS, text)
    return PairEstimates(pose, only_known(amounts, doubts), distance_m, best_case_m)


def _unlike_patterns(real: Side, sim: Side, recorded: Side) -> str | None:
    """Reason why the returns of both sides cannot be counted per direction: beams on one side are not rings."""
    for name, rings, other, as_recorded in (("simulated", real, sim, recorded), ("real", sim, real, real)):
        grid = grid_of(rings.sensor)
        if grid and not other.sensor.elevation_deg and blurred_elevation_deg(grid, as_recorded) is None:
            return f"{name} scan: its beams are not rings, those of the other side are"
    return None


def doubts_of(real: SensorDescription, sim: SensorDescription) -> dict[str, str]:
    """Reasons why something is unknown of either side, see `trust`."""
    doubts: dict[str, str] = {}
    for side, sensor in (("real", real), ("simulated", sim)):
        for need, text in sensor.doubts.items():
            doubts.setdefault(need, f"{side} scan: {text}")
    if (ONE_SWEEP in real.doubts) != (ONE_SWEEP in sim.doubts):
        doubts[SAME_SWEEPS] = doubts[ONE_SWEEP]
    return doubts


def only_known(amounts: Mapping[str, Amount], doubts: Mapping[str, str]) -> dict[str, Amount]:
    """The amounts of the causes of which all that they need is known; the others with the reason."""
    known = {}
    for name, amount in amounts.items():
        reasons = [doubts[need] for need in (FRAME, *CAUSES[name].needs) if need in doubts]
        known[name] = Amount(None, reason=reasons[0]) if reasons else amount
    return known


def estimate_between(base: Side, sim: Side) -> tuple[Pose, dict[str, float]] | None:
    """Pose and beams of a simulated side against another one of the same place, such as of an earlier version.

    Most of the surface is the same on both, so that these amounts are far more accurate than differences of two amounts
    against the real scan. Amounts that need what is in doubt of either scan are left out. None if the scans have too
    little surface in common.
    """
    if min(len(base.points), len(sim.points)) < LEAST_POINTS:
        return None
    pose = fit_pose(base, sim)
    if pose is None:
        return None
    amounts = dict(zip(PARAMETERS, pose.displacement.values.tolist(), strict=True))
    if elevation_scale(base.sensor, sim.sensor) is not None:
        amounts["elevation scale"] = pose.elevation_scale
    if base.sensor.elevation_deg:
        aligned = pose.undisplaced(sim)
        explained = explain_directions(base, aligned)
        for name, amount in (
            ("beams", _beam_amount(base, aligned, explained)),
            ("elevation noise", _elevation_noise(base, aligned, sim)),
            ("exchanged beams", _exchanged_amount(base, aligned, explained)),
        ):
            if amount.amount is not None:
                amounts[name] = amount.amount
    doubts = doubts_of(base.sensor, sim.sensor)
    return pose, {name: amount for name, amount in amounts.items() if doubts.keys().isdisjoint(CAUSES[name].needs)}


def _difference(real: float, sim: float, share: float | None = None) -> Amount:
    return Amount(sim - real, real, sim, share)


def _without_second_returns(side: Side) -> tuple[Side, float]:
    """The side without second returns if it has more than a few, and their share."""
    is_second = second_returns(side)
    share = float(is_second.mean())
    is_doubtful = RETURNS in side.sensor.doubts
    if is_doubtful:
        is_second = second_returns(side, behind_m=0.0)
    return (side.chosen(~is_second) if is_doubtful or share > _MANY_SECOND else side), share


def fit_pose(real: Side, sim: Side) -> Pose | None:
    """Displacement of the simulated side and the scale of its elevations; None without enough surface in common.

    A scale of the elevations of the beams counts only if undoing it brings the surfaces closer: beams can also be
    spaced differently without distorting the world.
    """
    displacement = fit_displacement(real.points, sim.points, real.is_ground)
    if displacement is None:
        return None
    aligned = replace_points(sim, displacement.undo(sim.points, sim.is_ground))
    scale = elevation_scale(real.sensor, sim.sensor) or 0.0
    if abs(scale) >= _LEAST_SCALE:
        points = scale_elevations(sim.points, 1.0 / (1.0 + scale))
        other = fit_displacement(real.points, points, real.is_ground)
        if other is not None:
            rescaled = replace_points(sim, other.undo(points, sim.is_ground))
            distance_m = surface_distance(real.points, aligned.points, real.tree)
            if surface_distance(real.points, rescaled.points, real.tree) < _BETTER * distance_m:
                return Pose(other, scale, _described(real, rescaled))
    return Pose(displacement, 0.0, _described(real, aligned))


def replace_points(side: Side, points: FloatArray) -> Side:
    """The side with its points in other places."""
    return Side(points, side.is_ground, side.sensor, side.T_real_sim)


def scale_elevations(points: FloatArray, factor: float) -> FloatArray:
    """The points with elevations multiplied by a factor; azimuths and ranges stay."""
    if factor == 1.0:
        return points
    level = np.hypot(points[:, 0], points[:, 1])
    elevation = np.arctan2(points[:, 2], level)
    range_m = np.hypot(level, points[:, 2])
    new_level = range_m * np.cos(factor * elevation)
    ratio = new_level / np.maximum(level, 1e-9)
    return np.column_stack([points[:, :2] * ratio[:, None], range_m * np.sin(factor * elevation)])


def _described(real: Side, aligned: Side) -> SensorDescription:
    """The simulated sensor; described again without the displacement if that has blurred its beams."""
    n_real = len(real.sensor.elevation_deg)
    n_sim = len(aligned.sensor.elevation_deg)
    if not n_real or abs(n_sim - n_real) <= _DOUBTFUL_BEAMS:
        return aligned.sensor
    again = describe_sensor(aligned.own_points)
    if not n_sim:
        return again
    return replace(aligned.sensor, elevation_deg=again.elevation_deg or aligned.sensor.elevation_deg)


def _pose_amounts(pose: Pose, real: Side, sim: Side, best_case_m: float) -> dict[str, Amount]:
    """Amounts of the displacement and of the elevation scale.

    The share of each is its part of the distance from the simulated to the real surface that the others leave: how much
    of the distance over the best case disappears if it is undone as well.
    """
    displacement, scale = pose.displacement, pose.elevation_scale
    rows = sample_rows(len(sim.points))
    rescaled = scale_elevations(sim.points[rows], 1.0 / (1.0 + scale))
    is_ground = sim.is_ground[rows]
    after_m = mean_apart(real.tree, displacement.undo(rescaled, is_ground))
    whole = displacement.of(rescaled, is_ground)
    amounts = {}
    for i, name in enumerate(PARAMETERS):
        value = float(displacement.values[i])
        without = displacement.without(i)
        moved_m = np.linalg.norm(whole - without.of(rescaled, is_ground), axis=1)
        share = 0.0
        if moved_m.mean() > _LEAST_MOVED_M:
            with_it_m = mean_apart(real.tree, without.undo(rescaled, is_ground))
            share = _part_of(with_it_m - after_m, after_m - best_case_m)
        amounts[name] = Amount(value, share=share)
    if elevation_scale(real.sensor, sim.sensor) is None:
        amounts["elevation scale"] = Amount(None, reason="the beams of both sides do not correspond")
    else:
        with_it_m = mean_apart(real.tree, displacement.undo(sim.points[rows], is_ground))
        amounts["elevation scale"] = Amount(scale, share=_part_of(with_it_m - after_m, after_m - best_case_m))
    return amounts


def _part_of(gain_m: float, left_m: float) -> float:
    """Part of the distance before a gain that the gain removes; 0 if there is no gain."""
    if gain_m <= 0.0:
        return 0.0
    return gain_m / (gain_m + max(left_m, 0.0))


@dataclass(frozen=True)
class Explained:
    """Flaws of single directions and beams, and the points that they explain.

    blind_deg : azimuth in which only the real side has returns
    dead : beams of the real sensor without simulated returns
    exchanged : pairs of beams with each other's ranges
    is_blind, is_dead : (n,) bool, real points in these directions
    real, sim : (n,), (m,) bool, points that do not count as missing, invented or lost any more
    """

    blind_deg: float
    dead: IndexArray
    exchanged: list[tuple[int, int]]
    is_blind: BoolArray
    is_dead: BoolArray
    real: BoolArray
    sim: BoolArray


def explain_directions(real: Side, sim: Side) -> Explained:
    """Blind directions, dead and exchanged beams of a pair whose simulated side is without its displacement."""
    sector_of_real, is_blind_sector = _blind_sectors(real, sim)
    is_blind = is_blind_sector[sector_of_real]
    is_dead = np.zeros(len(real.points), dtype=np.bool_)
    is_exchanged_real = np.zeros(len(real.points), dtype=np.bool_)
    is_exchanged_sim = np.zeros(len(sim.points), dtype=np.bool_)
    dead = np.empty(0, dtype=np.intp)
    exchanged: list[tuple[int, int]] = []
    grid = grid_of(real.sensor)
    if grid is not None:
        own_grid = grid_of(sim.sensor)
        for beams_grid in (grid,) if own_grid is None else (own_grid, grid):
            exchanged = exchanged_beams(beams_grid, real, sim)
            if exchanged:
                break
        if exchanged:
            is_exchanged_real = np.isin(beams_grid.beam_of(real.own_points), exchanged)
            is_exchanged_sim = np.isin(beams_grid.beam_of(sim.own_points), exchanged)
        dead = dead_beams(grid, real.chosen(~is_blind), sim) if not exchanged else dead
        is_dead = np.isin(grid.beam_of(real.own_points), dead)
    return Explained(
        blind_deg=float(360.0 / len(is_blind_sector) * is_blind_sector.sum()),
        dead=dead,
        exchanged=exchanged,
        is_blind=is_blind,
        is_dead=is_dead,
        real=is_blind | is_dead | is_exchanged_real,
        sim=is_exchanged_sim,
    )


def _blind_sectors(real: Side, sim: Side) -> tuple[IndexArray, BoolArray]:
    """Sector of azimuth of each real point, and in which sectors the simulated side has hardly any returns."""
    width_deg = _sector_deg(real, sim)
    n_sectors = round(360 / width_deg)
    sector_of_real = _sector(real, n_sectors)
    n_real = np.bincount(sector_of_real, minlength=n_sectors)
    n_sim = np.bincount(_sector(sim, n_sectors), minlength=n_sectors)
    is_compared = n_real >= _SECTOR_POINTS
    if not is_compared.any():
        return sector_of_real, is_compared
    usual = float(np.median(n_sim[is_compared] / n_real[is_compared]))
    most_left = _BLIND * usual if width_deg == _FINE_SECTOR_DEG else 0.0
    return sector_of_real, is_compared & (n_sim <= most_left * n_real)


def _sector(side: Side, n_sectors: int) -> IndexArray:
    return ((side.azimuth_deg + 180.0) * n_sectors // 360.0).astype(np.intp) % n_sectors


def _sector_deg(real: Side, sim: Side) -> float:
    """Width of a sector: fine if beams fire several times in it on both sides."""
    steps_deg = [side.sensor.azimuth_step_deg for side in (real, sim)]
    is_dense = all(step is not None and step <= _DENSE_DEG for step in steps_deg)
    return _FINE_SECTOR_DEG if is_dense else _SECTOR_DEG


@dataclass(frozen=True)
class Unmatched:
    """Points without a counterpart on the other side, by kind; (n,) bool over the points of a side.

    is_apart : without a counterpart, of any kind or none
    is_beyond : farther than the other side ever returns
    is_clutter : near the sensor
    is_part : others, in groups
    is_moved : those of objects that have one of the other side next to them
    """

    is_apart: BoolArray
    is_beyond: BoolArray
    is_clutter: BoolArray
    is_part: BoolArray
    is_moved: BoolArray


def find_unmatched(a: Side, b: Side, explained: Explained | None = None) -> tuple[Unmatched, Unmatched]:
    """Points of both sides that are farther from the other side than 0.25 m and 1 % of their range or an azimuth step.

    Road is not moved: it is seen where an object is missing.

    Parameters
    ----------
    explained : points that other flaws explain, which do not count
    """
    step_deg = max(side.sensor.azimuth_step_deg or 0.0 for side in (a, b))
    missing = _unmatched(a, b, step_deg, None if explained is None else explained.real)
    invented = _unmatched(b, a, step_deg, None if explained is None else explained.sim)
    missing_objects = missing.is_part & ~a.is_ground
    invented_objects = invented.is_part & ~b.is_ground
    missing_points = a.points[missing_objects]
    invented_points = b.points[invented_objects]
    _mark_moved(missing, missing_objects, missing_points, invented_points)
    _mark_moved(invented, invented_objects, invented_points, missing_points)
    return missing, invented


def _mark_moved(unmatched: Unmatched, is_object: BoolArray, points: FloatArray, others: FloatArray) -> None:
    apart_m, _ = cKDTree(others).query(points, distance_upper_bound=_MOVED_M)
    unmatched.is_moved[is_object] = np.isfinite(apart_m)
    unmatched.is_part[unmatched.is_moved] = False


def _unmatched(side: Side, other: Side, step_deg: float, is_explained: BoolArray | None) -> Unmatched:
    apart_m, _ = other.tree.query(side.points)
    is_apart = apart_m > _APART_M + max(_APART_PER_M, np.radians(step_deg)) * side.range_m
    if is_explained is not None:
        is_apart &= ~is_explained
    is_beyond = side.range_m > other.range_m.max()
    is_part = is_apart & ~is_beyond
    rows = np.flatnonzero(is_part)
    n_near = cKDTree(side.points[rows]).query_ball_point(side.points[rows], _CLUSTER_M, return_length=True)
    is_part[rows] = n_near > _CLUSTER * np.maximum(CLUTTER_M / side.range_m[rows], 1.0) ** 2
    is_clutter = is_apart & ~is_part & (side.range_m < CLUTTER_M)
    return Unmatched(is_apart, is_beyond, is_clutter, is_part, np.zeros(len(is_part), np.bool_))


def _amounts(real: Side, sim: Side, recorded: Side) -> dict[str, Amount]:
    """The amounts of a pair whose simulated side is without its displacement, except for those of the pose.

    Parameters
    ----------
    recorded : the simulated side as recorded, with its displacement
    """
    explained = explain_directions(real, sim)
    missing, invented = find_unmatched(real, sim, explained)
    parts = np.vstack(
        [real.points[missing.is_part | missing.is_moved], sim.points[invented.is_part | invented.is_moved]]
    )
    is_used_real = ~(_is_near(real, parts) | missing.is_beyond | explained.real)
    is_used_sim = ~(_is_near(sim, parts) | explained.sim)
    return {
        "maximum range": _maximum_range(real, sim, missing, invented),
        "minimum range": _difference(float(np.quantile(real.range_m, 0.001)), float(np.quantile(sim.range_m, 0.001))),
        "moved parts": _share_of(missing.is_moved),
        "missing parts": _share_of(missing.is_part),
        "invented parts": _share_of(invented.is_part),
        "clutter": _share_of(invented.is_clutter),
        "mixed pixels": _stray_amount(real, recorded),
        "blind sector": Amount(explained.blind_deg, share=float(explained.is_blind.mean())),
        "far surface": _far_surface(real, missing, explained),
        **_losses(real, sim, is_used_real, is_used_sim, explained),
        "solid foliage": _foliage_amount(real, sim),
        FLAT: _flat_amount(real, sim),
        **_sensor_amounts(real, sim, recorded, explained),
    }


def _is_near(side: Side, parts: FloatArray) -> BoolArray:
    """(n,) True for points of missing, invented or moved parts, and at their rims, which have counterparts around."""
    if not len(parts):
        return np.zeros(len(side.points), dtype=np.bool_)
    apart_m, _ = cKDTree(parts).query(side.points)
    is_near: BoolArray = apart_m <= _APART_M + _APART_PER_M * side.range_m
    return is_near


def _share_of(is_concerned: BoolArray) -> Amount:
    share = float(is_concerned.mean())
    return Amount(share, share=share)


def _maximum_range(real: Side, sim: Side, missing: Unmatched, invented: Unmatched) -> Amount:
    """Difference of the farthest returns, 0 if one side has only a few beyond the farthest of the other."""
    share = float(missing.is_beyond.mean() + invented.is_beyond.mean())
    real_m, sim_m = float(real.range_m.max()), float(sim.range_m.max())
    n_beyond = int((real.range_m > sim_m).sum() + (sim.range_m > real_m).sum())
    if n_beyond < _FEWEST_BEYOND:
        return Amount(0.0, real_m, sim_m, 0.0)
    return _difference(real_m, sim_m, share)


def _stray_amount(real: Side, sim: Side) -> Amount:
    shares = []
    for side in (real, sim):
        is_stray, is_smooth = find_strays(side)
        shares.append(is_stray.sum() / max(is_smooth.sum(), 1))
    return _difference(float(shares[0]), float(shares[1]), float(abs(shares[1] - shares[0])))


def _far_surface(real: Side, missing: Unmatched, explained: Explained) -> Amount:
    """Share of the object points beyond 20 m without a simulated counterpart, minus that share nearer."""
    is_object = ~real.is_ground & ~explained.real & ~missing.is_beyond
    is_far = is_object & (real.range_m > _FAR_SURFACE_M)
    is_near = is_object & ~is_far
    if min(is_far.sum(), is_near.sum()) < _FEWEST_FAR:
        return Amount(None, reason=f"fewer than {_FEWEST_FAR} object points beyond or within {_FAR_SURFACE_M:g} m")
    far = float(missing.is_apart[is_far].mean())
    near = float(missing.is_apart[is_near].mean())
    return _difference(near, far, (far - near) * float(is_far.sum() / is_object.sum()))


def _foliage_amount(real: Side, sim: Side) -> Amount:
    _, step_m = foliage_steps(real, sim)
    if len(step_m) < _FEWEST_LEAVES:
        return Amount(None, reason=f"fewer than {_FEWEST_LEAVES} returns of foliage")
    early = float((step_m < -_LEAF_STEP_M).mean())
    late = float((step_m > _LEAF_STEP_M).mean())
    return Amount(early - late, share=abs(early - late) * len(step_m) / len(real.points))


def _flat_amount(real: Side, sim: Side) -> Amount:
    places, is_flat = flat_shapes(real, sim)
    if len(is_flat) < _FEWEST_LEAVES:
        return Amount(None, reason=f"fewer than {_FEWEST_LEAVES} places of curved surface near the road")
    return Amount(float(is_flat.mean()), share=float(is_flat.mean()) * len(places) / len(real.points))


def _sensor_amounts(real: Side, sim: Side, recorded: Side, explained: Explained) -> dict[str, Amount]:
    """Amounts that follow from the descriptions of both sensors."""
    a, b = real.sensor, sim.sensor
    step = _known_difference(a.azimuth_step_deg, b.azimuth_step_deg, _why_unknown(a, b, "azimuth_step_deg"))
    jitter = _known_difference(a.azimuth_noise_deg, b.azimuth_noise_deg, _why_unknown(a, b, "azimuth_step_deg"))
    amounts = {
        "range noise": _with_share(_noise_amount(a, b), _NOISY_M),
        "azimuth step": _with_share(step, a.azimuth_step_deg or 1.0),
        "azimuth noise": _with_share(jitter, 0.3),
        "elevation noise": _with_share(_elevation_noise(real, sim, recorded), 0.3),
        "beams": _beam_amount(real, sim, explained),
        "exchanged beams": _exchanged_amount(real, sim, explained),
    }
    if b.elevation_deg:
        steps = _difference(a.range_quantum_m or 0.0, b.range_quantum_m or 0.0)
        amounts["range steps"] = _with_share(steps, _NOISY_M)
    else:
        amounts["range steps"] = Amount(None, reason=_why_unknown(a, b, "elevation_deg"))
    return amounts


def _noise_amount(real: SensorDescription, sim: SensorDescription) -> Amount:
    """Difference between the lower estimate of one side and the upper one of the other; 0 if they overlap."""
    real_m, sim_m = noise_bounds(real), noise_bounds(sim)
    if real_m is None or sim_m is None:
        return Amount(None, reason=_why_unknown(real, sim, "range_noise_m"))
    amount = max(sim_m[0] - real_m[1], 0.0) + min(sim_m[1] - real_m[0], 0.0)
    return Amount(amount, real_m[1], sim_m[1])


def _known_difference(real: float | None, sim: float | None, reason: str) -> Amount:
    if real is None or sim is None:
        return Amount(None, real, sim, reason=reason)
    return _difference(real, sim)


def _why_unknown(real: SensorDescription, sim: SensorDescription, field: str) -> str:
    """Reason why a property of one of the sensors is unknown."""
    for side, sensor in (("real", real), ("simulated", sim)):
        for name in (field, "elevation_deg"):
            if name in sensor.untold:
                return f"{side} scan: {sensor.untold[name]}"
    return "unknown on one side"


def _with_share(amount: Amount, whole: float) -> Amount:
    """The amount with the share of the surface that it affects: its part of an amount that affects the whole."""
    if amount.amount is None:
        return amount
    return replace(amount, share=min(abs(amount.amount) / whole, 1.0))


def _elevation_noise(real: Side, sim: Side, recorded: Side) -> Amount:
    """Noise of the elevations; if the simulated beams cannot be recognised, from their phase or from the road."""
    a, b = real.sensor, sim.sensor
    known = _known_difference(a.elevation_noise_deg, b.elevation_noise_deg, _why_unknown(a, b, "elevation_deg"))
    grid = grid_of(a)
    if known.amount is not None or grid is None:
        return known
    blurred = blurred_elevation_deg(grid, recorded)
    if blurred is not None and a.elevation_noise_deg is not None:
        return _difference(a.elevation_noise_deg, blurred)
    real_blur, sim_blur = road_blur_deg2(real), road_blur_deg2(sim)
    if real_blur is None or sim_blur is None or sim_blur <= real_blur:
        return known
    return Amount(float(np.sqrt(sim_blur - real_blur)))


def _beam_amount(real: Side, sim: Side, explained: Explained) -> Amount:
    """Beams more or fewer than the real sensor's; dead ones are counted if the simulated beams are not distinct.

    Exchanged beams can appear as further ones.
    """
    n_real, n_sim = len(real.sensor.elevation_deg), len(sim.sensor.elevation_deg)
    if not n_real:
        return Amount(None, reason=_why_unknown(real.sensor, sim.sensor, "elevation_deg"))
    n_dead = len(explained.dead)
    if explained.exchanged and n_sim > n_real:
        n_sim = n_real
    elif not n_sim or (n_dead and not sim.sensor.is_sharp):
        n_sim = n_real - n_dead
    share = float(explained.is_dead.mean()) if n_dead else abs(n_sim - n_real) / n_real
    return _difference(n_real, n_sim, share)


def _exchanged_amount(real: Side, sim: Side, explained: Explained) -> Amount:
    if not real.sensor.elevation_deg:
        return Amount(None, reason=_why_unknown(real.sensor, sim.sensor, "elevation_deg"))
    return Amount(2.0 * len(explained.exchanged), share=float(explained.sim.mean()))


def _losses(
    real: Side, sim: Side, is_used_real: BoolArray, is_used_sim: BoolArray, explained: Explained
) -> dict[str, Amount]:
    """Share of the returns lost within 25 m at less than 75 degrees, and the further shares lost beyond each.

    Shares of returns by cell of direction on surface that both sides see, fitted by Poisson regression with a
    logarithmic link: the shares that remain are multiplied.
    """
    from sklearn.linear_model import PoissonRegressor  # takes a second to load

    real_step, sim_step = real.sensor.azimuth_step_deg, sim.sensor.azimuth_step_deg
    firings = real_step / sim_step if real_step and sim_step else 1.0  # simulated ones per real one
    firings *= _beam_ratio(real.sensor, sim.sensor, explained)
    edge_deg = _edge_between_beams(real.sensor)
    if not (is_used_real.any() and is_used_sim.any()):
        return _unknown_losses()
    n_real, range_m, n_kinds = _by_cell(real, is_used_real, LOSSES[1:], edge_deg)
    n_sim, sim_range_m, _ = _by_cell(sim, is_used_sim, (), edge_deg)
    is_alike = (n_real >= _FEWEST) & (n_sim > 0) & (np.abs(sim_range_m - range_m) <= _ALIKE * range_m)
    n_real, n_sim = n_real[is_alike], n_sim[is_alike]
    kinds = {}
    for name, n_all in n_kinds.items():
        share = n_all[is_alike] / n_real
        n_in = n_real[share > 0.5].sum()
        if min(n_in, n_real.sum() - n_in) >= _FEWEST_OF_KIND:
            kinds[name] = share
    if not len(n_real):
        return _unknown_losses()
    columns = np.column_stack([*kinds.values()]) if kinds else np.zeros((len(n_real), 1))
    model = PoissonRegressor(alpha=0.0, tol=1e-8, max_iter=1000)
    fit = model.fit(columns, n_sim / n_real / firings, n_real)
    expected = n_real * firings * fit.predict(columns)
    unevenness = (((n_sim - expected) ** 2).sum() - expected.sum()) / max((expected**2).sum(), 1.0)
    lost = 1.0 - float(np.exp(fit.intercept_))
    amounts = {"lost returns": Amount(lost, share=abs(lost)), UNEVEN: Amount(float(unevenness))}
    reason = f"fewer than {_FEWEST_OF_KIND} such returns"
    for name in LOSSES[1:]:
        amounts[name] = Amount(None, reason=reason)
    for name, coefficient in zip(kinds, fit.coef_.tolist(), strict=False):
        lost = 1.0 - float(np.exp(coefficient))
        amounts[name] = Amount(lost, share=abs(lost) * float(real.concerned(name).mean()))
    return amounts


def _unknown_losses() -> dict[str, Amount]:
    reason = "no surface that both sides see"
    return {UNEVEN: Amount(0.0), **{name: Amount(None, reason=reason) for name in LOSSES}}


def _beam_ratio(real: SensorDescription, sim: SensorDescription, explained: Explained) -> float:
    """Simulated beams per real one that is not dead, in the elevations of both; 1 if they are not counted exactly."""
    n_more = abs(len(sim.elevation_deg) - len(real.elevation_deg))
    is_counted = bool(real.elevation_deg and sim.elevation_deg) and sim.is_sharp and n_more > _DOUBTFUL_BEAMS
    if not is_counted:
        return 1.0
    low_deg = max(min(real.elevation_deg), min(sim.elevation_deg)) - _BEAM_MARGIN_DEG
    high_deg = min(max(real.elevation_deg), max(sim.elevation_deg)) + _BEAM_MARGIN_DEG
    is_dead = np.isin(np.arange(len(real.elevation_deg)), explained.dead)
    n_real = sum(low_deg <= elevation <= high_deg for elevation in np.array(real.elevation_deg)[~is_dead])
    n_sim = sum(low_deg <= elevation <= high_deg for elevation in sim.elevation_deg)
    return n_sim / n_real if n_real and n_sim else 1.0


def _edge_between_beams(sensor: SensorDescription) -> float:
    """Elevation in [0, 2) at which cells begin, so that their edges have the fewest beams next to them, degrees.

    An error of a hundredth of a degree would move all returns of such a beam to another cell.
    """
    edges_deg = np.arange(0.0, _CELL_DEG, _EDGE_DEG / 3)
    apart_deg = (np.array(sensor.elevation_deg) - edges_deg[:, None] + _CELL_DEG / 2) % _CELL_DEG - _CELL_DEG / 2
    return float(edges_deg[np.argmin((np.abs(apart_deg) < _EDGE_DEG).sum(axis=1))])


def _by_cell(
    side: Side, is_used: BoolArray, kinds: tuple[str, ...], edge_deg: float
) -> tuple[IndexArray, FloatArray, dict[str, IndexArray]]:
    """By cell of 2 degrees of direction: number of used returns, their median range (longer of two), number by kind."""
    used = np.flatnonzero(is_used)
    rows = (side.elevation_deg[used] + 90.0 + _CELL_DEG - edge_deg) // _CELL_DEG
    columns = (side.azimuth_deg[used] + 180.0) // _CELL_DEG
    n_around = round(360.0 / _CELL_DEG)
    cell = (rows * n_around + columns % n_around).astype(np.intp)
    n_cells = n_around * (n_around // 2 + 2)
    range_m = side.range_m[used]
    n = np.bincount(cell, minlength=n_cells)
    middle = np.minimum(np.cumsum(n) - n + n // 2, len(cell) - 1)
    by_kind = {name: np.bincount(cell[side.concerned(name)[used]], minlength=n_cells) for name in kinds}
    return n, range_m[np.lexsort((range_m, cell))][middle], by_kind


def foliage_steps(real: Side, sim: Side) -> tuple[IndexArray, FloatArray]:
    """Simulated returns in the direction of real foliage, (k,) rows, and their range minus that of the real return."""
    is_leaf = (real.planes.scattering >= SCATTERED) & (real.planes.variance[:, 2] < _LEAF_SPREAD_M**2)
    angle, near = sim.ray_tree.query(real.rays[is_leaf])
    is_met = angle < np.radians(_RAY_DEG)
    return near[is_met], sim.range_m[near[is_met]] - real.range_m[is_leaf][is_met]


def flat_shapes(real: Side, sim: Side) -> tuple[FloatArray, BoolArray]:
    """Places of curved real surface near the road, (k, 3) metres, and where the simulated surface is much flatter.

    Both sides have one point per voxel, so that the size of a neighbourhood does not depend on the density.
    """
    road_m = np.median(real.points[real.is_ground, 2]) if real.is_ground.any() else -np.inf
    is_shape = ~real.is_ground & (real.points[:, 2] < road_m + _SHAPE_TOP_M) & (real.range_m < FAR_M)
    places = voxel_means(real.points[is_shape], _SHAPE_VOXEL_M)
    reach_m = FAR_M + SHAPE_M
    real_surface = voxel_means(real.points[real.range_m < reach_m], _SHAPE_VOXEL_M)
    sim_surface = voxel_means(sim.points[sim.range_m < reach_m], _SHAPE_VOXEL_M)
    shape = fit_planes(real_surface, places, PLANE_NEIGHBOURS, SHAPE_M)
    other = fit_planes(sim_surface, places, PLANE_NEIGHBOURS, SHAPE_M)
    is_known = np.minimum(shape.n_neighbours, other.n_neighbours) >= _SHAPE_POINTS
    is_broad = (shape.variance[:, 1] > 0.05 * shape.variance[:, 2]) & (shape.scattering < _CURVED)
    is_curved = is_known & is_broad & (shape.variance[:, 0] > _CURVED_M**2)
    is_flat = other.variance[is_curved, 0] < _FLATTER**2 * shape.variance[is_curved, 0]
    return places[is_curved], is_flat


def find_strays(side: Side) -> tuple[BoolArray, BoolArray]:
    """Returns on smooth surface whose range is not that of the surface, and all returns on smooth surface.

    The inverse range is linear over directions on a plane: it is fitted to the eight nearest directions.
    """
    ray = side.rays
    _, near = side.near_rays
    offset = ray[near] - ray[:, None]
    level = np.cross(ray, [0.0, 0.0, 1.0])
    level /= np.maximum(np.linalg.norm(level, axis=1), 1e-9)[:, None]
    columns = np.stack([np.ones(near.shape), np.einsum("nkd,nd->nk", offset, level), offset[:, :, 2]], axis=2)
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
