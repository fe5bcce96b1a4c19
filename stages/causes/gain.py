"""Gain of a correction: the share of the distance between both sides that disappears if a cause is corrected."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import permutations

import numpy as np
from numpy.random import Generator

from ...schemas.cause_catalogue import BEST_CASE_ACCURACY, FLAT, LOSSES, PARAMETERS
from ..arrays import BoolArray, FloatArray, IndexArray
from ..displacement import Displacement
from ..linalg.nearest import search_tree
from ..surfels import fit_planes
from .beams import second_returns
from .distance import REACH_M, off_share, surface_distance
from .pose import Pose, undo_elevation_scale
from .shapes import SHAPE_M, find_strays, flat_shapes, foliage_steps
from .sides import PairScans, Side, most_noise_m
from .unmatched import Explained, Unmatched, explain_directions, find_unmatched

_NEIGHBOURS = 16
_MOST_MOVED = 0.1  # of a range, from a return's own to that of the plane through it
_MOST_EXACT = 4  # corrections of which all orders are tried
_ORDERS = 6  # of more corrections


@dataclass(frozen=True)
class Correction:
    """Changes of the simulated points that correct causes.

    displacement : (12,) of `displacement.PARAMETERS`, to be undone
    elevation_scale : to be undone
    along_m : (m,) change of the ranges
    keep : (m,) bool
    add : (k, 3) real points
    """

    displacement: FloatArray | float = 0.0
    elevation_scale: float = 0.0
    along_m: FloatArray | float = 0.0
    keep: BoolArray | bool = True
    add: FloatArray = field(default_factory=lambda: np.empty((0, 3)))


def corrected(sim: Side, chosen: Sequence[Correction], seam_deg: float) -> FloatArray:
    """The simulated points with some corrections.

    Parameters
    ----------
    seam_deg : of the displacement
    """
    displacement = np.zeros(len(PARAMETERS))
    scale = 0.0
    along_m = np.zeros(len(sim.points))
    keep = np.ones(len(sim.points), dtype=np.bool_)
    for correction in chosen:
        displacement = displacement + correction.displacement
        scale += correction.elevation_scale
        along_m = along_m + correction.along_m
        keep = keep & correction.keep
    points = undo_elevation_scale(sim.points, scale)
    if displacement.any():
        points = Displacement(displacement, seam_deg).undo(points, sim.moves_with_road)
    if along_m.any():
        range_m = np.maximum(np.linalg.norm(points, axis=1), 1e-9)
        points = points * (1.0 + along_m / range_m)[:, None]
    return np.concatenate([points[keep], *(correction.add for correction in chosen)])


def corrections(
    scans: PairScans,
    pose: Pose,
    amounts: Mapping[str, float | None],
    excess: Mapping[str, float],
    rng: Generator,
) -> dict[str, Correction]:
    """The correction of each cause for one pair.

    Parameters
    ----------
    pose : of the simulated side
    amounts : by cause, of the pair
    excess : by cause to be corrected, its amount over that of a base
    """
    real = scans.real
    sim = pose.undisplaced(scans.sim)
    explained = explain_directions(real, sim)
    missing, invented = find_unmatched(real, sim, explained)
    is_missing = missing.is_beyond | missing.is_part | missing.is_moved | missing.is_clutter
    is_common = ~(is_missing | explained.real)
    pair = _Pair(scans.sim, real, sim, explained, missing, invented, is_common, rng)
    by_cause: dict[str, Correction] = {}
    for name, amount in excess.items():
        correction = pair.correction(name, amount, amounts.get(name))
        if correction is not None:
            by_cause[name] = correction
    return by_cause


@dataclass(frozen=True)
class _Pair:
    """Inputs of the corrections of a pair.

    recorded : the simulated side as recorded
    real, sim : both sides, the simulated one without its displacement
    explained, missing, invented : see `estimates`
    is_common : (n,) bool, real points of surface that both sides see
    """

    recorded: Side
    real: Side
    sim: Side
    explained: Explained
    missing: Unmatched
    invented: Unmatched
    is_common: BoolArray
    rng: Generator

    def correction(self, name: str, amount: float, whole: float | None) -> Correction | None:
        """The correction of one cause; None if it has none.

        Parameters
        ----------
        amount, whole : over that of a base, and of the pair
        """
        if name == "elevation scale":
            return Correction(elevation_scale=amount)
        if name in PARAMETERS:
            return Correction(np.where(np.array(PARAMETERS) == name, amount, 0.0))
        if name in ("range noise", "range steps"):
            return _noise(self.real, self.sim, name, amount, self.rng)
        if name in (*LOSSES, "azimuth step", "beams"):
            return self._density(name, amount, whole or 0.0)
        part = 1.0  # of the pair's amount; the rest is the base's
        if amount > 0:
            part = amount / max(amount if whole is None else whole, amount)
        if name in (FLAT, "solid foliage"):
            return self._onto_real(name, part)
        return self._other_points(name, part)

    def _density(self, name: str, amount: float, whole: float) -> Correction:
        """Real returns on common surface, where the simulated ones are farthest apart, or fewer of the simulated ones.

        Parameters
        ----------
        amount, whole : over the base, and of the pair; a share that is lost is one of what the base returns
        """
        real, sim = self.real, self.sim
        share = amount
        if name == "beams":
            if self.explained.is_dead.any():
                dead = np.flatnonzero(self.explained.is_dead)
                return Correction(add=_as_simulated(real, sim, dead))
            share = -amount / max(len(sim.sensor.elevation_deg) - min(amount, 0.0), 1.0)
        elif name == "azimuth step":
            share = amount / sim.sensor.azimuth_step_deg if sim.sensor.azimuth_step_deg else 0.0
        elif amount > 0:
            share = amount * (1.0 - whole) / (1.0 - amount)
        if share <= 0:
            return Correction(keep=~self._some(sim.concerned(name), 1.0 - 1.0 / (1.0 - share)))
        rows = np.flatnonzero(self.is_common & real.concerned(name))
        gap, _ = sim.ray_tree.query(real.rays[rows])
        rows = rows[np.argsort(-gap)[: round(share * len(rows))]]
        return Correction(add=_as_simulated(real, sim, rows))

    def _onto_real(self, name: str, part: float) -> Correction:
        """Simulated returns towards foliage, or towards surface that is too flat, at the range of the real ones."""
        real, sim = self.real, self.sim
        if name == FLAT:
            places, is_flat = flat_shapes(real, sim)
            apart_m, _ = search_tree(places[is_flat]).query(
                sim.points, distance_upper_bound=SHAPE_M
            )
            rows = np.flatnonzero(np.isfinite(apart_m))
            step_m = sim.range_m[rows] - _seen_m(sim.rays[rows], real)
            step_m[np.abs(step_m) > REACH_M] = 0.0
        else:
            rows, step_m = foliage_steps(real, sim)
        along_m = np.zeros(len(sim.range_m))
        along_m[rows] = -step_m
        return Correction(along_m=np.where(self._some(along_m != 0, part), along_m, 0.0))

    def _other_points(self, name: str, part: float) -> Correction | None:
        """Points of the real side added, or simulated ones removed or replaced."""
        real, sim = self.real, self.sim
        missing, invented = self.missing, self.invented
        explained = self.explained
        is_removed = np.zeros(len(sim.points), dtype=np.bool_)
        is_added = np.zeros(len(real.points), dtype=np.bool_)
        if name == "second returns":
            is_removed = second_returns(self.recorded)
        elif name == "mixed pixels":
            is_stray, _ = find_strays(self.recorded, np.arange(len(sim.points)))
            is_removed = self._some(is_stray, part)
        elif name == "invented parts":
            is_removed = self._some(invented.is_part, part)
        elif name == "clutter":
            is_removed = self._some(invented.is_clutter, part)
        elif name == "missing parts":
            is_added = self._some(missing.is_part, part)
        elif name == "blind sector":
            is_added = explained.is_blind
        elif name == "minimum range":
            is_added = real.range_m < sim.range_m.min()
        elif name == "exchanged beams":
            is_removed = explained.sim
            is_added = explained.real & ~explained.is_blind & ~explained.is_dead
        elif name == "moved parts":
            is_removed = self._some(invented.is_moved, part)
            is_added = missing.is_moved
        elif name == "maximum range":
            is_removed = sim.range_m > real.range_m.max()
            is_added = missing.is_beyond
        else:
            return None
        return Correction(keep=~is_removed, add=real.points[is_added])

    def _some(self, flags: BoolArray, part: float) -> BoolArray:
        """A random part of the flagged points."""
        return flags & (self.rng.random(len(flags)) < part)


def _noise(real: Side, sim: Side, name: str, amount: float, rng: Generator) -> Correction:
    """Missing noise, added along the rays; or less of the distance to the real surface along the rays."""
    noise_m = max(sim.sensor.range_noise_m or 0.0, 1e-4)
    if name == "range noise":
        noise_m = max(most_noise_m(sim.sensor), 1e-4)
    elif amount > 0:
        noise_m = max(noise_m, amount / np.sqrt(12))
    if amount < 0:
        missing_m = np.sqrt(amount**2 + 2 * noise_m * -amount)
        return Correction(along_m=rng.normal(0.0, missing_m, len(sim.points)))
    target_m = noise_m - amount
    if name == "range steps":
        target_m = np.sqrt(max(noise_m**2 - amount**2 / 12, 0.0))
    along_m = (1.0 - max(target_m, 0.0) / noise_m) * (_seen_m(sim.rays, real) - sim.range_m)
    return Correction(along_m=np.where(np.abs(along_m) < 4 * noise_m, along_m, 0.0))


def _seen_m(rays: FloatArray, real: Side) -> FloatArray:
    """(k,) range at which rays meet the real surface: the plane through the return nearest in direction.

    Where a ray grazes the plane, the range of the return itself.
    """
    _, near = real.ray_tree.query(rays)
    places, of_ray = np.unique(near, return_inverse=True)
    normal = fit_planes(real.tree, real.points[places], _NEIGHBOURS).normal[of_ray]
    range_m = real.range_m[near]
    with np.errstate(divide="ignore", invalid="ignore"):
        met_m = (normal * real.points[near]).sum(axis=1) / (normal * rays).sum(axis=1)
        is_met = np.abs(met_m - range_m) < _MOST_MOVED * range_m
    return np.where(is_met, met_m, range_m)


def _as_simulated(real: Side, sim: Side, rows: IndexArray) -> FloatArray:
    """Real points with the error of the simulated surface: moved along the real normal, as far as the nearest point."""
    points = real.points[rows]
    normal = fit_planes(real.tree, points, _NEIGHBOURS).normal
    _, near = sim.tree.query(points)
    return points + ((sim.points[near] - points) * normal).sum(axis=1, keepdims=True) * normal


@dataclass(frozen=True)
class Shares:
    """Distances of a pair in metres: before and after all corrections, of the best case, and the part of each cause."""

    before_m: float
    after_m: float
    best_case_m: float
    by_cause: dict[str, float]


def shares(
    scans: PairScans,
    by_cause: Mapping[str, Correction],
    seam_deg: float,
    rng: Generator,
    best_case_m: float = 0.0,
) -> Shares:
    """Distance of both sides before and after all corrections, and the metres that each correction contributes.

    Distances count down to `best_case_m`: restored real returns are better than those of a second measurement. Where
    the sides are as close as that, they count in full.

    The contribution is averaged over the orders in which the corrections can be applied (Shapley, 1953): over all
    orders up to four corrections, else over six at random.
    """
    names = sorted(by_cause)
    known: dict[frozenset[str], float] = {}

    def distance(chosen: frozenset[str]) -> float:
        if chosen not in known:
            points = corrected(scans.sim, [by_cause[name] for name in sorted(chosen)], seam_deg)
            known[chosen] = surface_distance(scans.real.tree, search_tree(points))
        return known[chosen]

    before_all_m = distance(frozenset())
    least_m = best_case_m if before_all_m > (1.0 + BEST_CASE_ACCURACY) * best_case_m else 0.0
    gains = dict.fromkeys(names, 0.0)
    orders = _orders(names, rng)
    for order in orders:
        for i, name in enumerate(order):
            before_m = distance(frozenset(order[:i]))
            after_m = distance(frozenset(order[: i + 1]))
            gains[name] += (max(before_m, least_m) - max(after_m, least_m)) / len(orders)
    return Shares(before_all_m, max(distance(frozenset(names)), least_m), best_case_m, gains)


def _orders(names: Sequence[str], rng: Generator) -> list[tuple[str, ...]]:
    """Orders of the corrections: all of a few, else some at random and their reverse."""
    if len(names) <= _MOST_EXACT:
        return list(permutations(names))
    orders = [tuple(rng.permutation(names).tolist()) for _ in range(_ORDERS // 2)]
    return orders + [order[::-1] for order in orders]


def changes(
    base: Side, sim: Side, pose: Pose, excess: Mapping[str, float], rng: Generator
) -> tuple[Shares, float, float]:
    """Shares in the distance between two simulated scans of a place, and the flat surface that they have elsewhere.

    A poor simulator is far from the real surface everywhere, so that any correction brings it closer; what a flaw has
    changed is seen next to the same simulator without it.

    Parameters
    ----------
    base, sim : without and with the changes
    pose : of `sim` against `base`
    excess : by cause, the amount of the change

    Returns
    -------
    Shares, and the share of flat surface elsewhere (`off_share`) before and after all corrections.
    """
    scans = PairScans(base, sim)
    seam_deg = pose.displacement.seam_deg
    by_cause = corrections(scans, pose, {}, excess, rng)
    after = corrected(sim, list(by_cause.values()), seam_deg)
    before_share = off_share(base.points, sim.points)
    after_share = off_share(base.points, after)
    return shares(scans, by_cause, seam_deg, rng), before_share, after_share
