"""Elevations of a sensor's beams, estimated from a scan, and recognition of the sensor model."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from operator import attrgetter, itemgetter
from typing import NamedTuple

import numpy as np
import scipy

from ..schemas.sensor_models import SENSORS, SensorModel
from .arrays import BoolArray, FloatArray, IndexArray, IntArray, azimuths_deg, level_m

_HEIGHTS_M = np.round(np.arange(-0.3, 0.301, 0.01), 2)
_BLOCKS_APART_M = (0.05, 0.12)
_BAND_DEG, _BAND_BIN_DEG = 1.0, 0.04
_NEAREST_M = 0.15
_FARTHER_M = 1.0  # returns that are used for heights, and for beams if the heights are not 0
_BIN_DEG = 0.01
_PER_RADIAN = 180.0 / np.pi  # degrees; four times as fast as np.degrees
_WIDTHS_DEG = (0.02, 0.04, 0.08)
_GAIN = 0.1  # of mean log density, required for a further height
_SHARP, _RECOGNISABLE = 0.9, 0.75  # explained shares
_SECTOR_DEG = 60.0
_MIN_BEAMS = 8
_MIN_RETURNS = 8
_EXACT_DEG = 0.06
_COUNT_SLACK = 3  # beams more or less
_STEP_TOLERANCE = 0.015
_HALVED_FROM = 64  # beams of a sensor of which a scan may have every second one
_NO_RINGS = "returns do not lie on rings of one elevation each; is the scan moved or tilted out of its sensor's frame?"
_FIT = 0.25  # of the distance of neighbouring beams


@dataclass(frozen=True)
class BeamPattern:
    """The beams of a sensor.

    elevation_deg : (b,) float64, ascending
    width_deg : spread of the returns of a beam around its elevation
    is_even : all neighbouring beams have the same distance
    origin_height_m : heights of the beams' origin above the frame's origin: one for all, or one per block
    block_deg : elevation between the blocks
    explained : share of the returns in beams, corrected for chance: 0 for none, 1 for all
    is_sharp : the beams are distinct in the whole scan; else they are from a sector, and their number is approximate
    focal_m : distance from the axis at which the beams cross
    """

    elevation_deg: FloatArray
    width_deg: float
    is_even: bool
    origin_height_m: tuple[float, ...]
    block_deg: float
    explained: float
    is_sharp: bool = True
    focal_m: float = 0.0

    def beam_of(self, points: FloatArray) -> tuple[IndexArray, FloatArray]:
        """Beam of each point, (n,) intp, -1 for none; and the elevation above it, (n,) degrees."""
        elevation = elevation_of_points(
            points, self.origin_height_m, self.block_deg, self.focal_m
        )
        middle = (self.elevation_deg[1:] + self.elevation_deg[:-1]) / 2
        beam = np.searchsorted(middle, elevation)
        reach = np.minimum(2 * self.width_deg, 0.4 * _spacing(self.elevation_deg))
        off_deg = elevation - self.elevation_deg[beam]
        return np.where(np.abs(off_deg) <= reach[beam], beam, -1), off_deg


def find_beams(points: FloatArray, ring: IntArray | None = None) -> BeamPattern | str:
    """Find the beams of the returns of a scan, or the reason why they are not detectable.

    A beam of elevation e that starts h above the origin has z / r = tan e + h / r at the horizontal distance r,
    independent of range noise. Heights: those for which z / r - h / r is densest in angle, by the mean log of the
    collision density sum n (n - 1) / (N (N - 1)) in bands of one degree; 0, one for all beams, or one each for a lower
    and an upper block (HDL-64E), if that gains enough. Elevations: peaks of the density, for that one of three kernel
    widths that explains most. If the peaks are not sharp (for example after motion compensation), sectors of 60 degrees
    are searched as well: only beams that fit a known sensor are accepted, because a scan out of its sensor's frame also
    has some peaks. With rings, the elevation of a beam is the median over its ring. Beams that fit no known sensor are
    searched again from the crossing point of each sensor with the same number of beams (r minus its focal distance),
    and accepted if they then fit that sensor.

    Parameters
    ----------
    points : (n, 3) float64, metres, the sensor's frame; finite, not at the origin
    ring : (n,) int32, beam number of each point, -1 for none
    """
    pattern = _find_from(0.0, points, ring)
    sensors = list(SENSORS.values())
    if isinstance(pattern, BeamPattern):
        if recognise(pattern).title:
            return pattern
        n_beams = len(pattern.elevation_deg)
        sensors = [known for known in sensors if abs(known.n_beams - n_beams) <= _COUNT_SLACK]
    for focal_m in sorted({sensor.focal_m for sensor in sensors} - {0.0}):
        other = _find_from(focal_m, points, ring)
        if isinstance(other, BeamPattern) and recognise(other).title:
            return other
    return pattern


def _find_from(focal_m: float, points: FloatArray, ring: IntArray | None) -> BeamPattern | str:
    """Find beams seen from `focal_m` before the axis; sectors are searched from the axis only."""
    level = level_m(points) - focal_m
    is_used = level > _NEAREST_M
    points = points[is_used]
    level = level[is_used]
    if len(level) < 100:
        return f"{len(level)} returns beyond {_NEAREST_M:g} m"
    tangent = points[:, 2] / level
    nearness = 1.0 / level
    whole = _read(tangent, nearness)
    if ring is not None and (by_ring := _by_ring(tangent, nearness, ring[is_used], whole)):
        return replace(by_ring, focal_m=focal_m)
    if whole and whole.explained >= _SHARP:
        return replace(whole, focal_m=focal_m)
    if focal_m:
        return "returns do not lie on rings from there"
    patterns = [whole]
    azimuth = azimuths_deg(points)
    for middle in np.arange(-180.0, 180.0, _SECTOR_DEG / 2):
        apart = np.abs(azimuth - middle)
        is_in = np.minimum(apart, 360.0 - apart) < _SECTOR_DEG / 2
        if is_in.sum() >= 1000:
            patterns.append(_read(tangent[is_in], nearness[is_in]))
    candidates = [
        pattern for pattern in patterns if pattern and pattern.explained >= _RECOGNISABLE
    ]
    for pattern in sorted(candidates, key=attrgetter("explained"), reverse=True):
        if recognise(pattern).title:
            return replace(pattern, is_sharp=False)
    return _NO_RINGS


class Recognition(NamedTuple):
    """Known sensor with some beams, or the reason why there is none.

    title : of the sensor, or of two sensors; None if unknown
    n_beams : number of beams in its table
    """

    reason: str = ""
    title: str | None = None
    n_beams: int | None = None


def recognise(
    pattern: BeamPattern,
    step_deg: float | None = None,
    quantum_m: float | None = None,
) -> Recognition:
    """Recognise the sensor by its beams; azimuth step and range quantum must agree with the scan.

    A sensor whose table is valid for every unit fits if 95 % of the beams are within 0.06 degrees, or a quarter of the
    distance to its neighbour, of a beam of the table, and 90 % of the table's beams between the limits of the scan and
    70 % of all its beams are detected. For sensors whose units differ (HDL-64E, Ouster, PandarXT) each half of the
    table may be shifted by its `unit_deg` and stretched by 5 %; then 85 % must fit. Evenly spaced beams are never
    stretched, because no real unit has them. Every second beam of a table is tried too. Beams that cross before the
    axis only fit sensors whose beams cross there. If two sensors fit equally well, both are named; if more fit, none.

    Parameters
    ----------
    pattern : the beams
    step_deg, quantum_m : values of the scan; None (unknown) agrees with every sensor
    """
    observed = pattern.elevation_deg
    if len(observed) < _MIN_BEAMS:
        return Recognition(
            f"{len(observed)} beams, at least {_MIN_BEAMS} are needed to know a sensor by them",
        )
    fits: dict[str, _Fit] = {}
    for title, table, sensor in _tables():
        if pattern.focal_m not in (0.0, sensor.focal_m):
            continue
        score = _fit(observed, table, sensor.unit_deg, pattern)
        if score and (title not in fits or score >= fits[title].score):
            fits[title] = _Fit(score, sensor, len(table))
    if not fits and pattern.is_even:
        return Recognition("no known sensor has these; simulators space theirs evenly")
    if not fits:
        return Recognition("no sensor of the table has such beams")
    best = max(fit.score for fit in fits.values())
    agreeing = []
    objections = []
    for title, fit in fits.items():
        if fit.score < best - 0.02:
            continue
        if objection := _disagreement(fit.sensor, step_deg, quantum_m):
            objections.append(f"the beams of {title}, but {objection}")
        else:
            agreeing.append(title)
    if not agreeing:
        return Recognition("; ".join(objections))
    if len(agreeing) > 2:
        return Recognition(f"these beams fit {', '.join(agreeing)} equally well")
    return Recognition("", " or ".join(agreeing), fits[agreeing[0]].n_beams)


class _Fit(NamedTuple):
    """Quality of the fit of a sensor's table, and the number of beams in it."""

    score: float
    sensor: SensorModel
    n_beams: int


