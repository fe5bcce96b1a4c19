"""Description of the sensor of a scan from its points: beams, steps, noise, and the model if it is known."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import scipy
from numpy.lib.stride_tricks import sliding_window_view

from ..schemas.columns import FARTHEST_M
from .arrays import (
    FloatArray,
    IndexArray,
    IntArray,
    slopes_deg,
)
from .beam_patterns import BeamPattern, elevation_of_points, find_beams, recognise
from .plausibility import widest_azimuth_gap_deg
from .sweep import Sweep, sweep_of
from .trust import (
    BEAMS,
    FRAME,
    MISSES,
    ONE_SWEEP,
    RETURNS,
    alternation_text,
    doubts_of_rounding,
    doubts_without_beams,
    find_misses,
    image_text,
    later_returns,
    returns_text,
    rounding_of,
    sweeps_text,
    thinned_text,
)

#: Columns of table `sensor` that `pairs` has for both sides.
_PAIR_COLUMNS = (
    "n_beams",
    "azimuth_step_deg",
    "range_quantum_m",
    "range_noise_m",
    "lost_share",
)
#: Title, factor and text of the properties that may be undetermined.
_PROPERTIES = {
    "azimuth_step_deg": ("azimuth step", 1.0, "{:.3f} degrees"),
    "range_quantum_m": ("range quantum", 1e3, "{:g} mm"),
    "range_noise_m": ("range noise", 1e3, "at most {:.0f} mm, as roughness of surfaces counts"),
    "elevation_noise_deg": ("elevation noise", 1.0, "{:.3f} degrees"),
    "azimuth_noise_deg": ("azimuth noise", 1.0, "{:.3f} degrees"),
    "lost_share": ("pulses lost in surfaces", 1.0, "{:.0%}"),
}
_MIN_POINTS = 500
_HOLE = 5  # pulses that a gap within a surface may lack, at most
_QUANTA_M = (
    1.0,
    0.5,
    0.2,
    0.1,
    0.05,
    0.02,
    0.01,
    0.008,
    0.005,
    0.004,
    0.003,
    0.002,
    0.001,
    0.0005,
)
_QUANTUM_RANGE_M = 30.0
_LEAST_STEP_DEG = 0.02
_NEXT_STEPS = 1.45  # farthest next firing
_FINE_M = 0.0009  # coordinates that are rounded more show no quantum of ranges
_RUN = 9  # returns of a beam one after the other
_RUN_STEPS = 8  # from one return of a run to the next at most, if too few runs have no gap
_FEWEST_RUNS = 200
_MOST_LOST_M = 80.0  # range up to which lost pulses are counted
_MAD = 1.4826  # standard deviation over median absolute value
_RUN_QUARTILE = 0.759  # sqrt(quartile of chi squared / degrees of freedom), six degrees


@dataclass(frozen=True)
class SensorDescription:
    """Properties of the sensor of a scan; undetermined ones are None or (), and `untold` has the reason.

    elevation_deg : elevations of the beams, ascending
    is_even : all neighbouring beams have the same distance
    is_sharp : the beams are distinct in the whole scan; else, as after motion compensation, they are from a sector,
        and their number is approximate
    origin_height_m : heights of the beams' origin above the frame's origin: one for all, or one per block
    block_deg : elevation between the two blocks
    focal_m : distance from the axis at which the beams cross
    field_of_view_deg : lowest and highest elevation of a return, and the sector of azimuth that has returns
    azimuth_step_deg : angle between two firings of a beam, of most
    firing_deg : the same on average, which differs if firings are uneven
    range_quantum_m : ranges are multiples of it
    range_noise_m : standard deviation along the ray on smooth surfaces; rather too high, as their roughness counts
    range_noise_low_m : the same without the part that grows with the azimuth step; rather too low in dense scans
    elevation_noise_deg : standard deviation of the elevation of returns around that of their beam
    azimuth_noise_deg : standard deviation of the azimuth of returns around multiples of the step
    lost_share : share of the pulses without a return within visible surfaces, up to 80 m
    model : title of the known sensor with these beams, or of two sensors
    model_beams : number of beams in the table of the model
    untold : reason by undetermined field
    doubts : reason by what cannot be trusted, see `trust`
    """

    n_points: int
    elevation_deg: tuple[float, ...] = ()
    is_even: bool | None = None
    is_sharp: bool | None = None
    origin_height_m: tuple[float, ...] = ()
    block_deg: float = -90.0
    focal_m: float = 0.0
    field_of_view_deg: tuple[float, ...] = ()
    azimuth_step_deg: float | None = None
    firing_deg: float | None = None
    range_quantum_m: float | None = None
    range_noise_m: float | None = None
    range_noise_low_m: float | None = None
    elevation_noise_deg: float | None = None
    azimuth_noise_deg: float | None = None
    lost_share: float | None = None
    model: str | None = None
    model_beams: int | None = None
    untold: dict[str, str] = field(default_factory=dict)
    doubts: dict[str, str] = field(default_factory=dict)

    @property
    def beams_deg(self) -> FloatArray:
        """(b,) elevations of the beams, ascending."""
        return np.array(self.elevation_deg)

    def elevation_of(self, points: FloatArray) -> FloatArray:
        """(n,) degrees, elevation of each point seen from where its beam starts."""
        return elevation_of_points(points, self.origin_height_m, self.block_deg)

    def beam_of(self, points: FloatArray) -> IndexArray:
        """(n,) intp, the beam nearest in elevation to each point."""
        limits = (self.beams_deg[1:] + self.beams_deg[:-1]) / 2
        return np.searchsorted(limits, self.elevation_of(points))

    def why_unknown(self, name: str) -> str:
        """Reason why a field is undetermined, or "": its own, or that of the beams or of the step which it needs."""
        for key in (name, "elevation_deg", "azimuth_step_deg"):
            if key in self.untold:
                return self.untold[key]
        return ""


#: Gaps of lost pulses within visible surfaces, between two returns of one beam: (g, 2) intp, points before and after
#: each gap, and (g,) intp, 1 to 5 pulses.
SurfaceGaps = tuple[IndexArray, IndexArray]
NO_GAPS: SurfaceGaps = (np.empty((0, 2), dtype=int), np.empty(0, dtype=int))


def describe_sensor(points: FloatArray, ring: IntArray | None = None) -> SensorDescription:
    """Describe the sensor of a scan from its points, see `describe_with_gaps`."""
    return describe_with_gaps(points, ring)[0]


def describe_with_gaps(
    points: FloatArray, ring: IntArray | None = None
) -> tuple[SensorDescription, SurfaceGaps]:
    """Describe the sensor of a scan from its points, with the gaps from which the share of lost pulses is estimated.

    Elevations are the peaks of the density of z / r - h / r over all points, in angle, where r is the horizontal
    distance and h the height at which beams start; see `beam_patterns.find_beams`. With rings they are medians over
    each ring. Step: the most frequent distance in azimuth of neighbouring returns of a beam. Quantum: the largest q of
    a list for which ranges R of a beam have |mean exp(2 pi i R / q)| >= 0.7. Range noise: rms residual of a parabola
    through nine returns in a row, its lower quartile over all such runs, as a standard deviation; if fewer than 200
    runs have no gap, of returns up to eight steps apart. Angular noise: median absolute difference of elevations from
    that of their beam, and of neighbouring azimuths from one step, as standard deviations of one return. Lost: of the
    gaps between returns of one surface, the firings without one.

    Parameters
    ----------
    points : (n, 3) float64, metres, the frame of the sensor itself: z up, beams start on the z axis. Points that are
        zero, not finite, or beyond a million kilometres are ignored. Beams are not detectable in a scan that was moved
        or tilted out of that frame
    ring : (n,) int32, beam number of each point, if the file has it
    """
    is_return = (np.abs(points) <= FARTHEST_M).all(axis=1) & points.any(axis=1)
    rows = np.flatnonzero(is_return)
    sensor = SensorDescription(len(rows))
    range_m = np.linalg.norm(points[rows], axis=1)
    limit_m, misses = find_misses(range_m)
    if misses:
        sensor.doubts[MISSES] = misses
        rows = rows[range_m <= limit_m]
    if len(rows) < _MIN_POINTS:
        sensor.untold["elevation_deg"] = (
            f"{len(rows)} returns, at least {_MIN_POINTS} are needed"
        )
        return sensor, NO_GAPS
    points = points[rows]
    slope_deg = slopes_deg(points)
    around_deg = 360.0 - widest_azimuth_gap_deg(points)
    field_of_view_deg = (
        round(float(slope_deg.min()), 2),
        round(float(slope_deg.max()), 2),
        round(around_deg, 1),
    )
    sensor = replace(sensor, field_of_view_deg=field_of_view_deg)
    rounding_m = rounding_of(points)
    sensor.doubts.update(doubts_of_rounding(rounding_m))
    if FRAME in sensor.doubts:
        sensor.untold["elevation_deg"] = sensor.doubts[FRAME]
        return sensor, NO_GAPS
    pattern = find_beams(points, None if ring is None else ring[rows])
    if isinstance(pattern, str):
        sensor.untold["elevation_deg"] = pattern
        sensor.doubts.update(doubts_without_beams(points))
        return sensor, NO_GAPS
    sensor, (gaps, n_lost) = _describe_beams(sensor, points, pattern, rounding_m)
    return sensor, (rows[gaps], n_lost)


def _describe_beams(
    sensor: SensorDescription, points: FloatArray, pattern: BeamPattern, rounding_m: float
) -> tuple[SensorDescription, SurfaceGaps]:
    """The description with all that follows from the beams, and the gaps of lost pulses between the points."""
    sweep, step = _sweep_and_step(sensor.doubts, points, pattern)
    quantum = _range_quantum(sweep, rounding_m)
    estimates: dict[str, Any] = {"azimuth_step_deg": step, "range_quantum_m": quantum}
    gaps = NO_GAPS
    if not isinstance(step, str):
        noise = _range_noise(sweep, step)
        n_firings = _surface_firings(sweep, step)
        before = np.flatnonzero(n_firings > 1)
        gaps = (
            np.column_stack([sweep.row[before], sweep.row[before + 1]]),
            n_firings[before] - 1,
        )
        estimates |= {
            "firing_deg": _firing_deg(sweep, step),
            "range_noise_m": noise,
            "range_noise_low_m": _least_range_noise(sweep, step, noise),
            "azimuth_noise_deg": _azimuth_noise(sweep, step),
            "lost_share": _lost_share(sweep, n_firings),
        }
    untold = {name: value for name, value in estimates.items() if isinstance(value, str)}
    known = estimates | dict.fromkeys(untold)
    model = recognise(pattern, known["azimuth_step_deg"], known["range_quantum_m"])
    if not model.title:
        untold["model"] = model.reason
    sensor = replace(
        sensor,
        elevation_deg=tuple(round(float(value), 3) for value in pattern.elevation_deg),
        is_even=pattern.is_even,
        is_sharp=pattern.is_sharp,
        origin_height_m=pattern.origin_height_m,
        block_deg=pattern.block_deg,
        focal_m=pattern.focal_m,
        elevation_noise_deg=_spread(sweep.off_deg),
        model=model.title,
        model_beams=model.n_beams,
        untold=untold,
        **known,
    )
    return sensor, gaps


def _sweep_and_step(
    doubts: dict[str, str], points: FloatArray, pattern: BeamPattern
) -> tuple[Sweep, float | str]:
    """First returns of a scan, and their azimuth step or the reason why it is unknown; adds doubts about both."""
    sweep = sweep_of(points, pattern)
    is_later = later_returns(sweep)
    returns = returns_text(is_later)
    if returns:
        sweep = sweep.first_returns(is_later)
    step = _azimuth_step(sweep)
    if several := _not_one_sweep_text(sweep, step, pattern):
        doubts[ONE_SWEEP] = several
        return sweep, several
    if returns:
        doubts[RETURNS] = returns
    if thinned := thinned_text(sweep, points):
        doubts[BEAMS] = thinned
        return sweep, thinned
    return sweep, step


def _not_one_sweep_text(sweep: Sweep, step: float | str, pattern: BeamPattern) -> str | None:
    """The doubt that a scan holds other directions than those of one sweep; None if it does not."""
    text = sweeps_text(sweep) or alternation_text(sweep)
    if text or isinstance(step, str):
        return text
    return image_text(sweep.azimuth_deg, step, pattern.elevation_deg)


def sensor_row(sensor: SensorDescription) -> dict[str, Any]:
    """Columns of table `sensor`; None if undetermined, and then `reason` has the causes."""
    heights_m = sensor.origin_height_m
    height_m = float(np.mean([heights_m[0], heights_m[-1]])) if heights_m else 0.0
    return {
        "model": sensor.model,
        "n_beams": len(sensor.elevation_deg) or None,
        "lowest_deg": min(sensor.elevation_deg, default=None),
        "highest_deg": max(sensor.elevation_deg, default=None),
        "origin_height_m": height_m if sensor.elevation_deg else None,
        **{name: getattr(sensor, name) for name in _PROPERTIES},
        "reason": "; ".join(f"{name}: {reason}" for name, reason in sensor.untold.items())
        or None,
        "doubts": "\n".join(sensor.doubts.values()) or None,
    }


def pair_columns(sensor: SensorDescription, side: str) -> dict[str, Any]:
    """Columns of `pairs` for the sensor of a side, "real" or "sim"."""
    row = sensor_row(sensor)
    return {f"sensor_{side}_{name.removeprefix('n_')}": row[name] for name in _PAIR_COLUMNS}


def has_other_beams(a: SensorDescription, b: SensorDescription) -> bool:
    """True if two scans are of sensors with different numbers of beams, or of known sensors that differ."""
    if a.model and b.model:
        return a.model not in b.model and b.model not in a.model
    return abs(len(a.elevation_deg) - len(b.elevation_deg)) > 2


def beams_text(sensor: SensorDescription) -> str:
    """Number, range and spacing of the beams, and the model: "32 beams, -25 to +15 degrees, uneven: ..."."""
    n_beams = len(sensor.elevation_deg)
    if not n_beams:
        return f"no beams detected ({sensor.untold['elevation_deg']})"
    count = f"{n_beams}"
    if sensor.model_beams is None:
        count = f"{'at least' if sensor.is_sharp else 'about'} {n_beams}"
    elif n_beams < sensor.model_beams:  # beams without a return are not detected
        count = f"{n_beams} of {sensor.model_beams}"
    low = sensor.elevation_deg[0]
    high = sensor.elevation_deg[-1]
    evenness = "evenly spaced" if sensor.is_even else "uneven"
    text = f"{count} beams, {low:+.4g} to {high:+.4g} degrees, {evenness}"
    return f"{text}: {sensor.model or sensor.untold['model']}"


def sensor_lines(sensor: SensorDescription) -> list[str]:
    """Lines with the properties of a sensor, and the reason for undetermined ones."""
    lines = [beams_text(sensor)]
    if sensor.origin_height_m:
        heights = " and ".join(f"{height:+g}" for height in sensor.origin_height_m)
        lines.append(f"beams start: {heights} m from the origin")
    if sensor.focal_m:
        lines.append(f"beams cross: {1e3 * sensor.focal_m:.1f} mm before the axis")
    if sensor.field_of_view_deg:
        low, high, around = sensor.field_of_view_deg
        lines.append(
            f"field of view: {low:+.4g} to {high:+.4g} degrees, {around:.0f} degrees around"
        )
    for name, (title, factor, text) in _PROPERTIES.items():
        value = getattr(sensor, name)
        if value is not None:
            lines.append(f"{title}: {text.format(factor * value)}")
        elif name in sensor.untold:
            lines.append(f"{title}: none detected ({sensor.untold[name]})")
    return lines


def _azimuth_step(sweep: Sweep) -> float | str:
    bin_deg = 0.002
    most_deg = 4.0
    gap = sweep.gap_deg
    gap = gap[(gap > _LEAST_STEP_DEG) & (gap < most_deg)]
    if len(gap) < _MIN_POINTS:
        return "too few neighbouring returns"
    bins = (gap / bin_deg).astype(int)
    count = np.bincount(bins, minlength=int(most_deg / bin_deg))
    density = scipy.ndimage.gaussian_filter1d(count.astype(float), 3.0)
    peaks, _ = scipy.signal.find_peaks(density, height=0.4 * density.max())
    step = (peaks[0] + 0.5) * bin_deg
    near = gap[np.abs(gap / step - 1.0) < 0.15]
    if len(near) < 0.15 * len(gap):
        return "neighbouring returns have no common distance in azimuth"
    return round(float(np.median(near)), 4)


def _firing_deg(sweep: Sweep, step_deg: float) -> float:
    """Mean azimuth between firings, by the returns without a lost one between them."""
    gap = sweep.gap_deg
    return float(np.mean(gap[(gap > _LEAST_STEP_DEG) & (gap < _NEXT_STEPS * step_deg)]))


def _spread(off_deg: FloatArray) -> float | None:
    """Standard deviation around 0, from the median absolute value."""
    return round(_MAD * float(np.median(np.abs(off_deg))), 4) if len(off_deg) else None


def _azimuth_noise(sweep: Sweep, step_deg: float) -> float | None:
    """Noise of one azimuth, from neighbouring returns that are one step apart."""
    off_deg = sweep.gap_deg - step_deg
    return _spread(off_deg[np.abs(off_deg) < step_deg / 2] / np.sqrt(2))


def _range_quantum(sweep: Sweep, rounding_m: float) -> float | str:
    if rounding_m > _FINE_M:
        return f"coordinates are rounded to {1e3 * rounding_m:.3g} mm"
    is_near = sweep.range_m < _QUANTUM_RANGE_M
    beam = sweep.beam[is_near]
    range_m = sweep.range_m[is_near]
    n_returns = np.bincount(beam)
    used = n_returns >= 50
    if n_returns[used].sum() < _MIN_POINTS:
        return f"too few returns nearer than {_QUANTUM_RANGE_M:g} m"

    def is_multiple(quantum: float) -> bool:
        n_quanta = range_m / quantum
        # cosines are fast
        turn = (2 * np.pi * (n_quanta - np.floor(n_quanta))).astype(np.float32)
        length = np.hypot(np.bincount(beam, np.cos(turn)), np.bincount(beam, np.sin(turn)))
        return bool(length[used].sum() / n_returns[used].sum() >= 0.7)

    # equal ranges of a beam on a plane agree with a large quantum, but not with its tenth
    for quantum in _QUANTA_M:
        if is_multiple(quantum) and (quantum < 0.05 or is_multiple(quantum / 10)):
            return quantum
    return f"no quantum from {1e3 * _QUANTA_M[-1]:g} to {1e3 * _QUANTA_M[0]:g} mm"


def _range_noise(sweep: Sweep, step_deg: float) -> float | str:
    runs, _ = _runs_on_surface(sweep, 1.5 * step_deg)
    place = np.linspace(-1.0, 1.0, _RUN)
    if len(runs) < _FEWEST_RUNS:
        runs, azimuth_deg = _runs_on_surface(sweep, (_RUN_STEPS + 0.5) * step_deg)
        place = azimuth_deg - azimuth_deg.mean(axis=1, keepdims=True)
        runs = runs[:, None]
    if len(runs) < _FEWEST_RUNS:
        return f"{len(runs)} runs of {_RUN} returns on a surface, at least {_FEWEST_RUNS} are needed"
    basis = np.linalg.qr(np.stack([np.ones_like(place), place, place**2], axis=-1))[0]
    fit = runs @ basis @ np.swapaxes(basis, -1, -2)
    rms = np.sqrt(((runs - fit) ** 2).sum(axis=-1) / (_RUN - 3))
    return round(float(np.quantile(rms, 0.25)) / _RUN_QUARTILE, 4)


def _least_range_noise(sweep: Sweep, step_deg: float, noise_m: float | str) -> float | None:
    """Range noise without the roughness of the surface, whose variance is about proportional to the step.

    It is extrapolated from the noise of all returns and of every second one. The noise need not lie between both:
    roughness that grows less, as between distant returns, stays in it (see `benchmarks/sensor_bias.py`,).
    """
    coarse_m = _range_noise(sweep.chosen(slice(None, None, 2)), 2 * step_deg)
    if isinstance(noise_m, str) or isinstance(coarse_m, str):
        return None
    return round(float(np.sqrt(np.clip(2 * noise_m**2 - coarse_m**2, 0.0, noise_m**2))), 4)


def _runs_on_surface(sweep: Sweep, most_deg: float) -> tuple[FloatArray, FloatArray]:
    """Ranges and azimuths, (n, 9) each, of returns of a beam in a row with at most this gap from one to the next."""
    has_no_gap = np.nan_to_num(sweep.gap_deg, nan=np.inf) < most_deg
    is_run = sliding_window_view(has_no_gap, _RUN - 1).T.all(axis=0)
    range_m = sliding_window_view(sweep.range_m, _RUN)
    azimuth_deg = sliding_window_view(sweep.azimuth_deg, _RUN)
    is_run &= np.ptp(range_m.T, axis=0) < 0.05 * range_m.T.mean(axis=0)  # on surface
    return range_m[is_run], azimuth_deg[is_run]


def _surface_firings(sweep: Sweep, step_deg: float) -> IndexArray:
    """Firings from each return to the next one of its beam on the same surface, (m - 1,) intp; 0 if it is not there."""
    n_firings = np.nan_to_num(np.round(sweep.gap_deg / step_deg))
    is_surface = (n_firings <= _HOLE + 1) & (sweep.apart_m < 0.03 * sweep.nearer_m + 0.05)
    return np.where(is_surface, n_firings, 0).astype(int)


def _lost_share(sweep: Sweep, n_firings: IndexArray) -> float | str:
    firings = n_firings[(n_firings >= 1) & (sweep.nearer_m < _MOST_LOST_M)]
    if len(firings) < _MIN_POINTS:
        return f"fewer than {_MIN_POINTS} gaps between returns of one surface"
    return round(float(1.0 - len(firings) / firings.sum()), 4)
