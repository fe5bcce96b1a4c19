"""Gain of a correction: the share of the distance between both sides that disappears if a cause is corrected."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import permutations

import numpy as np
from numpy.random import Generator
from scipy.spatial import cKDTree

from ..arrays import BoolArray, FloatArray, IndexArray
from ..displacement import PARAMETERS, Displacement
from ..surfels import fit_planes
from .evidence import (
    FLAT,
    LOSSES,
    SCATTERED,
    SHAPE_M,
    PairEstimates,
    PairScans,
    Side,
    find_strays,
    find_unmatched,
    flat_shapes,
    foliage_steps,
    noise_without_steps,
)

#: Distances to the other side count up to this.
REACH_M = 1.0
_SAMPLE = 4000
_NEIGHBOURS = 16
_MOST_MOVED = 0.1  # of a range, from a return's own to that of the plane through it
_MOST_EXACT, _ORDERS = 4, 12
_OFF_STDS, _LEAST_STD_M = 3.0, 0.02  # of a flat surface, from which a point is off


@dataclass(frozen=True)
class Correction:
    """Changes of the simulated points that correct causes.

    displacement : (11,) of `displacement.PARAMETERS`, to be undone
    along_m : (m,) change of the ranges
    keep : (m,) bool
    add : (k, 3) real points
    """

    displacement: FloatArray | float = 0.0
    along_m: FloatArray | float = 0.0
    keep: BoolArray | bool = True
    add: FloatArray = field(default_factory=lambda: np.empty((0, 3)))


def corrected(scans: PairScans, chosen: Sequence[Correction]) -> FloatArray:
    """The simulated points with some corrections."""
    sim = scans.sim
    displacement, along_m, keep = np.zeros(len(PARAMETERS)), np.zeros(len(sim.points)), sim.range_m > 0
    for own in chosen:
        displacement, along_m, keep = displacement + own.displacement, along_m + own.along_m, keep & own.keep
    points = Displacement(displacement).undo(sim.points, sim.is_ground)
    points = points * (1.0 + along_m / np.maximum(np.linalg.norm(points, axis=1), 1e-9))[:, None]
    return np.concatenate([points[keep], *(own.add for own in chosen)])


def surface_distance(real: FloatArray, sim: FloatArray, real_tree: cKDTree | None = None) -> float:
    """Mean distance to the other side, counted up to 1 m, averaged over both directions; metres.

    It is also the mean uncovered share over all reaches from 0 to 1 m, since the integral of P(d > r) over r in
    [0, 1 m] is the mean of min(d, 1 m). Of both sides, every k-th point is used, 4000 at most.
    """
    if not len(sim):
        return REACH_M
    trees = (cKDTree(sim), cKDTree(real) if real_tree is None else real_tree)
    means = []
    for points, tree in zip((real, sim), trees, strict=True):
        apart, _ = tree.query(points[:: len(points) // _SAMPLE + 1], distance_upper_bound=REACH_M)
        means.append(np.minimum(apart, REACH_M).mean())
    return float(np.mean(means))


def off_share(a: FloatArray, b: FloatArray) -> float:
    """Share of the flat surface of two scans that the other has elsewhere, averaged over both directions.

    A point is off if the plane through the 16 nearest points of the other scan is farther than three times their
    standard deviation, and 6 cm. It does not depend on which rays both scans have; points more than 1 m from the mean
    of those neighbours, and neighbours that are scattered or on a line, do not count. Of both, every k-th point is
    used, 4000 at most.
    """
    found = []
    for points, other in ((a, b), (b, a)):
        asked = points[:: len(points) // _SAMPLE + 1]
        planes = fit_planes(other, asked, _NEIGHBOURS)
        off = asked - planes.mean
        is_flat = (planes.scattering < SCATTERED) & ~planes.is_line & ((off**2).sum(axis=1) < REACH_M**2)
        limit_m = _OFF_STDS * np.maximum(np.sqrt(planes.variance[:, 0]), _LEAST_STD_M)
        is_off = np.abs((off * planes.normal).sum(axis=1)) > limit_m
        found.append(is_off[is_flat].mean() if is_flat.any() else 0.0)
    return float(np.mean(found))


def corrections(
    scans: PairScans, found: PairEstimates, excess: Mapping[str, float], rng: Generator
) -> dict[str, Correction]:
    """The correction of each cause for one pair.

    Parameters
    ----------
    found : estimates of the pair
    excess : by cause to be corrected, its amount over the floor
    """
    a, b = scans.real, found.undisplaced(scans.sim)
    missing, invented = find_unmatched(a, b)
    invented_by = {"invented pieces": invented.is_piece, "clutter": invented.is_clutter}
    others = ~(missing.is_beyond | missing.is_piece | missing.is_moved | missing.is_clutter)
    made: dict[str, Correction] = {}
    for name, amount in excess.items():
        part = amount / max(found.amounts.get(name, amount), amount) if amount > 0 else 1.0  # the rest is the floor's
        if name in PARAMETERS:
            made[name] = Correction(np.where([one == name for one in PARAMETERS], amount, 0.0))
        elif name in ("range noise", "range steps"):
            made[name] = _noise(a, b, name, amount, rng)
        elif name in (*LOSSES, "azimuth step", "beams"):
            made[name] = _density(name, amount, found.amounts.get(name, amount), a, b, others, rng)
        elif name in (FLAT, "solid foliage"):
            made[name] = _onto_real(name, a, b, part, rng)
        elif name == "mixed pixels":
            made[name] = Correction(keep=~_some(find_strays(b)[0], part, rng))
        elif name in invented_by:
            made[name] = Correction(keep=~_some(invented_by[name], part, rng))
        elif name == "missing pieces":
            made[name] = Correction(add=a.points[_some(missing.is_piece, part, rng)])
        elif name == "moved pieces":
            made[name] = Correction(keep=~_some(invented.is_moved, part, rng), add=a.points[missing.is_moved])
        elif name == "maximum range":
            made[name] = Correction(keep=b.range_m <= a.range_m.max(), add=a.points[missing.is_beyond])
        elif name == "minimum range":
            made[name] = Correction(add=a.points[a.range_m < b.range_m.min()])
    return made


@dataclass(frozen=True)
class Shares:
    """Distances of a pair, metres: before and after all corrections, that of the floor, and the part of each cause."""

    before_m: float
    after_m: float
    floor_m: float
    by_cause: dict[str, float]


def shares(scans: PairScans, made: Mapping[str, Correction], rng: Generator, floor_m: float = 0.0) -> Shares:
    """Distance of both sides before and after all corrections, and the metres that each correction contributes.

    Distances count down to `floor_m`: restored real returns are better than those of the floor.

    The contribution is averaged over the orders in which the corrections can be applied (Shapley, 1953): over all
    orders up to four corrections, else over twelve at random.
    """
    names, tree = sorted(made), cKDTree(scans.real.points)
    known: dict[frozenset[str], float] = {}

    def distance(chosen: frozenset[str]) -> float:
        if chosen not in known:
            points = corrected(scans, [made[name] for name in sorted(chosen)])
            known[chosen] = surface_distance(scans.real.points, points, tree)
        return known[chosen]

    if len(names) <= _MOST_EXACT:
        orders = [*permutations(names)]
    else:
        half = [tuple(rng.permutation(names).tolist()) for _ in range(_ORDERS // 2)]
        orders = [*half, *(order[::-1] for order in half)]
    gains = dict.fromkeys(names, 0.0)
    for order in orders:
        for i, name in enumerate(order):
            before, after = frozenset(order[:i]), frozenset(order[: i + 1])
            gains[name] += (max(distance(before), floor_m) - max(distance(after), floor_m)) / len(orders)
    return Shares(distance(frozenset()), max(distance(frozenset(names)), floor_m), floor_m, gains)


def changes(
    scans: PairScans, floor: PairScans, displacement: Displacement, excess: Mapping[str, float], rng: Generator
) -> Shares:
    """Shares in the distance between the simulated scans of a pair and of its floor, not between both sides.

    A poor simulator is far from the real surface everywhere, so that any correction brings it closer; what a flaw has
    changed is seen next to the same simulator without it.

    Parameters
    ----------
    displacement : of the pair over that of the floor
    excess : see `corrections`
    """
    both, made = _between_sims(scans, floor, displacement, excess, rng)
    return shares(both, made, rng)


def off_shares(
    scans: PairScans, floor: PairScans, displacement: Displacement, excess: Mapping[str, float], rng: Generator
) -> tuple[float, float]:
    """Share of flat surface (`off_share`) that the run has elsewhere than its floor, before and after all corrections.

    Parameters
    ----------
    displacement, excess : see `changes`
    """
    both, made = _between_sims(scans, floor, displacement, excess, rng)
    after = corrected(both, [*made.values()])
    return off_share(floor.sim.points, scans.sim.points), off_share(floor.sim.points, after)


def _between_sims(
    scans: PairScans, floor: PairScans, displacement: Displacement, excess: Mapping[str, float], rng: Generator
) -> tuple[PairScans, dict[str, Correction]]:
    """The simulated scans of the floor and of the run as a pair, and the correction of each cause."""
    both = PairScans(floor.sim, scans.sim)
    return both, corrections(both, PairEstimates(displacement, scans.sim.sensor, {}), excess, rng)


def _some(flags: BoolArray, part: float, rng: Generator) -> BoolArray:
    """A random part of the flagged points."""
    return flags & (rng.random(len(flags)) < part)


def _noise(a: Side, b: Side, name: str, amount: float, rng: Generator) -> Correction:
    """Missing noise, added along the rays; or less of the distance to the real surface along the rays."""
    sim = max(b.sensor["range_noise_m"] or 0.0, 1e-4)
    if name == "range noise":
        sim = max(noise_without_steps(b.sensor) or 0.0, 1e-4)
    elif amount > 0:
        sim = max(sim, amount / np.sqrt(12))
    if amount < 0:
        return Correction(along_m=rng.normal(0.0, np.sqrt(amount**2 + 2 * sim * -amount), len(b.points)))
    target = sim - amount if name == "range noise" else np.sqrt(max(sim**2 - amount**2 / 12, 0.0))
    along_m = (1.0 - max(target, 0.0) / sim) * (_seen_m(b.rays, a) - b.range_m)
    return Correction(along_m=np.where(np.abs(along_m) < 4 * sim, along_m, 0.0))


def _seen_m(rays: FloatArray, real: Side) -> FloatArray:
    """(k,) range at which rays meet the real surface: the plane through the return nearest in direction.

    Where a ray grazes the plane, the range of the return itself.
    """
    _, near = cKDTree(real.rays).query(rays)
    places, of_ray = np.unique(near, return_inverse=True)
    normal = fit_planes(real.points, real.points[places], _NEIGHBOURS).normal[of_ray]
    range_m = real.range_m[near]
    with np.errstate(divide="ignore", invalid="ignore"):
        met_m = (normal * real.points[near]).sum(axis=1) / (normal * rays).sum(axis=1)
        is_met = np.abs(met_m - range_m) < _MOST_MOVED * range_m
    return np.where(is_met, met_m, range_m)


def _as_simulated(real: Side, sim: Side, is_lost: IndexArray) -> FloatArray:
    """Real points with the error of the simulated surface: moved along the real normal, as far as the nearest point."""
    points = real.points[is_lost]
    normal = fit_planes(real.points, points, _NEIGHBOURS).normal
    _, near = cKDTree(sim.points).query(points)
    return points + ((sim.points[near] - points) * normal).sum(axis=1, keepdims=True) * normal


def _density(
    name: str, amount: float, of_run: float, a: Side, b: Side, is_common: BoolArray, rng: Generator
) -> Correction:
    """Real returns on common surface, where the simulated ones are farthest apart, or fewer of the simulated ones.

    Parameters
    ----------
    amount, of_run : over the floor, and of the pair; a share that is lost is one of what the floor returns
    """
    step_deg, n_beams = b.sensor["azimuth_step_deg"], b.sensor["n_beams"]
    share = amount * (1.0 - of_run) / (1.0 - amount) if name in LOSSES and amount > 0 else amount
    if name == "azimuth step":
        share = amount / step_deg if step_deg else 0.0
    elif name == "beams":
        share = -amount / (n_beams - min(amount, 0.0)) if n_beams else 0.0
    if share > 0:
        rows = np.flatnonzero(is_common & a.concerned(name))
        gap, _ = cKDTree(b.rays).query(a.rays[rows])
        return Correction(add=_as_simulated(a, b, rows[np.argsort(-gap)[: round(share * len(rows))]]))
    return Correction(keep=~_some(b.concerned(name), 1.0 - 1.0 / (1.0 - share), rng))


def _onto_real(name: str, a: Side, b: Side, part: float, rng: Generator) -> Correction:
    """Simulated returns in the direction of foliage, or of surface that is too flat, at the range of the real one."""
    if name == FLAT:
        places, is_flat = flat_shapes(a, b)
        apart, _ = cKDTree(places[is_flat]).query(b.points, distance_upper_bound=SHAPE_M)
        rows = np.flatnonzero(np.isfinite(apart))
        step_m = b.range_m[rows] - _seen_m(b.rays[rows], a)
        step_m[np.abs(step_m) > REACH_M] = 0.0
    else:
        rows, step_m = foliage_steps(a, b)
    along_m = np.zeros(len(b.range_m))
    along_m[rows] = -step_m
    return Correction(along_m=np.where(_some(along_m != 0, part, rng), along_m, 0.0))