def _disagreement(sensor: SensorModel, step_deg: float | None, quantum_m: float | None) -> str:
    """Reason why a step or quantum is not the sensor's, or ""."""
    if (
        quantum_m
        and sensor.range_quantum_m
        and abs(quantum_m / sensor.range_quantum_m - 1.0) > 0.1
    ):
        return f"its range quantum is {1e3 * sensor.range_quantum_m:g} mm, not {1e3 * quantum_m:g} mm"
    columns = step_deg / sensor.column_deg if step_deg and sensor.column_deg else 1.0
    if abs(columns - max(1, round(columns))) > _STEP_TOLERANCE * columns:
        return f"its azimuth steps are multiples of {sensor.column_deg:.3g} degrees, not {step_deg:.3f}"
    return ""


def _tables() -> Iterator[tuple[str, FloatArray, SensorModel]]:
    """Title and ascending elevations of each known sensor, and of every second beam of large ones."""
    for sensor in SENSORS.values():
        table = np.sort(np.array(sensor.elevation_deg))
        yield sensor.title, table, sensor
        if sensor.n_beams >= _HALVED_FROM:
            for first in (0, 1):
                yield f"every second beam of {sensor.title}", table[first::2], sensor


def _fit(
    observed: FloatArray, table: FloatArray, unit_deg: float, pattern: BeamPattern
) -> float:
    """Quality of fit of beams to a table: mean closeness times the share of the table that is detected; 0 if no fit."""
    exact_deg = np.minimum(max(_EXACT_DEG, pattern.width_deg), _FIT * _spacing(table))
    score = _score(observed, table, exact_deg, 0.95, 0.9)
    has_same_number = abs(len(observed) - len(table)) <= 0.2 * len(table)
    if score or not unit_deg or pattern.is_even or not has_same_number:
        return score
    free = _stretched(observed, table, unit_deg)
    return _score(observed, free, _FIT * _spacing(free), 0.85, 0.85)


