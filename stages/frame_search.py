"""Check of the frames of two scans: coverage of the scans as given, and under likely wrong frames, units and motions.

Only points near the sensor are compared, downsampled, ground and the rest with equal weight: the ground is most of a
scan, and looks the same after rotation or mirroring. The limits are defined by fidpipe; see `benchmarks/frames.py`.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import permutations, product

import numpy as np
import scipy

from ..schemas.data_files import read_data
from ..schemas.settings import FRAME_AXES, Box, FrameName, InputSettings
from .arrays import BoolArray, FloatArray, IndexArray, level_m, moved
from .clean import as_ros, clean_scan, inside
from .thinning import shares_voxel
from .trust import is_far_from_origin

_AS_GIVEN = "as given"
_LIFTED = "shifted by"
_UNITS_OF = "units of"
_VOXEL_M = 0.5
_REACH_M = 40.0
_NEAR_M = 1.0
_GROUND_BAND_M = 0.4
_MAX_POINTS = 1500
#: Points of a scan; with fewer, scans of one place cover each other like scans of two.
_MIN_POINTS = 400
_MIN_GROUND_POINTS = 50

_MIN_COVERAGE = 0.6
MIN_GAIN = 0.15
_MAX_UNCOVERED_RATIO = 0.6
#: Least coverage by the best candidate: scans of one place have 0.63 to 0.96, of two places 0.29 to 0.55.
MIN_SAME_PLACE = 0.58
_MIN_LIFT_M = 0.2
_MIN_SHIFT_M = 0.8
_MAX_LIFT_LEFT_M = 0.05
_MAX_COVERAGE_LOST = 0.02
_LIFT_STEPS = 4
_NEARER = 0.6  # of the median distance before a lift
#: Metres per unit, and the largest ratio of the reach of both sides in a unit; "" for metres.
_UNITS = {
    "": (1.0, np.inf),
    "centimetres": (0.01, 10.0),
    "millimetres": (0.001, 10.0),
    "decimetres": (0.1, 1.6),
    "feet": (0.3048, 1.6),
    "inches": (0.0254, 1.6),
}
_GROUND_STEP_M = 0.1

_DIRECTIONS = (("forward", "back"), ("left", "right"), ("up", "down"))
_FEW_POINTS = 300  # of a scan, by which the most promising candidates are chosen
_MOST_PROMISING = 8
_SOME_RETURNS = 3000  # of a scan, by which the most promising sizes are chosen
_MOST_SIZES = 2
_LEAST_SCALE = 0.2
_MOST_SCALE = 5.0
_LEAST_SCALE_CHANGE = 0.05
_FINE_SCALES = np.linspace(0.9, 1.1, 11)
_LEAST_HEIGHT_M = 0.3
_MIN_SCALED_COVERAGE = 0.75  # smaller scans cover each other more easily
_MIN_SCALED_GAIN = 0.05  # of another size that leaves hardly anything uncovered
_MOST_LEFT = 0.25  # of the share that the scan as given leaves uncovered

#: F of each frame: p_ros = F p.
_FRAMES: dict[FrameName, FloatArray] = {name: as_ros(np.eye(3), name).T for name in FRAME_AXES}


def _rotations() -> dict[str, FloatArray]:
    """All 48 orders and signs of the axes by name, usual mistakes first."""
    turns = {}
    for name, rows in read_data("axis_mistakes").items():
        turns[name] = np.array(rows, dtype=np.float64)
    for order in permutations(range(3)):
        for signs in product((1.0, -1.0), repeat=3):
            turn = np.eye(3)[list(order)].T * signs
            if not any(np.array_equal(turn, known) for known in turns.values()):
                turns[f"read as {_axes_words(turn)}"] = turn
    return turns


def _axes_words(turn: FloatArray) -> str:
    """Directions of the axes of the file: "x right, y up, z forward"."""
    words = []
    for axis, direction in zip("xyz", turn.T, strict=True):
        row = int(np.abs(direction).argmax())
        words.append(f"{axis} {_DIRECTIONS[row][int(direction[row] < 0)]}")
    return ", ".join(words)


_ROTATIONS = _rotations()


@dataclass(frozen=True)
class FrameCheck:
    """Coverage of the real scan by the simulated one, as given and for the best candidate transform.

    as_it_lies : coverage of the scan as given, 0 to 1, see `check_frames`; others are not tried if it is high
    reading : description of the best candidate, "as given" if no other fits better
    coverage : by the best candidate, 0 to 1
    is_suspect : the best candidate fits much better than the scan as given
    setting : setting that selects the best candidate; "" if that is the present one
    """

    as_it_lies: float
    reading: str
    coverage: float
    is_suspect: bool
    setting: str

    @property
    def is_other_frame(self) -> bool:
        """True if other axes, units or motions fit much better, and not only the ground is at another height."""
        gain = self.coverage - self.as_it_lies
        return self.is_suspect and not is_only_lifted(self.reading, gain)

    @property
    def is_elsewhere(self) -> bool:
        """True if no candidate reaches the coverage of two scans of one place."""
        return self.coverage < MIN_SAME_PLACE

    @property
    def doubt(self) -> str | None:
        """Reason why no cause can be named; None if both scans are in one frame, and show one place."""
        if self.is_elsewhere:
            return "the two scans do not show the same place"
        if self.is_other_frame:
            return f"the simulated scan is in another frame: {self.reading}"
        return None


def is_only_lifted(reading: str, gain: float) -> bool:
    """True if the only difference of the best candidate is the height of its ground, and it covers little more."""
    return gain < MIN_GAIN and reading.startswith(_LIFTED) and ", in " not in reading  # a unit


class _Side:
    """Downsampled scan: points, ground flags, search tree, and rows of a sample.

    box : points outside of it are left out of comparisons, also those of the other side
    """

    def __init__(self, points: FloatArray, box: Box | None = None) -> None:
        self.points = points
        self.box = box
        self.ground_m = ground_height(points)
        self.is_ground: BoolArray = np.abs(points[:, 2] - self.ground_m) < _GROUND_BAND_M
        self.tree = scipy.spatial.cKDTree(points)
        # random, as a regular sample would follow the rings of the scan
        rows = np.random.default_rng(0).permutation(len(points))
        self.sample: IndexArray = np.sort(rows[:_MAX_POINTS])

    def some(self, n_points: int) -> tuple[FloatArray, BoolArray]:
        """Up to n points of the sample, and their ground flags."""
        step = math.ceil(len(self.sample) / n_points) or 1
        rows = self.sample[::step]
        return self.points[rows], self.is_ground[rows]

    def shares_near(self, points: FloatArray, is_ground: BoolArray) -> list[float]:
        """Share of the ground points, and of the others, with a point of this side within reach; none of no points."""
        apart, _ = self.tree.query(points, distance_upper_bound=_NEAR_M)
        is_near: BoolArray = np.isfinite(apart)
        shares = []
        for rows in (is_ground, ~is_ground):
            if rows.any():
                shares.append(float(is_near[rows].mean()))
        return shares


@dataclass(frozen=True)
class _Candidate:
    """The simulated scan under a candidate transform: p, in metres, becomes R p + t.

    real, sim : both scans, in metres
    M : (3, 4) float64, [R | t]; R is a rotation or a reflection
    words : description of the rotation or reflection; "" for none
    unit : unit of the file; "" for metres
    lift_m : difference of the ground heights, as part of t
    """

    real: _Side
    sim: _Side
    M: FloatArray
    words: str = ""
    unit: str = ""
    lift_m: float = 0.0

    @property
    def name(self) -> str:
        """Human-readable description, such as "mirrored in y and shifted by +1.80 m in z, in feet"."""
        lift = f"{_LIFTED} {self.lift_m:+.2f} m in z" if self.lift_m else ""
        words = " and ".join(filter(None, (self.words, lift)))
        return ", ".join(filter(None, (words, self.unit and f"in {self.unit}"))) or _AS_GIVEN

    @cached_property
    def coverage(self) -> float:
        """Mean over both directions, and over ground and the rest, of the share of points with another within reach."""
        return self.coverage_of(_MAX_POINTS)

    def coverage_of(self, n_points: int) -> float:
        """Coverage of up to n points of each scan."""
        real_points, real_ground = self.real.some(n_points)
        sim_points, sim_ground = self.sim.some(n_points)
        placed = self.placed(sim_points)
        is_inside = inside(placed, self.real.box)
        # distances do not change, so the tree is reused
        back = (real_points - self.M[:, 3]) @ self.M[:, :3]
        shares = [
            *self.real.shares_near(placed[is_inside], sim_ground[is_inside]),
            *self.sim.shares_near(back, real_ground),
        ]
        return float(np.mean(shares)) if shares else 0.0

    def placed(self, points: FloatArray) -> FloatArray:
        """Points of the simulated scan, transformed."""
        return moved(points, self.M)

    def lifted(self, lift_m: float) -> _Candidate:
        """The candidate with the simulated scan higher."""
        M = self.M.copy()
        M[2, 3] += lift_m
        return replace(self, M=M, lift_m=self.lift_m + lift_m)


def check_frames(
    real: FloatArray,
    sim: FloatArray,
    settings: InputSettings,
    T_real_sim: FloatArray | None = None,
) -> FrameCheck | None:
    """Compare the coverage of the scans as given with that of the best candidate; None if there are too few points.

    The coverage is the share of the points of one scan that have a point of the other within 1 m, as the mean over
    both directions and over ground and the rest. Only points within 40 m of the sensor, one per voxel of 0.5 m, count.
    Candidates for the simulated scan: its axes in all 48 orders and signs, which include either scan read in any of
    the frames of the settings; in another unit if it reaches far beyond the real one; each of these also shifted by
    the difference of the ground heights; the size in which it reaches as far as the real one; and if none of them
    covers 0.85, sizes of 0.2 to 5. A candidate is suspect if it covers at least 0.6, at least `MIN_GAIN` more than the
    scan as given, and leaves uncovered at most 0.6 of the share that the scan as given leaves; another size also if it
    covers 0.05 more and leaves a quarter of that share. Otherwise a scan is suspect if its ground is 0.2 m or more
    above or below the real one. Lifts are medians over ground points and their horizontal neighbours, applied and
    re-measured before they are reported.

    Parameters
    ----------
    real, sim : (n, 3), (m, 3) float64, metres, each in its own sensor's frame, as read; NaN are dropped
    settings : cleaning and present frames of the scans
    T_real_sim : (3, 4) float64, present motion of the simulated scan

    Examples
    --------
    >>> import numpy as np
    >>> wall = np.random.default_rng(0).uniform([5, 3, -1], [25, 9, 4], (3000, 3))
    >>> check = check_frames(wall, wall * [1, -1, 1], InputSettings())
    >>> check.reading, check.setting, check.is_suspect
    ('mirrored in y', 'input.sim_frame=carla', True)
    """
    motion = np.eye(3, 4) if T_real_sim is None else T_real_sim
    real = real[np.isfinite(real).all(axis=1)]
    sim = sim[np.isfinite(sim).all(axis=1)]
    target = _thinned(real, settings, "real")
    some_sim = _some_returns(sim)
    reach_ratio = _reach_m(_some_returns(real)) / max(_reach_m(some_sim), 1e-9)
    sources = _sources(sim, reach_ratio, settings)
    if len(target.points) < _MIN_POINTS or not sources:
        return None
    metres = sources.get("") or _Side(sim[:0])
    given = _Candidate(target, metres, motion)
    best = _search(given, sources)
    if "" in sources:
        sizes = _sizes(given, reach_ratio, best.coverage)
        for candidate in _resized(given, sim, some_sim, sizes, settings):
            least = max(best.coverage, _MIN_SCALED_COVERAGE)
            if candidate.coverage > least and _is_better(given, candidate):
                best = candidate
    is_suspect = best.coverage >= _MIN_COVERAGE and _is_better(given, best)
    start = best if is_suspect else given
    if best.coverage >= MIN_SAME_PLACE and (levelled := _levelled(start)):
        in_metres = start.sim.points if start.unit else sim
        if (
            levelled.coverage >= max(start.coverage - _MAX_COVERAGE_LOST, MIN_SAME_PLACE)
            and not is_far_from_origin(real)
            and not is_far_from_origin(in_metres)
            and (is_suspect or _is_nearer(real, start, levelled, settings))
        ):
            best = levelled
            is_suspect = True
    setting = _setting(best, settings, motion)
    return FrameCheck(given.coverage, best.name, best.coverage, is_suspect, setting)


def ground_height(points: FloatArray) -> float:
    """Height of most points of a downsampled scan, metres: the middle of the fullest band of 0.8 m.

    It is 0 without points.

    Parameters
    ----------
    points : (n, 3) float64, metres
    """
    if not len(points):
        return 0.0
    steps = np.floor(points[:, 2] / _GROUND_STEP_M).astype(np.int64)
    counts = np.bincount(steps - steps.min())
    width = round(2 * _GROUND_BAND_M / _GROUND_STEP_M)
    in_bands = np.convolve(counts, np.ones(width), "full")
    fullest = int(in_bands.argmax())  # the last step of the band
    return float((steps.min() + fullest + 1) * _GROUND_STEP_M - _GROUND_BAND_M)


def _search(given: _Candidate, sources: dict[str, _Side]) -> _Candidate:
    """The candidate of the highest coverage; the scan as given if no other can be suspect, or none is better."""
    if 1 - given.coverage < MIN_GAIN:
        return given
    candidates: list[_Candidate] = []
    for unit, source in sources.items():
        candidates += _candidates(replace(given, sim=source, unit=unit))
    candidates.sort(key=lambda candidate: -candidate.coverage_of(_FEW_POINTS))
    return max(given, *candidates[:_MOST_PROMISING], key=lambda candidate: candidate.coverage)


def _candidates(given: _Candidate) -> Iterator[_Candidate]:
    """A scan in all orders and signs of the axes, also with its ground at the height of the real one."""
    R = given.M[:, :3]
    for words, turn in _ROTATIONS.items():
        M = np.column_stack([R @ turn, given.M[:, 3]])
        turned = replace(given, M=M, words=words)
        yield turned
        lift_m = given.real.ground_m - ground_height(turned.placed(given.sim.points))
        if abs(lift_m) >= _MIN_SHIFT_M:
            yield turned.lifted(lift_m)


def _sizes(given: _Candidate, reach_ratio: float, coverage: float) -> list[float]:
    """Factors by which the simulated scan is to be enlarged.

    By the first it reaches as far as the real one. If the best candidate so far covers little, also factors around it,
    and around the one by which its sensor is as high above the road as the real one.
    """
    sizes = [reach_ratio]
    if 1 - coverage >= MIN_GAIN:
        sizes += (reach_ratio * _FINE_SCALES).tolist()
        real_m = given.real.ground_m
        sim_m = given.sim.ground_m
        if min(abs(real_m), abs(sim_m)) > _LEAST_HEIGHT_M:
            sizes += (real_m / sim_m * _FINE_SCALES).tolist()
    return [
        size
        for size in dict.fromkeys(sizes)
        if _LEAST_SCALE <= size <= _MOST_SCALE and abs(size - 1) >= _LEAST_SCALE_CHANGE
    ]


def _resized(
    given: _Candidate,
    sim: FloatArray,
    some_sim: FloatArray,
    sizes: list[float],
    settings: InputSettings,
) -> Iterator[_Candidate]:
    """The simulated scan enlarged by the factors for which a sample of it covers most.

    Parameters
    ----------
    sim, some_sim : simulated points as read, all and a sample
    sizes : factors to be tried
    """
    rough = []
    for size in sizes:
        source = _thinned(some_sim * size, settings, "sim")
        if len(source.points) >= _MIN_POINTS:
            candidate = replace(given, sim=source)
            rough.append((candidate.coverage, size))
    for _, size in sorted(rough, reverse=True)[:_MOST_SIZES]:
        source = _thinned(sim * size, settings, "sim")
        yield replace(given, sim=source, unit=f"{_UNITS_OF} {size:.3g} m")


def _is_better(given: _Candidate, other: _Candidate) -> bool:
    """True if a candidate fits so much better than the scan as given that it is suspect."""
    gain = other.coverage - given.coverage
    left = (1 - other.coverage) / max(1 - given.coverage, 1e-9)
    if other.unit.startswith(_UNITS_OF) and gain >= _MIN_SCALED_GAIN and left <= _MOST_LEFT:
        return True
    return gain >= MIN_GAIN and left <= _MAX_UNCOVERED_RATIO


def _some_returns(points: FloatArray) -> FloatArray:
    """A random sample of the points, without missing returns."""
    rows = np.random.default_rng(0).permutation(len(points))
    some = points[rows[:_SOME_RETURNS]]
    return some[some.any(axis=1)]


def _reach_m(points: FloatArray) -> float:
    """Median distance of the points; 0 without any."""
    if not len(points):
        return 0.0
    distance_m = np.hypot(level_m(points), points[:, 2])
    return float(np.median(distance_m))


def _levelled(start: _Candidate) -> _Candidate | None:
    """Candidate with the ground at the height of the real one; None if that changes little or does not converge."""
    target = start.real
    placed = start.placed(start.sim.points)
    ground = target.points[target.is_ground]
    tree = scipy.spatial.cKDTree(ground[:, :2])
    step_m = 0.0 if start.lift_m else target.ground_m - ground_height(placed)
    change_m = 0.0
    for _ in range(_LIFT_STEPS):
        change_m += step_m
        z = placed[:, 2] + change_m
        is_ground = np.abs(z - target.ground_m) < _GROUND_BAND_M
        apart, row = tree.query(placed[is_ground, :2], distance_upper_bound=_VOXEL_M)
        is_near = np.isfinite(apart)
        if is_near.sum() < _MIN_GROUND_POINTS:
            return None
        above_m = ground[row[is_near], 2] - z[is_ground][is_near]
        step_m = float(np.median(above_m))
    levelled = start.lifted(change_m)
    if abs(step_m) > _MAX_LIFT_LEFT_M or abs(levelled.lift_m) < _MIN_LIFT_M:
        return None
    return levelled


def _is_nearer(
    real: FloatArray,
    before: _Candidate,
    after: _Candidate,
    settings: InputSettings,
) -> bool:
    """True if points of the simulated scan are much nearer to the real one under another candidate."""
    tree = scipy.spatial.cKDTree(as_ros(real, settings.frame_of("real")))
    points = before.sim.points[before.sim.sample]
    before_m = np.median(tree.query(before.placed(points))[0])
    after_m = np.median(tree.query(after.placed(points))[0])
    return bool(after_m < _NEARER * before_m)


def _setting(candidate: _Candidate, settings: InputSettings, motion: FloatArray) -> str:
    """Changes of settings and data that select a candidate, as text; "" if there are none."""
    parts = []
    if candidate.unit:
        parts.append(f"simulated points in metres (they are in {candidate.unit})")
    present_real = settings.frame_of("real")
    present_sim = settings.frame_of("sim")
    real_frame, sim_frame, new_motion = _frames_and_motion(
        candidate.M,
        present_real,
        present_sim,
        motion,
    )
    if real_frame != present_real:
        parts.append(f"input.real_frame={real_frame}")
    if sim_frame != present_sim:
        parts.append(f"input.sim_frame={sim_frame}")
    if not np.allclose(new_motion, motion, atol=1e-9):
        rounded = np.round(new_motion, 5) + 0.0
        numbers = " ".join(f"{value:.5g}" for value in rounded.ravel())
        parts.append(f'T_real_sim "{numbers}" in pairs.csv')
    return " and ".join(parts)


def _frames_and_motion(
    M: FloatArray,
    real: FrameName,
    sim: FrameName,
    motion: FloatArray,
) -> tuple[FrameName, FrameName, FloatArray]:
    """Frames of both sides and T_real_sim that place the simulated scan as a candidate does.

    The rotation R of T_real_sim stays if other frames are enough, as few of them as possible. A frame F converts points
    to p_ros = F p. The candidate places the simulated point q at M F_sim q, next to F_real p of the real scan. Other
    frames F' with [R | t'] do so, too, if F'_real F_real^-1 M_R F_sim = R F'_sim.

    Parameters
    ----------
    M : (3, 4) float64, of the candidate
    real, sim : present frames
    motion : (3, 4) float64, present T_real_sim
    """
    R = motion[:, :3]
    sim_axes = M[:, :3] @ _FRAMES[sim]
    # real sensors are right-handed, if anything else fits
    reals = sorted(_FRAMES, key=lambda name: name == "carla")
    candidates = sorted(
        product(reals, _FRAMES),
        key=lambda frames: (frames[0] != real, frames[1] != sim),
    )
    for new_real, new_sim in candidates:
        change = _FRAMES[new_real] @ _FRAMES[real].T
        if np.allclose(change @ sim_axes, R @ _FRAMES[new_sim], atol=1e-9):
            return new_real, new_sim, np.column_stack([R, change @ M[:, 3]])
    if np.linalg.det(M[:, :3]) > 0:
        return real, sim, M
    usual: FrameName = "ros" if sim == "carla" else "carla"
    return real, usual, np.column_stack([sim_axes @ _FRAMES[usual].T, M[:, 3]])


def _sources(sim: FloatArray, reach_ratio: float, settings: InputSettings) -> dict[str, _Side]:
    """The simulated scan by unit: as given, and in those in which it reaches about as far as the real one."""
    sources = {}
    for unit, (scale, most) in _UNITS.items():
        if 1 / most < scale / max(reach_ratio, 1e-9) < most:
            source = _thinned(sim * scale, settings, "sim")
            if len(source.points) >= _MIN_POINTS:
                sources[unit] = source
    return sources


def _thinned(points: FloatArray, settings: InputSettings, side: str) -> _Side:
    """One point per voxel, the first in the order of the scan, of the measurements within reach of the sensor."""
    with np.errstate(over="ignore"):  # infinite distances are out of reach
        is_near = level_m(points) < _REACH_M
        is_near &= np.abs(points[:, 2]) < _REACH_M
    near = points[is_near]
    first = near[~shares_voxel(near, _VOXEL_M)]
    # candidates of the simulated scan are cut when they are placed
    box = settings.include_box if side == "real" else None
    cleaning = settings.model_copy(update={"include_box": box, "voxel_m": None})
    clean = clean_scan(first, cleaning, frame=settings.frame_of(side))
    return _Side(clean.points, box)
