"""What sensor a scan is from: its beams, steps and noise as the points alone show them, and the model if it is known."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from scipy.ndimage import gaussian_filter1d
from scipy.signal import find_peaks

from ..arrays import BoolArray, FloatArray, IndexArray, IntArray
from .beam_patterns import BeamPattern, find_beams, recognise
from .plausibility import widest_azimuth_gap_deg

#: Limits of the bands of range, metres, for which the share of lost pulses is told.
LOST_BANDS_M = (0.0, 10.0, 20.0, 40.0, 80.0)
_FEWEST_POINTS = 500
_QUANTA_M = (0.05, 0.02, 0.01, 0.008, 0.005, 0.004, 0.003, 0.002, 0.001, 0.0005)
_QUANTUM_RANGE_M = 30.0
_RUN = 9  # returns of a beam one after the other
_RUN_QUARTILE = 0.759  # sqrt(quartile of chi squared / degrees of freedom), six degrees
_HOLE = 5  # pulses


@dataclass(frozen=True)
class SensorFacts:
    """What a scan shows of its sensor; what cannot be told is None, or (), and `untold` has the reason.

    elevation_deg : of its beams, ascending
    is_even : whether all neighbouring beams are equally far apart
    is_sharp : whether the beams stand out in the whole scan; else, as after compensation for motion, they were read in
        a sector, and their number is about so
    origin_height_m : heights above the sensor's origin at which the beams start: of all, or of a lower and an upper block
    field_of_view_deg : lowest and highest elevation of a return, and the sector of azimuth that has returns
    azimuth_step_deg : between two firings of a beam
    range_quantum_m : that ranges are multiples of
    range_noise_m : standard deviation along the ray on smooth surfaces
    lost_share : by band of range, see `LOST_BANDS_M`: share of the pulses that are missing in surfaces that are seen
    has_ring, has_time : whether each point has its beam's number, and its time
    model : title of the known sensor with these beams
    untold : by field, why it is not told
    """

    n_points: int
    elevation_deg: tuple[float, ...] = ()
    is_even: bool | None = None
    is_sharp: bool | None = None
    origin_height_m: tuple[float, ...] = ()
    field_of_view_deg: tuple[float, ...] = ()
    azimuth_step_deg: float | None = None
    range_quantum_m: float | None = None
    range_noise_m: float | None = None
    lost_share: tuple[float | None, ...] = ()
    has_ring: bool = False
    has_time: bool = False
    model: str | None = None
    untold: dict[str, str] = field(default_factory=dict)


def describe_sensor(points: FloatArray, ring: IntArray | None = None, has_time: bool = False) -> SensorFacts:
    """What the points of one scan show of the sensor that made it.

    Elevations are the peaks of the density of z / r - h / r over all points, in angle, where r is the horizontal
    distance and h the height at which beams start; see `beam_patterns.find_beams`. With rings they are medians over
    each ring. Step: the commonest distance in azimuth of neighbouring returns of a beam. Quantum: the largest q of a
    list for which ranges R of a beam have |mean exp(2 pi i R / q)| >= 0.7. Noise: rms residual of a parabola through
    nine returns in a row, its lower quartile over all such runs, as a standard deviation. Lost: of the gaps between
    returns of one surface, the firings without one.

    Parameters
    ----------
    points : (n, 3) float64, metres, the frame of the sensor itself: z up, beams start on the z axis. Not finite and
        zero ones are left out. A scan that was moved or tilted out of that frame has no beams that could be told
    ring : (n,) int32, number of each point's beam, if the file has it
    has_time : whether the file has a time for each point
    """
    is_return = np.isfinite(points).all(axis=1) & points.any(axis=1)
    points, ring = points[is_return], None if ring is None else ring[is_return]
    facts = {"n_points": len(points), "has_ring": ring is not None, "has_time": has_time}
    if len(points) < _FEWEST_POINTS:
        few = f"{len(points)} points, at least {_FEWEST_POINTS} are needed"
        return SensorFacts(**facts, untold={"elevation_deg": few, "model": few})
    level = np.sqrt(points[:, 0] ** 2 + points[:, 1] ** 2)
    slope_deg = np.degrees(np.arctan2(points[:, 2], level))
    facts["field_of_view_deg"] = (
        round(float(slope_deg.min()), 2),
        round(float(slope_deg.max()), 2),
        round(360.0 - widest_azimuth_gap_deg(points), 1),
    )
    pattern = find_beams(points, ring)
    if isinstance(pattern, str):
        why = f"no beams are told ({pattern})"
        untold = {name: why for name in ("azimuth_step_deg", "range_quantum_m", "range_noise_m", "lost_share", "model")}
        return SensorFacts(**facts, untold={"elevation_deg": pattern, **untold})
    untold = {}
    sweep = _by_beam(points, pattern)
    step, untold["azimuth_step_deg"] = _azimuth_step(sweep)
    quantum, untold["range_quantum_m"] = _range_quantum(points, sweep)
    noise, untold["range_noise_m"] = _range_noise(sweep, step)
    lost, untold["lost_share"] = _lost_share(sweep, step)
    model, untold["model"] = recognise(pattern)
    return SensorFacts(
        **facts,
        elevation_deg=tuple(round(float(value), 3) for value in pattern.elevation_deg),
        is_even=pattern.is_even,
        is_sharp=pattern.is_sharp,
        origin_height_m=pattern.origin_height_m,
        azimuth_step_deg=step,
        range_quantum_m=quantum,
        range_noise_m=noise,
        lost_share=lost,
        model=model,
        untold={name: why for name, why in untold.items() if why},
    )


def differences(real: SensorFacts, sim: SensorFacts) -> list[str]:
    """One sentence for each thing in which the sensors of the two sides differ; nothing about what is not told.

    Elevations differ if their number or limits do (by more than 0.3 degrees, or three beams), or if they are even on
    one side alone; steps by more than 5 %, quanta at all, noise by a factor of 1.5 and 5 mm, lost shares by 5 points.
    """
    found = []
    if real.elevation_deg and sim.elevation_deg:
        limits = np.abs(np.subtract(_limits(real), _limits(sim))).max()
        n_apart = abs(len(real.elevation_deg) - len(sim.elevation_deg))
        if limits > 0.3 or n_apart > 2 or real.is_even != sim.is_even:
            found.append(f"real: {beams_text(real)}; simulated: {beams_text(sim)}")
    elif real.elevation_deg or sim.elevation_deg:
        found.append(f"real: {beams_text(real)}; simulated: {beams_text(sim)}")
    if real.azimuth_step_deg and sim.azimuth_step_deg:
        if abs(np.log(real.azimuth_step_deg / sim.azimuth_step_deg)) > np.log(1.05):
            found.append(f"azimuth step: {real.azimuth_step_deg:.3f} degrees real, {sim.azimuth_step_deg:.3f} simulated")
    if "range_quantum_m" not in {*real.untold, *sim.untold} or (real.range_quantum_m and sim.elevation_deg):
        if real.range_quantum_m != sim.range_quantum_m:
            found.append(f"range quantum: {_millimetres(real)} real, {_millimetres(sim)} simulated")
    if real.range_noise_m is not None and sim.range_noise_m is not None:
        low, high = sorted((real.range_noise_m, sim.range_noise_m))
        if high > 1.5 * low and high - low > 0.005:
            found.append(
                f"range noise on smooth surfaces: {1e3 * real.range_noise_m:.0f} mm real, "
                f"{1e3 * sim.range_noise_m:.0f} mm simulated"
            )
    for low_m, high_m, a, b in zip(LOST_BANDS_M, LOST_BANDS_M[1:], real.lost_share, sim.lost_share, strict=False):
        if a is not None and b is not None and abs(a - b) > 0.05:
            found.append(f"pulses lost in surfaces {low_m:.0f} to {high_m:.0f} m away: {a:.0%} real, {b:.0%} simulated")
    if real.has_time != sim.has_time:
        found.append(f"a time for each point: {_yes(real.has_time)} real, {_yes(sim.has_time)} simulated")
    return found


def beams_text(facts: SensorFacts) -> str:
    """Number, range and spacing of the beams, and the model: "32 beams, -25 to +15 degrees, uneven: ..."."""
    if not facts.elevation_deg:
        return f"beams not told ({facts.untold['elevation_deg']})"
    low, high = _limits(facts)
    evenness = "evenly spaced" if facts.is_even else "uneven"
    about = "" if facts.is_sharp else "about "
    text = f"{about}{len(facts.elevation_deg)} beams, {low:+.4g} to {high:+.4g} degrees, {evenness}"
    return f"{text}: {facts.model}" if facts.model else f"{text}: {facts.untold['model']}"


def _limits(facts: SensorFacts) -> tuple[float, float]:
    return facts.elevation_deg[0], facts.elevation_deg[-1]


def _millimetres(facts: SensorFacts) -> str:
    return "none" if facts.range_quantum_m is None else f"{1e3 * facts.range_quantum_m:g} mm"


def _yes(has: bool) -> str:
    return "yes" if has else "no"


@dataclass(frozen=True)
class _Sweep:
    """Returns that lie in a beam, sorted by beam and in it by azimuth.

    beam : (m,) intp, row of the pattern's elevations
    azimuth_deg, range_m : (m,) float64
    """

    beam: IndexArray
    azimuth_deg: FloatArray
    range_m: FloatArray

    @property
    def gap_deg(self) -> FloatArray:
        """(m - 1,) float64, from each return to the next; NaN where that is another beam's."""
        return np.where(np.diff(self.beam) == 0, np.diff(self.azimuth_deg), np.nan)