def _stretched(observed: FloatArray, table: FloatArray, unit_deg: float) -> FloatArray:
    """Shift and stretch each half of a table about its middle so that most beams are observed, without overlap."""
    scale = np.arange(0.95, 1.051, 0.005)[:, None, None]
    shift = np.arange(-unit_deg, unit_deg + 1e-9, 0.02)[None, :, None]
    halves = []
    scores = []
    for half in np.array_split(table, 2):
        places = half.mean() + scale * (half - half.mean()) + shift
        tolerance = _FIT * scale * _spacing(half)
        closeness = np.maximum(0.0, 1.0 - _distance(places, observed) / tolerance).sum(axis=2)
        best_scale = closeness.argmax(axis=0)
        halves.append(places[best_scale, np.arange(len(best_scale))])
        scores.append(closeness.max(axis=0))
    lower, upper = halves
    gap = upper[None, :, 0] - lower[:, None, -1]
    first = (len(table) + 1) // 2
    usual = table[first] - table[first - 1]
    is_apart = (gap > 0.6 * usual) & (gap < 1.6 * usual)
    score = np.where(is_apart, scores[0][:, None] + scores[1], -1.0)
    low, high = np.unravel_index(score.argmax(), score.shape)
    return np.concatenate([lower[low], upper[high]])


def _score(
    observed: FloatArray,
    table: FloatArray,
    tolerance_deg: FloatArray,
    of_observed: float,
    of_table: float,
) -> float:
    """Quality of fit with a tolerance for each beam of the table; 0 if too small shares of the beams agree."""
    closeness = 1.0 - _distance(table, observed) / tolerance_deg
    is_seen = closeness >= 0
    is_within = (table >= observed[0] - 0.2) & (table <= observed[-1] + 0.2)
    n_fewest = max(
        of_observed * len(observed), of_table * is_within.sum(), 0.7 * len(table), _MIN_BEAMS
    )
    if is_seen.sum() < n_fewest:
        return 0.0
    return float((0.5 + 0.5 * closeness[is_seen].mean()) * is_seen.mean())


def _distance(places: FloatArray, ascending: FloatArray) -> FloatArray:
    """Distance from each place to the nearest of some ascending values."""
    after = np.searchsorted(ascending, places).clip(1, len(ascending) - 1)
    return np.minimum(np.abs(places - ascending[after - 1]), np.abs(places - ascending[after]))


