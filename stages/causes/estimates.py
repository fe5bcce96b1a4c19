"""Estimates of the flaws of one pair: each compares the simulated scan, without its displacement, with the real one."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from ...schemas.cause_catalogue import CAUSES, FLAT, LOSSES, PARAMETERS, UNEVEN
from ...schemas.sensor_models import SENSORS
from ..arrays import BoolArray, FloatArray, IndexArray
from ..linalg.nearest import search_tree
from ..sensor_description import SensorDescription, has_other_beams
from ..trust import (
    BEAMS,
    ENOUGH,
    FRAME,
    ONE_SWEEP,
    RETURNS,
    ROAD,
    SAME_SWEEPS,
    STEPS,
    UNCROPPED,
    UPRIGHT,
    cropped_box,
)
from .beams import blurred_elevation_deg, road_blur_deg2, second_returns
from .distance import best_case_distance, distances, sample_rows, surface_distance
from .losses import FEWEST_OF_KIND, fit_losses
from .pose import Pose, fit_pose, undo_elevation_scale
from .shapes import find_strays, flat_shapes, foliage_steps
from .sides import PairScans, Side, noise_bounds
from .unmatched import (
    Explained,
    Unmatched,
    explain_directions,
    find_unmatched,
    in_gap,
    least_range_m,
    near,
)

_LEAST_POINTS = 50  # of a side that has a surface to compare
_LEAST_MOVED_M = 0.005  # mean displacement whose part in the distance is measured
_NOISY_M = 0.1  # range error that counts as a whole
_NOISY_DEG = 0.3  # angular error that counts as a whole
#: Share of second returns that are removed before anything else is estimated.
_MANY_SECOND = 0.002
_FEWEST_PLACES = 50  # of foliage, or of curved surface
_LEAF_STEP_M = 0.3
_FAR_SURFACE_M = 20.0
_FEWEST_FAR = 50
_STRAY_POINTS = 20_000
_FEWEST_BEYOND = 10  # returns; fewer may be lost by chance
_TOO_MANY_STRAYS = 0.09  # of mixed pixels
_MISSING_ROAD = 0.5  # of the points of the real road
_SPARSE = 0.15  # of the returns of the other side
_OTHER_VIEW_DEG = 45.0
_FEWEST_OF_BEAM = 100  # simulated returns per real beam, of which all beams are recognised
_LOW_SHARE = 0.1  # of the points, below all those of the other side
_ALIKE = 0.05  # azimuth steps
_TILTS = [PARAMETERS.index("roll"), PARAMETERS.index("pitch")]
_BLURRING_DEG = 0.5


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
    if min(len(scans.real.points), len(scans.sim.points)) < _LEAST_POINTS:
        return None
    doubts = doubts_of(scans.real.sensor, scans.sim.sensor)
    real, real_second_share = _without_second_returns(scans.real)
    sim, second_share = _without_second_returns(scans.sim)
    fit = fit_pose(real, sim)
    if fit is None:
        return None
    pose, aligned = fit
    explained = explain_directions(real, aligned)
    distance_m = surface_distance(scans.real.tree, scans.sim.tree)
    best_case_m = best_case_distance(scans.real, sim, aligned, np.random.default_rng(seed))
    amounts = _pose_amounts(pose, real, sim, best_case_m)
    more_second = second_share - real_second_share
    amounts["second returns"] = _difference(real_second_share, second_share, share=more_second)
    amounts |= _amounts(real, aligned, sim, explained)
    doubts = _doubts_of_pair(real, aligned, sim, explained, amounts["mixed pixels"]) | doubts
    doubts |= _doubts_of_pose(pose, sim)
    return PairEstimates(pose, only_known(amounts, doubts), distance_m, best_case_m)


def _doubts_of_pair(
    real: Side, sim: Side, recorded: Side, explained: Explained, strays: Amount
) -> dict[str, str]:
    """Reasons why something is unknown of both sides together, see `trust`."""
    doubts = {}
    if (strays.amount or 0.0) > _TOO_MANY_STRAYS:
        text = f"simulated scan: {strays.amount:.0%} of its points float off smooth surface: second returns in others?"
        doubts = dict.fromkeys((ONE_SWEEP, SAME_SWEEPS, BEAMS), text)
    if not _SPARSE < explained.real_per_sim < 1 / _SPARSE:
        sparse = "real" if explained.real_per_sim < 1 else "simulated"
        doubts[ENOUGH] = f"{sparse} scan: too few returns, compared with the other side"
    if unlike := _unlike_patterns(real, sim, recorded):
        doubts[BEAMS] = unlike
    if _is_without_road(real, sim, explained) or _is_above(sim, real):
        doubts[ROAD] = "simulated scan: the road of the real scan is missing"
    elif _is_above(real, sim):
        doubts[ROAD] = doubts[UNCROPPED] = (
            "real scan: the road of the simulated scan is missing"
        )
    for name, side, other in (("real", real, sim), ("simulated", sim, real)):
        if box := cropped_box(side.points, other.points):
            low_x, low_y, high_x, high_y = box
            doubts[UNCROPPED] = (
                f"{name} scan: cropped to x {low_x:.0f} to {high_x:.0f} and y {low_y:.0f} to {high_y:.0f} m? "
                "set input.include_box for both sides"
            )
    return doubts


def _doubts_of_pose(pose: Pose, sim: Side) -> dict[str, str]:
    """The doubt that a tilt blurs the beams of a side, although they are recognised."""
    tilt_deg = float(np.abs(pose.displacement.values[_TILTS]).max())
    if not sim.sensor.elevation_deg or tilt_deg < _BLURRING_DEG:
        return {}
    return {UPRIGHT: f"simulated scan: tilted by {tilt_deg:.1f} degrees, which blurs its beams"}


def _is_without_road(real: Side, sim: Side, explained: Explained) -> bool:
    """True if most of the real road has no simulated surface around it, also in directions with simulated returns."""
    road = np.flatnonzero(real.is_ground & ~explained.is_blind & ~explained.is_dead)
    if len(road) < _LEAST_POINTS:
        return False
    few = road[:: len(road) // _LEAST_POINTS]
    return bool(near(real.chosen(few), sim.tree).mean() < 1.0 - _MISSING_ROAD)


def _is_above(side: Side, other: Side) -> bool:
    """True if many points of the other side are lower than those of a side, and have none around them."""
    low_m = np.quantile(side.points[:, 2], 0.01)
    low = np.flatnonzero((other.points[:, 2] < low_m) & ~in_gap(other, side))
    if len(low) < max(_LEAST_POINTS, _LOW_SHARE * len(other.points)):
        return False
    few = low[:: len(low) // _LEAST_POINTS]
    n_apart = len(low) * float(1.0 - near(other.chosen(few), side.tree).mean())
    return n_apart > _LOW_SHARE * len(other.points)


def _unlike_patterns(real: Side, sim: Side, recorded: Side) -> str | None:
    """Reason why the returns of both sides cannot be counted per direction: beams on one side are not rings."""
    for name, rings, other, as_recorded in (
        ("simulated", real, sim, recorded),
        ("real", sim, real, real),
    ):
        is_compared = rings.sensor.elevation_deg and not other.sensor.elevation_deg
        if is_compared and blurred_elevation_deg(rings.sensor, as_recorded) is None:
            return f"{name} scan: its beams are not rings, those of the other side are"
    return None


def doubts_of(real: SensorDescription, sim: SensorDescription) -> dict[str, str]:
    """Reasons why something is unknown of either side, see `trust`."""
    doubts: dict[str, str] = {}
    for side, sensor, other in (("real", real, sim), ("simulated", sim, real)):
        for need, text in sensor.doubts.items():
            doubts.setdefault(need, f"{side} scan: {text}")
        if finer := _finer_text(sensor, other):
            doubts[STEPS] = f"{side} scan: {finer}"
    if (ONE_SWEEP in real.doubts) != (ONE_SWEEP in sim.doubts):
        doubts[SAME_SWEEPS] = doubts[ONE_SWEEP]
    if (
        real.elevation_deg
        and sim.elevation_deg
        and (real.azimuth_step_deg is None) != (sim.azimuth_step_deg is None)
    ):
        doubts.setdefault(BEAMS, _why_unknown(real, sim, "azimuth_step_deg"))
    return doubts


def _finer_text(sensor: SensorDescription, other: SensorDescription) -> str | None:
    """Doubt that one scan holds several sweeps with evenly spaced azimuths; None if its sensor model is as fine."""
    step_deg = sensor.azimuth_step_deg
    if not step_deg or not other.azimuth_step_deg or has_other_beams(sensor, other):
        return None
    ratio = other.azimuth_step_deg / step_deg
    n_sweeps = round(ratio)
    is_usual = any(
        known.title in (sensor.model or "") and step_deg / known.azimuth_step_deg > 1 - _ALIKE
        for known in SENSORS.values()
    )
    if n_sweeps < 2 or is_usual or abs(ratio / n_sweeps - 1) > _ALIKE:
        return None
    return (
        f"its azimuth step is {n_sweeps} times as fine as that of the other side: "
        f"{n_sweeps} sweeps in one scan, or a finer sensor?"
    )


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
    if min(len(base.points), len(sim.points)) < _LEAST_POINTS:
        return None
    fit = fit_pose(base, sim)
    if fit is None:
        return None
    pose, aligned = fit
    amounts = dict(zip(PARAMETERS, pose.displacement.values.tolist(), strict=True))
    if pose.elevation_scale is not None:
        amounts["elevation scale"] = pose.elevation_scale
    if base.sensor.elevation_deg:
        explained = explain_directions(base, aligned)
        of_sensor = _sensor_amounts(base, aligned, sim, explained)
        for name in ("beams", "elevation noise", "exchanged beams"):
            amount = of_sensor[name].amount
            if amount is not None:
                amounts[name] = amount
    doubts = doubts_of(base.sensor, sim.sensor) | _doubts_of_pose(pose, sim)
    certain = [name for name in amounts if doubts.keys().isdisjoint(CAUSES[name].needs)]
    return pose, {name: amounts[name] for name in certain}


def _difference(real: float, sim: float, share: float | None = None) -> Amount:
    return Amount(sim - real, real, sim, share)


def _without_second_returns(side: Side) -> tuple[Side, float]:
    """The side without second returns if it has more than a few, and their share."""
    is_second = second_returns(side)
    share = float(is_second.mean())
    if RETURNS in side.sensor.doubts:
        return side.chosen(~second_returns(side, behind_m=0.0)), share
    if share > _MANY_SECOND:
        return side.chosen(~is_second), share
    return side, share


def _pose_amounts(pose: Pose, real: Side, sim: Side, best_case_m: float) -> dict[str, Amount]:
    """Amounts of the displacement and of the elevation scale.

    The share of each is its part of the distance from the simulated to the real surface that the others leave: how much
    of the distance over the best case disappears if it is undone as well. A displacement moves everything: the share is
    0 if undoing it takes what stands on the road farther away, as of a road of another slope.
    """
    displacement = pose.displacement
    rows = sample_rows(len(sim.points))
    points = sim.points[rows]
    is_low = sim.moves_with_road[rows]
    rescaled = undo_elevation_scale(points, pose.elevation_scale or 0.0)
    after_m = distances(real.tree, displacement.undo(rescaled, is_low))
    left_m = max(float(after_m.mean()) - best_case_m, 0.0)
    whole = displacement.of(rescaled, is_low)

    def share_of(before: FloatArray, moves_all: bool = True) -> float:
        """Part of the distance of these points, over the best case, that the rest of the pose removes."""
        before_m = distances(real.tree, before)
        gain_m = float(before_m.mean() - after_m.mean())
        if gain_m <= 0 or (moves_all and (before_m - after_m)[~is_low].sum() < 0):
            return 0.0
        return gain_m / (gain_m + left_m)

    amounts = {}
    for i, name in enumerate(PARAMETERS):
        without = displacement.without(i)
        moved_m = np.linalg.norm(whole - without.of(rescaled, is_low), axis=1)
        share = 0.0
        if moved_m.mean() > _LEAST_MOVED_M:
            share = share_of(without.undo(rescaled, is_low), name != "road height")
        amounts[name] = Amount(float(displacement.values[i]), share=share)
    scale = Amount(None, reason="the beams of both sides do not correspond")
    if pose.elevation_scale is not None:
        scale = Amount(pose.elevation_scale, share=share_of(displacement.undo(points, is_low)))
    return amounts | {"elevation scale": scale}


def _amounts(real: Side, sim: Side, recorded: Side, explained: Explained) -> dict[str, Amount]:
    """The amounts of a pair whose simulated side is without its displacement, except for those of the pose.

    Parameters
    ----------
    recorded : the simulated side as recorded, with its displacement
    """
    missing, invented = find_unmatched(real, sim, explained)
    missing_parts = real.points[missing.is_part | missing.is_moved]
    invented_parts = sim.points[invented.is_part | invented.is_moved]
    parts = search_tree(np.vstack([missing_parts, invented_parts]))
    is_used_real = ~(near(real, parts) | missing.is_beyond | explained.real)
    is_used_sim = ~(near(sim, parts) | explained.sim)
    return {
        "maximum range": _maximum_range(
            real.chosen(~explained.real), sim.chosen(~explained.sim)
        ),
        "minimum range": _difference(least_range_m(real), least_range_m(sim)),
        "moved parts": _share_of(missing.is_moved),
        "missing parts": _share_of(missing.is_part),
        "invented parts": _share_of(invented.is_part),
        "clutter": _share_of(invented.is_clutter),
        "mixed pixels": _stray_amount(real, recorded),
        "blind sector": Amount(explained.blind_deg, share=float(explained.is_blind.mean())),
        "far surface": _far_surface(real, missing, explained),
        **_losses(real, sim, is_used_real, is_used_sim, explained.dead),
        "solid foliage": _foliage_amount(real, sim),
        FLAT: _flat_amount(real, sim),
        **_sensor_amounts(real, sim, recorded, explained),
    }


def _share_of(is_concerned: BoolArray) -> Amount:
    share = float(is_concerned.mean())
    return Amount(share, share=share)


def _maximum_range(real: Side, sim: Side) -> Amount:
    """Difference of the farthest returns in common directions.

    It is 0 if one side has only a few beyond the farthest of the other, by the density of the sparser one.
    """
    n_real = len(real.points)
    n_sim = len(sim.points)
    if not min(n_real, n_sim):
        return Amount(None, reason="the two sides have no direction in common")
    real_m = float(real.range_m.max())
    sim_m = float(sim.range_m.max())
    share = float((real.range_m > sim_m).mean() + (sim.range_m > real_m).mean())
    if share * min(n_real, n_sim) < _FEWEST_BEYOND:
        return Amount(0.0, real_m, sim_m, 0.0)
    return _difference(real_m, sim_m, share)


def _stray_amount(real: Side, sim: Side) -> Amount:
    if not real.sensor.elevation_deg and not sim.sensor.elevation_deg:
        # the sensor may be elsewhere
        return _unknown(real.sensor, sim.sensor, "elevation_deg")
    real_share = _stray_share(real)
    sim_share = _stray_share(sim)
    return _difference(real_share, sim_share, abs(sim_share - real_share))


def _stray_share(side: Side) -> float:
    """Strays over the returns on smooth surface, of every k-th return."""
    order = side.ray_tree.indices  # neighbours next to each other, which speeds up the search
    every = len(order) // _STRAY_POINTS + 1
    is_stray, is_smooth = find_strays(side, order[order % every == 0])
    return float(is_stray.sum() / max(is_smooth.sum(), 1))


def _far_surface(real: Side, missing: Unmatched, explained: Explained) -> Amount:
    """Share of the object points beyond 20 m without a simulated counterpart, minus that share nearer."""
    is_object = ~real.is_ground & ~explained.real & ~missing.is_beyond
    is_far = is_object & (real.range_m > _FAR_SURFACE_M)
    is_near = is_object & ~is_far
    if min(is_far.sum(), is_near.sum()) < _FEWEST_FAR:
        return Amount(
            None,
            reason=f"fewer than {_FEWEST_FAR} object points beyond or within {_FAR_SURFACE_M:g} m",
        )
    far = float(missing.is_apart[is_far].mean())
    near = float(missing.is_apart[is_near].mean())
    return _difference(near, far, (far - near) * float(is_far.sum() / is_object.sum()))


def _foliage_amount(real: Side, sim: Side) -> Amount:
    _, step_m = foliage_steps(real, sim)
    if len(step_m) < _FEWEST_PLACES:
        return Amount(None, reason=f"fewer than {_FEWEST_PLACES} returns of foliage")
    early = float((step_m < -_LEAF_STEP_M).mean())
    late = float((step_m > _LEAF_STEP_M).mean())
    return Amount(early - late, share=abs(early - late) * len(step_m) / len(real.points))


def _flat_amount(real: Side, sim: Side) -> Amount:
    places, is_flat = flat_shapes(real, sim)
    if len(is_flat) < _FEWEST_PLACES:
        return Amount(
            None,
            reason=f"fewer than {_FEWEST_PLACES} places of curved surface near the road",
        )
    flat = float(is_flat.mean())
    return Amount(flat, share=flat * len(places) / len(real.points))


def _sensor_amounts(
    real: Side, sim: Side, recorded: Side, explained: Explained
) -> dict[str, Amount]:
    """Amounts that follow from the descriptions of both sensors."""
    a, b = real.sensor, sim.sensor
    step = _known_difference(a, b, "azimuth_step_deg")
    azimuth_noise = _known_difference(a, b, "azimuth_noise_deg", "azimuth_step_deg")
    range_steps = _unknown(a, b, "elevation_deg")
    if b.elevation_deg:
        range_steps = _difference(a.range_quantum_m or 0.0, b.range_quantum_m or 0.0)
    return {
        "range noise": _with_share(_noise_amount(a, b), _NOISY_M),
        "azimuth step": _with_share(step, a.azimuth_step_deg or 1.0),
        "azimuth noise": _with_share(azimuth_noise, _NOISY_DEG),
        "elevation noise": _with_share(_elevation_noise(real, sim, recorded), _NOISY_DEG),
        "beams": _beam_amount(real, sim, recorded, explained),
        "exchanged beams": _exchanged_amount(real, sim, explained),
        "range steps": _with_share(range_steps, _NOISY_M),
    }


def _noise_amount(real: SensorDescription, sim: SensorDescription) -> Amount:
    """Difference between the lower estimate of one side and the upper one of the other; 0 if they overlap.

    It is unknown if the steps of a side alone deviate more, q / sqrt(12), than its noise beyond them.
    """
    real_m, sim_m = noise_bounds(real), noise_bounds(sim)
    if real_m is None or sim_m is None:
        return _unknown(real, sim, "range_noise_m")
    for side, sensor, (_, noise_m) in (("real", real, real_m), ("simulated", sim, sim_m)):
        step_m = sensor.range_quantum_m or 0.0
        if step_m / np.sqrt(12) > noise_m:
            return Amount(
                None, reason=f"{side} scan: range steps of {100 * step_m:.3g} cm hide it"
            )
    amount = max(sim_m[0] - real_m[1], 0.0) + min(sim_m[1] - real_m[0], 0.0)
    return Amount(amount, real_m[1], sim_m[1])


def _known_difference(
    real: SensorDescription, sim: SensorDescription, field: str, cause: str | None = None
) -> Amount:
    """Difference of a property of both sensors, unknown for the reason of another one if `cause` is given."""
    values = getattr(real, field), getattr(sim, field)
    if None in values:
        return replace(_unknown(real, sim, cause or field), real=values[0], sim=values[1])
    return _difference(*values)


def _unknown(real: SensorDescription, sim: SensorDescription, field: str) -> Amount:
    return Amount(None, reason=_why_unknown(real, sim, field))


def _why_unknown(real: SensorDescription, sim: SensorDescription, field: str) -> str:
    """Reason why a property of one of the sensors is unknown."""
    for side, sensor in (("real", real), ("simulated", sim)):
        if reason := sensor.why_unknown(field):
            return f"{side} scan: {reason}"
    return "unknown on one side"


def _with_share(amount: Amount, whole: float) -> Amount:
    """The amount with the share of the surface that it affects: its part of an amount that affects the whole."""
    if amount.amount is None:
        return amount
    return replace(amount, share=min(abs(amount.amount) / whole, 1.0))


def _elevation_noise(real: Side, sim: Side, recorded: Side) -> Amount:
    """Noise of the elevations; if the simulated beams cannot be recognised, from their phase or from the road."""
    a, b = real.sensor, sim.sensor
    if a.field_of_view_deg and b.field_of_view_deg:
        around_deg = a.field_of_view_deg[-1], b.field_of_view_deg[-1]
        if abs(around_deg[0] - around_deg[1]) > _OTHER_VIEW_DEG:
            return Amount(None, reason="the fields of view differ")
    known = _known_difference(a, b, "elevation_noise_deg", "elevation_deg")
    if known.amount is not None or not a.elevation_deg:
        return known
    # lowest beams may be dead
    is_seen = real.elevation_deg > np.quantile(sim.elevation_deg, 0.001)
    real_deg = blurred_elevation_deg(a, real.chosen(is_seen))
    sim_deg = blurred_elevation_deg(a, recorded)
    if real_deg is not None and sim_deg is not None:
        return _difference(real_deg, sim_deg)
    real_blur = road_blur_deg2(real)
    sim_blur = road_blur_deg2(sim)
    if real_blur is None or sim_blur is None or sim_blur <= real_blur:
        return known
    return Amount(float(np.sqrt(sim_blur - real_blur)))


def _beam_amount(real: Side, sim: Side, recorded: Side, explained: Explained) -> Amount:
    """Beams more or fewer than the real sensor's; dead ones are counted if the simulated ones are not distinct, or few.

    Exchanged beams can appear as further ones. Beams that only see what a minimum range cuts off do not count.
    """
    n_real = len(real.sensor.elevation_deg)
    n_sim = len(sim.sensor.elevation_deg)
    if not n_real or (not n_sim and blurred_elevation_deg(real.sensor, recorded) is None):
        return _unknown(real.sensor, sim.sensor, "elevation_deg")
    n_dead = len(explained.dead)
    if explained.exchanged and n_sim > n_real:
        n_sim = n_real
    elif not n_sim or (n_dead and not sim.sensor.is_sharp):
        n_sim = n_real - n_dead
    elif n_sim < n_real and len(sim.points) < _FEWEST_OF_BEAM * n_real:
        n_sim = max(n_sim, n_real - n_dead)
    share = float(explained.is_dead.mean()) if n_dead else abs(n_sim - n_real) / n_real
    return _difference(n_real, n_sim, share)


def _exchanged_amount(real: Side, sim: Side, explained: Explained) -> Amount:
    if not real.sensor.elevation_deg:
        return _unknown(real.sensor, sim.sensor, "elevation_deg")
    return Amount(2.0 * len(explained.exchanged), share=float(explained.sim.mean()))


def _losses(
    real: Side, sim: Side, is_used_real: BoolArray, is_used_sim: BoolArray, dead: IndexArray
) -> dict[str, Amount]:
    """Shares of lost returns, see `losses`, and their unevenness."""
    losses = fit_losses(real, sim, is_used_real, is_used_sim, dead)
    if losses is None:
        amounts = dict.fromkeys(LOSSES, Amount(None, reason="no surface that both sides see"))
        return {UNEVEN: Amount(0.0), **amounts}
    amounts = {UNEVEN: Amount(losses.pop(UNEVEN))}
    for name in LOSSES:
        amounts[name] = Amount(None, reason=f"fewer than {FEWEST_OF_KIND} such returns")
    for name, lost in losses.items():
        amounts[name] = Amount(lost, share=abs(lost) * float(real.concerned(name).mean()))
    return amounts