def _by_beam(points: FloatArray, pattern: BeamPattern) -> _Sweep:
    beam = pattern.beam_of(points)
    points, beam = points[beam >= 0], beam[beam >= 0]
    azimuth_deg = np.degrees(np.arctan2(points[:, 1], points[:, 0]))
    range_m = np.sqrt((points**2).sum(axis=1))
    order = np.lexsort((range_m, azimuth_deg, beam))
    return _Sweep(beam[order], azimuth_deg[order], range_m[order])


def _azimuth_step(sweep: _Sweep) -> tuple[float | None, str]:
    bin_deg, most_deg = 0.002, 4.0
    gap = sweep.gap_deg
    gap = gap[(gap > 0.02) & (gap < most_deg)]
    if len(gap) < _FEWEST_POINTS:
        return None, "too few neighbouring returns"
    count = np.bincount((gap / bin_deg).astype(np.intp), minlength=int(most_deg / bin_deg)).astype(np.float64)
    density = gaussian_filter1d(count, 3.0)
    peaks, _ = find_peaks(density, height=0.4 * density.max())
    step = (peaks[0] + 0.5) * bin_deg
    near = gap[np.abs(gap / step - 1.0) < 0.15]
    if len(near) < 0.15 * len(gap):
        return None, "neighbouring returns have no common distance in azimuth"
    return round(float(np.median(near)), 4), ""