def _spacing(ascending: FloatArray) -> FloatArray:
    """Distance from each value to the nearer of its neighbours, (b,) float64."""
    gap = np.concatenate([[np.inf], np.diff(ascending), [np.inf]])
    return np.minimum(gap[1:], gap[:-1])


def _read(tangent: FloatArray, nearness: FloatArray) -> BeamPattern | None:
    """Beams for the best heights and kernel width; None if not found."""
    is_far = nearness < 1.0 / _FARTHER_M
    if is_far.sum() < 100:
        return None
    far = np.stack([tangent, nearness])[:, is_far]
    heights, block_deg = _origin_heights(*far)
    if heights:
        tangent, nearness = far
    elevation = _elevation_of_beams(tangent, nearness, heights, block_deg)
    bins = ((elevation + 90.0) / _BIN_DEG).astype(int)
    count = np.bincount(bins, minlength=int(180 / _BIN_DEG) + 1)
    candidates = []
    for width in _WIDTHS_DEG:
        peaks = _peaks(count, width)
        if len(peaks) >= 2:
            candidates.append((_explained(count, peaks, width), width, peaks))
    if not candidates:
        return None
    explained, width, peaks = max(candidates, key=itemgetter(0))
    ordered = np.sort(elevation)
    peaks_deg = (peaks + 0.5) * _BIN_DEG - 90.0
    start, stop = np.searchsorted(ordered, [peaks_deg - 2 * width, peaks_deg + 2 * width])
    centre = (ordered[(start + stop - 1) // 2] + ordered[(start + stop) // 2]) / 2  # medians
    return BeamPattern(centre, width, _is_even(centre), heights, block_deg, explained)


def _by_ring(
    tangent: FloatArray, nearness: FloatArray, ring: IntArray, whole: BeamPattern | None
) -> BeamPattern | None:
    """Beams from rings; None if there are too few, or if rings do not have one elevation each."""
    heights, block_deg = (whole.origin_height_m, whole.block_deg) if whole else ((), -90.0)
    elevation = _elevation_of_beams(tangent, nearness, heights, block_deg)
    is_far = nearness < 1.0 / _FARTHER_M
    parts = []
    for number in np.unique(ring[ring >= 0]):
        is_ring = ring == number
        part = elevation[is_ring & is_far]
        if not heights and len(part) < _MIN_RETURNS:  # a beam that only hits the ego vehicle
            part = elevation[is_ring]
        if len(part) >= _MIN_RETURNS:
            parts.append(part)
    quartiles = np.array([np.quantile(part, (0.25, 0.5, 0.75)) for part in parts])
    if len(quartiles) < 4:
        return None
    low, centre, high = quartiles[np.argsort(quartiles[:, 1])].T
    width = float(np.median(high - low))
    if width >= np.median(np.diff(centre)):  # also where all rings are one
        return None
    width = max(width, _WIDTHS_DEG[0])
    return BeamPattern(centre, width, _is_even(centre), heights, block_deg, 1.0)


def elevation_of_points(
    points: FloatArray, heights: tuple[float, ...], block_deg: float, focal_m: float = 0.0
) -> FloatArray:
    """Elevation of each point seen from the origin of its beam, degrees."""
    level = np.maximum(level_m(points) - focal_m, 1e-9)
    return _elevation_of_beams(points[:, 2] / level, 1.0 / level, heights, block_deg)


def _elevation_of_beams(
    tangent: FloatArray,
    nearness: FloatArray,
    heights: tuple[float, ...],
    block_deg: float,
) -> FloatArray:
    """Elevation of each return seen from the origin of its beam, degrees."""
    if not heights:
        return np.degrees(np.arctan(tangent))
    middle = np.degrees(np.arctan(tangent - np.mean(heights) * nearness))
    height = np.where(middle < block_deg, heights[0], heights[-1])
    return np.degrees(np.arctan(tangent - height * nearness))


def _origin_heights(
    tangent: FloatArray, nearness: FloatArray
) -> tuple[tuple[float, ...], float]:
    """Heights of the beams' origin above the frame's origin, () for 0; and the elevation between two blocks."""
    density, below = _densities(tangent, nearness)
    lower = np.cumsum(density, axis=1) / len(tangent)
    whole = lower[:, -1]  # of all bands
    best = int(whole.argmax())
    of_blocks, heights, block_deg = _block_heights(lower, (below > 0.15) & (below < 0.85))
    if of_blocks > whole[best] + _GAIN:
        return heights, block_deg
    if whole[best] > whole[np.abs(_HEIGHTS_M).argmin()] + _GAIN:
        return (float(_HEIGHTS_M[best]),), -90.0
    return (), -90.0


def _densities(tangent: FloatArray, nearness: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Log density of the returns in angle, (heights, bands), times their number; and the share up to each band."""
    n_bands = int(180 / _BAND_DEG)
    per_band = int(_BAND_DEG / _BAND_BIN_DEG)
    n_bins = n_bands * per_band
    ones = np.ones(per_band)
    density = np.zeros((len(_HEIGHTS_M), n_bands))
    for row, height in enumerate(_HEIGHTS_M):
        elevation = np.arctan(tangent - height * nearness) * _PER_RADIAN
        bins = np.minimum((elevation + 90.0) / _BAND_BIN_DEG, n_bins - 1).astype(int)
        count = np.bincount(bins, minlength=n_bins).reshape(n_bands, per_band).astype(float)
        total = count @ ones
        pairs = np.maximum(np.einsum("bk,bk->b", count, count) - total, 1.0)
        most = np.maximum(total * (total - 1), 1.0)
        density[row] = total * np.log(pairs * per_band / most)
        if height == 0:
            below = np.cumsum(total) / total.sum()
    return density, below


def _block_heights(
    lower: FloatArray,
    is_split: BoolArray,
) -> tuple[float, tuple[float, float], float]:
    """Density for the best heights of a lower and an upper block; these heights, and the elevation between both.

    Parameters
    ----------
    lower : (heights, bands) density of all bands up to each
    is_split : (bands,) True where both blocks have enough returns
    """
    candidates = [(-np.inf, (0.0, 0.0), -90.0)]
    for row, height in enumerate(_HEIGHTS_M.tolist()):
        drop = height - _HEIGHTS_M
        is_below = (drop > _BLOCKS_APART_M[0] - 1e-6) & (drop < _BLOCKS_APART_M[1] + 1e-6)
        if not is_below.any():
            continue
        below = lower[is_below]
        of_both = np.where(is_split, below.max(axis=0) + lower[row, -1] - lower[row], -np.inf)
        band = int(of_both.argmax())
        lowest = float(_HEIGHTS_M[is_below][below[:, band].argmax()])
        block_deg = _BAND_DEG * (band + 1) - 90.0
        candidates.append((of_both[band], (lowest, height), block_deg))
    return max(candidates, key=itemgetter(0))


def _peaks(count: IndexArray, width_deg: float) -> IndexArray:
    """Bins of peaks of the smoothed count: prominent by half their height, and with enough returns."""
    sigma = width_deg / _BIN_DEG
    smooth = scipy.ndimage.gaussian_filter1d(count.astype(float), sigma, mode="constant")
    smooth = smooth * np.sqrt(2 * np.pi) * sigma
    peaks, shape = scipy.signal.find_peaks(
        smooth, height=_MIN_RETURNS, prominence=_MIN_RETURNS / 2
    )
    return peaks[shape["prominences"] > 0.5 * smooth[peaks]]


def _explained(count: IndexArray, peaks: IndexArray, width_deg: float) -> float:
    """(s - c) / (1 - c): s is the share of returns within two widths of a peak, c the share of these angles."""
    reach = round(2 * width_deg / _BIN_DEG)
    near: BoolArray = np.zeros(len(count), dtype=bool)
    around = peaks + np.arange(-reach, reach + 1)[:, None]
    near[around.clip(0, len(count) - 1)] = True
    low, high = np.searchsorted(np.cumsum(count) / count.sum(), (0.005, 0.995))
    within = slice(int(low), int(high) + 1)
    by_chance = float(near[within].mean())
    return float((count[near].sum() / count.sum() - by_chance) / max(1.0 - by_chance, 1e-9))


def _is_even(ascending: FloatArray) -> bool:
    """True if all distances are multiples of one distance, within 3 % of it; a missing beam doubles a distance."""
    gap = np.diff(ascending)
    if len(gap) < 3:
        return False
    step = float(np.median(gap))
    place = np.concatenate([[0.0], np.cumsum(np.round(gap / step))])
    if np.round(gap / step).min() < 1 or place[-1] > 1.5 * len(gap):
        return False
    line = np.polynomial.Polynomial.fit(place, ascending, 1)
    return bool(np.abs(ascending - line(place)).max() <= 0.03 * step + 0.005)
