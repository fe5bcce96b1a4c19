"""Points without a counterpart on the other side, and those that flaws of directions and beams explain."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from ..arrays import BoolArray, FloatArray, IndexArray
from ..linalg.nearest import search_tree
from .beams import dead_beams, exchanged_beams
from .sides import Side

_SECTOR_DEG = 5.0
_FINE_SECTOR_DEG = 1.0
_SECTOR_POINTS = 10
_BLIND = 0.1  # of the usual number of returns, in fine sectors
_WIDE_GAP_DEG = (30.0, 330.0)
_DENSE_DEG = 0.35  # azimuth between returns up to which sectors are fine
#: A point without a counterpart is farther from the other side than this, and this times its range.
_APART_M, _APART_PER_M = 0.25, 0.01
#: Share of the points of beams that are not dead, and number of sectors, in which a minimum range cuts.
_CUT, _N_AROUND = 0.003, 36
_CLUTTER_M = 6.0  # nearer returns without a real counterpart are clutter
_CUT_M = 0.1  # beyond the nearest return, where cleaning may drop that of one side only
_CLUSTER_M = 0.6
_CLUSTER = 5  # a part: other points without a counterpart around one, at 6 m and beyond
_MOVED_M = 1.5  # from a missing to an invented part


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

    @property
    def real_per_sim(self) -> float:
        """Real points per simulated one, of those that these flaws do not explain."""
        return float(max((~self.real).sum(), 1) / max((~self.sim).sum(), 1))


def explain_directions(real: Side, sim: Side) -> Explained:
    """Blind directions, dead and exchanged beams of a pair whose simulated side is without its displacement."""
    is_blind, blind_deg = _blind_directions(real, sim)
    is_unseen, _ = _blind_directions(sim, real)
    is_near = real.range_m < least_range_m(sim)
    dead = np.empty(0, dtype=np.intp)
    is_dead = np.zeros(len(real.points), dtype=np.bool_)
    exchanged, is_exchanged_real, is_exchanged_sim = _find_exchanged(real, sim)
    if real.sensor.elevation_deg and not exchanged:
        beam = real.sensor.beam_of(real.sensor_points)
        dead = dead_beams(real.sensor, beam[~is_blind], sim)
        is_dead = np.isin(beam, dead)
        if _is_cut(real, is_near & ~is_dead):
            dead = dead_beams(real.sensor, beam[~is_blind & ~is_near], sim)
            is_dead = np.isin(beam, dead)
    is_near &= _is_cut(real, is_near & ~is_dead)
    return Explained(
        blind_deg=blind_deg,
        dead=dead,
        exchanged=exchanged,
        is_blind=is_blind,
        is_dead=is_dead,
        real=is_blind | is_dead | is_near | is_exchanged_real,
        sim=is_exchanged_sim | is_unseen,
    )


def _is_cut(side: Side, is_near: BoolArray) -> bool:
    """True if the nearest points of a side are more than some, and around the sensor, as a minimum range cuts them."""
    n_around = len(np.unique(_sector(side, _N_AROUND)[is_near]))
    return bool(is_near.mean() > _CUT) and n_around > _N_AROUND / 2


def least_range_m(side: Side) -> float:
    """Range in metres below which a side has one in a thousand of its returns."""
    return float(np.quantile(side.range_m, 0.001))


def in_gap(side: Side, other: Side) -> BoolArray:
    """(n,) True for points of a side in the widest sector of azimuth without returns of the other, if it is wide."""
    azimuth_deg = other.sorted_azimuth_deg
    gap_deg = np.diff(azimuth_deg, append=azimuth_deg[0] + 360.0)
    widest = int(gap_deg.argmax())
    if not _WIDE_GAP_DEG[0] < gap_deg[widest] < _WIDE_GAP_DEG[1]:
        return np.zeros(len(side.points), dtype=np.bool_)
    return (side.azimuth_deg - azimuth_deg[widest]) % 360.0 < gap_deg[widest]


def _blind_directions(side: Side, other: Side) -> tuple[BoolArray, float]:
    """(n,) True for points of a side where the other has hardly any returns, and the azimuth of these sectors, degrees.

    Sectors are fine if both sides have several returns in them.
    """
    is_dense = max(side.azimuth_gap_deg, other.azimuth_gap_deg) <= _DENSE_DEG
    width_deg = _FINE_SECTOR_DEG if is_dense else _SECTOR_DEG
    n_sectors = round(360 / width_deg)
    sector = _sector(side, n_sectors)
    n_side = np.bincount(sector, minlength=n_sectors)
    n_other = np.bincount(_sector(other, n_sectors), minlength=n_sectors)
    is_blind = n_side >= _SECTOR_POINTS
    has_both = is_blind & (n_other > 0)
    if has_both.any():
        expected = n_side * float(np.median(n_other[has_both] / n_side[has_both]))
        most_left = _BLIND * expected if is_dense else 0.0
        is_blind &= (n_other <= most_left) & (expected >= _SECTOR_POINTS)
    return is_blind[sector] | in_gap(side, other), width_deg * float(is_blind.sum())


def _sector(side: Side, n_sectors: int) -> IndexArray:
    return ((side.azimuth_deg + 180.0) * n_sectors // 360.0).astype(np.intp) % n_sectors


def _find_exchanged(
    real: Side, sim: Side
) -> tuple[list[tuple[int, int]], BoolArray, BoolArray]:
    """Exchanged beams of the simulated grid, if it has none of the real one; and the points of both sides in them."""
    if real.sensor.elevation_deg:
        for sensor in (sim.sensor, real.sensor):
            if sensor.elevation_deg and (exchanged := exchanged_beams(sensor, real, sim)):
                real_beam = sensor.beam_of(real.sensor_points)
                sim_beam = sensor.beam_of(sim.sensor_points)
                return exchanged, np.isin(real_beam, exchanged), np.isin(sim_beam, exchanged)
    return [], np.zeros(len(real.points), np.bool_), np.zeros(len(sim.points), np.bool_)


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


def find_unmatched(a: Side, b: Side, explained: Explained) -> tuple[Unmatched, Unmatched]:
    """Points of both sides that are farther from the other side than 0.25 m and 1 % of their range or an azimuth step.

    If the other side is less than half as dense, the part of the range is larger. Road is not moved: it is seen
    where an object is missing.

    Parameters
    ----------
    explained : points that other flaws explain, which do not count
    """
    step = np.radians(max(side.sensor.azimuth_step_deg or 0.0 for side in (a, b)))
    density = explained.real_per_sim
    missing = _unmatched(a, b, max(step, _apart_per_m(density)), explained.real)
    invented = _unmatched(b, a, max(step, _apart_per_m(1.0 / density)), explained.sim)
    missing_objects = missing.is_part & ~a.is_ground
    invented_objects = invented.is_part & ~b.is_ground
    missing_points = a.points[missing_objects]
    invented_points = b.points[invented_objects]
    _mark_moved(missing, missing_objects, missing_points, invented_points)
    _mark_moved(invented, invented_objects, invented_points, missing_points)
    return missing, invented


def _apart_per_m(density: float) -> float:
    """Part of the range at a density relative to the other side: about in proportion to it beyond twice that."""
    return _APART_PER_M * max(1.5 * density - 2.0, 1.0)


def _unmatched(
    side: Side, other: Side, apart_per_m: float, is_explained: BoolArray
) -> Unmatched:
    """Points of a side without a counterpart; none of them is moved yet."""
    is_apart = ~(near(side, other.tree, apart_per_m) | is_explained)
    is_beyond = side.range_m > other.range_m.max()
    is_part = is_apart & ~is_beyond
    rows = np.flatnonzero(is_part)
    points = side.points[rows]
    tree = search_tree(points)
    last_m, _ = tree.query(points, k=[1 + _CLUSTER], distance_upper_bound=_CLUSTER_M)
    is_part[rows] = np.isfinite(last_m[:, 0])
    close = rows[side.range_m[rows] < _CLUTTER_M]
    n_near = tree.query_ball_point(side.points[close], _CLUSTER_M, return_length=True)
    is_part[close] = n_near > _CLUSTER * (_CLUTTER_M / side.range_m[close]) ** 2
    nearest_m = min(side.range_m.min(), other.range_m.min()) + _CUT_M
    is_clutter = is_apart & ~is_part & (side.range_m > nearest_m) & (side.range_m < _CLUTTER_M)
    return Unmatched(is_apart, is_beyond, is_clutter, is_part, np.zeros(len(is_part), np.bool_))


def near(side: Side, places: cKDTree, apart_per_m: float = _APART_PER_M) -> BoolArray:
    """(n,) True for points of a side at some places: nearer than the counterpart of a point has to be."""
    limit_m = _APART_M + apart_per_m * side.range_m
    order = side.tree.indices  # neighbours next to each other, which speeds up the search
    apart_m = np.empty(len(order))
    apart_m[order], _ = places.query(
        side.points.take(order, axis=0), distance_upper_bound=1.001 * limit_m.max()
    )
    return np.less_equal(apart_m, limit_m)


def _mark_moved(
    unmatched: Unmatched, is_object: BoolArray, points: FloatArray, counterparts: FloatArray
) -> None:
    """Mark the points of objects next to those of the other side as moved, no longer as parts."""
    apart_m, _ = search_tree(counterparts).query(points, distance_upper_bound=_MOVED_M)
    unmatched.is_moved[is_object] = np.isfinite(apart_m)
    unmatched.is_part[unmatched.is_moved] = False