def _range_quantum(points: FloatArray, sweep: _Sweep) -> tuple[float | None, str]:
    for step_m in (0.01, 0.001):
        if np.mean(np.abs(points / step_m - np.round(points / step_m)) < 0.02) > 0.98:
            return None, f"coordinates are rounded to {1e3 * step_m:g} mm"
    is_near = sweep.range_m < _QUANTUM_RANGE_M
    beam, range_m = sweep.beam[is_near], sweep.range_m[is_near]
    n_returns = np.bincount(beam)
    used = n_returns >= 50
    if n_returns[used].sum() < _FEWEST_POINTS:
        return None, f"too few returns nearer than {_QUANTUM_RANGE_M:g} m"
    for quantum in _QUANTA_M:
        turn = 2 * np.pi * range_m / quantum
        length = np.hypot(np.bincount(beam, np.cos(turn)), np.bincount(beam, np.sin(turn)))
        if length[used].sum() / n_returns[used].sum() >= 0.7:
            return quantum, ""
    return None, f"no quantum from {1e3 * _QUANTA_M[-1]:g} to {1e3 * _QUANTA_M[0]:g} mm"


def _range_noise(sweep: _Sweep, step_deg: float | None) -> tuple[float | None, str]:
    if step_deg is None or len(sweep.beam) < _RUN:
        return None, "no azimuth step is told"
    is_next = np.nan_to_num(sweep.gap_deg, nan=np.inf) < 1.5 * step_deg
    is_run: BoolArray = sliding_window_view(is_next, _RUN - 1).all(axis=1)
    runs = sliding_window_view(sweep.range_m, _RUN)[is_run]
    runs = runs[np.ptp(runs, axis=1) < 0.05 * runs.mean(axis=1)]
    if len(runs) < 200:
        return None, f"{len(runs)} runs of {_RUN} returns on a surface, at least 200 are needed"
    place = np.linspace(-1.0, 1.0, _RUN)
    basis = np.linalg.qr(np.stack([np.ones(_RUN), place, place**2], axis=1))[0]
    residual = runs - runs @ basis @ basis.T
    rms = np.sqrt((residual**2).sum(axis=1) / (_RUN - 3))
    return round(float(np.quantile(rms, 0.25)) / _RUN_QUARTILE, 4), ""


def _lost_share(sweep: _Sweep, step_deg: float | None) -> tuple[tuple[float | None, ...], str]:
    if step_deg is None:
        return (), "no azimuth step is told"
    n_firings = np.round(sweep.gap_deg / step_deg)
    nearer, farther = np.minimum(sweep.range_m[:-1], sweep.range_m[1:]), np.maximum(sweep.range_m[:-1], sweep.range_m[1:])
    is_surface = (n_firings >= 1) & (n_firings <= _HOLE + 1) & (farther - nearer < 0.03 * nearer + 0.05)
    shares: list[float | None] = []
    for low_m, high_m in zip(LOST_BANDS_M, LOST_BANDS_M[1:], strict=False):
        firings = n_firings[is_surface & (nearer >= low_m) & (nearer < high_m)]
        enough = len(firings) >= _FEWEST_POINTS
        shares.append(round(float(1.0 - len(firings) / firings.sum()), 3) if enough else None)
    return tuple(shares), ""
