"""Doubts about a scan: reasons why some estimates from its points cannot be trusted.

A doubt is a text, by the need of a cause (`CauseModel.needs`) that the scan does not meet, such as `ONE_SWEEP` or
`BEAMS`. Two doubts make no cause unknown: `MISSES`, which cleaning drops, and `RETURNS`, because the estimates leave
out later returns of a ray.
"""

from __future__ import annotations

import math

import numpy as np
import scipy
from numpy.lib.stride_tricks import sliding_window_view

from .arrays import BoolArray, FloatArray, azimuths_deg, level_m, slopes_deg
from .beam_patterns import BeamPattern, find_beams
from .sweep import Sweep
from .thinning import shares_voxel

MISSES = "misses"
RETURNS = "single_returns"
ONE_SWEEP = "one_sweep"
POSITION = "sensor_position"
BEAMS = "beams"
#: Needed by causes of the pose and the world: several sweeps on both sides, or on none.
SAME_SWEEPS = "same_sweeps"
#: Needed by every cause: both sides in one frame, in fine coordinates.
FRAME = "frame"
#: Needed by causes of the angles: coordinates that are finer than a centimetre.
FINE = "fine_coordinates"
#: Needed by the noise of the elevation: beams that are not blurred by a tilt of the simulated side.
UPRIGHT = "upright"
#: Of both sides: azimuth steps without a doubtful ratio; no side cropped to a box; the road; returns on each for
#: several of the other.
STEPS = "azimuth_steps"
UNCROPPED = "uncropped"
ROAD = "road"
ENOUGH = "enough_returns"
#: Doubts that make `fidpipe check` fail.
SERIOUS = (MISSES, ONE_SWEEP, POSITION, FRAME)

_LEAST_DEPTH_M = 5.0
#: Distance from the farthest point, metres, in which rays without a return are written, and their least share.
_SHELLS = ((0.1, 0.03), (0.5, 0.1), (2.0, 0.2))
_BEFORE = 5.0  # widths of a shell
_TAIL = 1.5  # misses are at most so much farther below the middle of their shell than above it
_MOST_SHELL_SHARE = 0.95
_FEWEST_RETURNS = 500

_SAME_DEG = 0.005  # azimuth between returns of a ray
_SAME_SHARE = 0.1  # of later returns
_NEAREST_M = 1.0
_MOST_RETURNS = 5  # of a ray

_ROUNDED_M = 0.0095
_COARSE_M = 0.03
_FEWEST_VALUES = 20

_SEVERAL_SWEEPS = "two or more sweeps or sensors, or second returns, in one scan? {}; export one revolution per file"
_BIN_DEG = 0.01  # of gaps in azimuth
_MOST_DEG = 4.0
_FEWEST_GAPS = 500
_MOST_GROUPS = 30_000
_MOST_SWEEPS = 5
_UNEVEN = 0.2  # sweeps have 0.25 at least, other scans up to 0.18
_ALIKE = 0.9  # sweeps have 0.94 at least
_REPEATED = 0.06  # sweeps have 0.09 at least, other scans up to 0.05
_CELL_DEG = 2.0
_SAME_CELLS = 0.6  # share of the directions of both parts
_CHANGING = 2.0  # two sweeps of a moving sensor have 4, single ones up to 0.9
_SURFACE_PART = 0.2  # of the range, between returns of one surface

_THINNED = "{}: thinned by a voxel grid? Compare scans as recorded"
_SAME_DEPTH = 0.05  # of the range: two returns of one surface
_NEAREST_GRID_M = 2.0
_NEAR_GRID_M = 8.0
_FAR_GRID_M = 15.0
_FEWEST_OF_GRID = 200
_WIDER_NEAR = 1.4  # grids of 5 to 20 cm have 1.6 to 8 mostly, other scans at most 1.01
_GRIDS_M = (0.05, 0.1, 0.15, 0.2, 0.25, 0.3, 0.4, 0.5)
_SAMPLE = 5000

_NEIGHBOURS = 10
_DENSE_PART = 5  # a fifth of the points
_DENSE_M = 15.0
_NEAR_M = 5.0
_NEAR_SHARE = 0.001
_NEAR_ROAD_M = 10.0  # beams of -15 degrees on a roof meet the road after 7 to 9 m

_FEWEST_ROWS = 4  # of a range image
_MOST_CENTRED = 0.9  # share of the returns at the centres of the columns
_OFF_CENTRE = 0.002  # of a column, as 0.4 % of noiseless sweeps begin
_OFF_ROW = 0.05

_FEWEST_AT_EDGE = 20
_BEYOND_EDGE = 0.2
_INSIDE = 0.92


def find_misses(range_m: FloatArray) -> tuple[float, str]:
    """Range beyond which points are rays without a return, infinite if there are none; and the doubt, "" for none.

    Simulators write such rays at one range, and some at several. The farthest points are misses if they are in a narrow
    shell, see `_SHELLS`, and at least twice as many as in the five widths before it; then the farthest of the rest.

    Examples
    --------
    >>> limit_m, doubt = find_misses(np.concatenate([np.linspace(3, 60, 700), np.full(300, 80.0)]))
    >>> limit_m, doubt[:51]
    (79.9, '30% of the points lie at 80.0 m: rays without a ret')
    >>> find_misses(np.linspace(3, 60, 700))
    (inf, '')
    """
    limit_m = np.inf
    places = []
    left_m = np.sort(range_m)
    while shell_limit_m := _shell_limit(left_m):
        shell_m = left_m[left_m > shell_limit_m]
        middle_m = np.median(shell_m)
        tail_m = _TAIL * (left_m[-1] - middle_m)
        limit_m = float(min(shell_limit_m, middle_m - tail_m))
        left_m = left_m[left_m <= limit_m]
        share = len(shell_m) / len(range_m)
        places.append(f"{share:.0%} of the points lie at {middle_m:.1f} m")
    if not places:
        return limit_m, ""
    rounded_m = np.floor(10 * limit_m) / 10
    return limit_m, (
        f"{' and '.join(places)}: rays without a return? "
        f"They are left out; set input.max_range_m={rounded_m:g} to confirm"
    )


def _shell_limit(range_m: FloatArray) -> float | None:
    """Distance beyond which the farthest points are rays without a return; None if they are returns.

    Parameters
    ----------
    range_m : (n,) float64, ascending
    """
    if len(range_m) < _FEWEST_RETURNS or range_m[-1] - range_m[0] < _LEAST_DEPTH_M:
        return None
    for width_m, least_share in _SHELLS:
        limit_m = range_m[-1] - width_m
        n = np.count_nonzero(range_m > limit_m)
        n_before = np.count_nonzero(range_m > limit_m - _BEFORE * width_m) - n
        if least_share <= n / len(range_m) <= _MOST_SHELL_SHARE and n >= 2 * n_before:
            return limit_m
    return None


def later_returns(sweep: Sweep) -> BoolArray:
    """True for returns in the direction of the one before, of the same beam and beyond 1 m, (n,) bool."""
    is_same = (sweep.nearer_m > _NEAREST_M) & (sweep.gap_deg < _SAME_DEG)
    return np.append(False, is_same)


def returns_text(is_later: BoolArray) -> str | None:
    """The doubt that rays have several returns; None if few have."""
    ray = np.cumsum(~is_later)
    is_group = np.bincount(ray)[ray] <= _MOST_RETURNS
    share = float((is_later & is_group).mean())
    if share < _SAME_SHARE:
        return None
    return (
        f"{share:.0%} of the points are second returns of a ray "
        "(dual return, two sweeps, or written twice): only first ones count"
    )


def rounding_of(points: FloatArray) -> float:
    """Step to which x and y are rounded, metres, the larger of both; 0 if either is not rounded.

    A coordinate is rounded if differences of its sorted values are multiples of the smallest ones. So a constant may
    have been added after rounding, as to projected coordinates in float32.

    Parameters
    ----------
    points : (n, 3) float64, metres
    """
    steps_m = []
    for values in points[:, :2].T:
        gap_m = np.diff(np.unique(np.round(values, 5)))
        if len(gap_m) < _FEWEST_VALUES:
            return 0.0
        least_m = gap_m[gap_m < 1.5 * np.quantile(gap_m, 0.01)]
        step_m = np.median(least_m)
        n_steps = gap_m / step_m
        is_multiple = np.abs(n_steps - np.round(n_steps)) < 0.05
        if is_multiple.mean() < 0.95:
            return 0.0
        steps_m.append(float(step_m))
    return max(steps_m)


def doubts_of_rounding(step_m: float) -> dict[str, str]:
    """The doubt that coordinates are rounded to a step, metres, by the need that is not met; {} for a fine step."""
    text = f"coordinates are rounded to {100 * step_m:.3g} cm; export them with more digits"
    if step_m > _COARSE_M:
        return {FRAME: f"{text}, or relative to the sensor"}
    if step_m >= _ROUNDED_M:
        return {FINE: text}
    return {}


def doubts_without_beams(points: FloatArray) -> dict[str, str]:
    """The first doubt about a scan without recognisable beams, by the need that is not met; {} if there is none."""
    if text := _position_text(points):
        return {POSITION: text}
    if _is_several_sweeps(points):
        reason = "Parts of it have beams, and all of it has not"
        return {ONE_SWEEP: _SEVERAL_SWEEPS.format(reason)}
    if text := _grid_text(points):
        return {BEAMS: text}
    return {}


def alternation_text(sweep: Sweep) -> str | None:
    """The doubt that neighbouring returns of a beam are of two scans in turn; None if they are not.

    If they are, ranges of neighbours have larger third differences than ranges of every second return.
    """
    if len(sweep.beam) < _FEWEST_GAPS:
        return None
    runs_m = sliding_window_view(sweep.range_m, 7)
    is_surface = np.ptp(runs_m.T, axis=0) < _SURFACE_PART * runs_m[:, 3]
    runs_m = runs_m[is_surface & (sweep.beam[6:] == sweep.beam[:-6])]
    if len(runs_m) < _FEWEST_GAPS:
        return None
    weights = np.array([1.0, -3.0, 3.0, -1.0])
    neighbours = np.median(np.abs(runs_m[:, 2:6] @ weights))
    every_second = np.median(np.abs(runs_m[:, ::2] @ weights))
    if neighbours < _CHANGING * every_second:
        return None
    return _SEVERAL_SWEEPS.format("The ranges of a beam alternate")


def cropped_box(points: FloatArray, other: FloatArray) -> tuple[float, ...] | None:
    """Box to which a scan is cropped: minimum x and y, maximum x and y; None if it is not cropped.

    A crop has two sharp edges or more. A sharp edge is nearer than the farthest point, and the other side continues
    there: in the 2 m beyond, it has more than a fifth of its points in the 2 m before, where the scan has more than
    half as many.

    Parameters
    ----------
    points, other : (n, 3), (m, 3) float64, metres, both in one frame
    """
    reach_m = level_m(points).max()
    other = other[level_m(other) < reach_m]
    corners = []
    n_sharp = 0
    for sign in (-1.0, 1.0):
        for axis in (0, 1):
            place_m = sign * points[:, axis]
            edge_m = place_m.max()
            corners.append(float(sign * edge_m))
            beyond_m = sign * other[:, axis] - edge_m
            n_before = np.count_nonzero(np.abs(beyond_m + 1.0) < 1.0)
            n_beyond = np.count_nonzero(np.abs(beyond_m - 1.0) < 1.0)
            n_at_edge = np.count_nonzero(place_m > edge_m - 2.0)
            continues = n_beyond > _BEYOND_EDGE * n_before and edge_m < _INSIDE * reach_m
            if continues and 2 * n_at_edge > n_before >= _FEWEST_AT_EDGE:
                n_sharp += 1
    return tuple(corners) if n_sharp > 1 else None


def sweeps_text(sweep: Sweep) -> str | None:
    """The doubt that a scan holds several sweeps or scans of several sensors; None if it does not.

    The azimuths of n sweeps have n phases: the gaps of a beam differ, and repeat after n of them. After one sweep with
    noisy azimuths or many losses few groups of gaps repeat.
    """
    gap_deg = sweep.gap_deg
    two_deg = gap_deg[:-1] + gap_deg[1:]
    two_deg = two_deg[(two_deg > _SAME_DEG) & (two_deg < _MOST_DEG)]
    if len(two_deg) < _FEWEST_GAPS:
        return None
    bins = (two_deg / _BIN_DEG).astype(int)
    two_steps_deg = (np.bincount(bins).argmax() + 0.5) * _BIN_DEG
    for n_sweeps in range(2, _MOST_SWEEPS + 1):
        if _repeats_unevenly(gap_deg, n_sweeps, n_sweeps * two_steps_deg):
            return _SEVERAL_SWEEPS.format(
                f"The steps of a beam alternate, and repeat after {n_sweeps} returns"
            )
    return None


def image_text(
    azimuth_deg: FloatArray, step_deg: float, elevation_deg: FloatArray
) -> str | None:
    """The doubt that a scan was projected to a range image and back; None if it was not.

    Azimuths are then at the centres of the columns of a whole circle, and elevations are multiples of one step apart.
    Simulators without noise have the same grid, but begin with a column at 0 degrees.

    Parameters
    ----------
    azimuth_deg : (n,) of the returns
    step_deg : azimuth between firings
    elevation_deg : (b,) of the beams, ascending
    """
    if len(elevation_deg) < _FEWEST_ROWS:
        return None
    n_columns = round(360.0 / step_deg)
    off_centre = np.abs(azimuth_deg * n_columns / 360.0 % 1.0 - 0.5)
    apart_deg = np.diff(elevation_deg)
    row_deg = apart_deg.min()
    is_even = any(_are_multiples(apart_deg, row_deg / n_rows) for n_rows in (1, 2, 3))
    if not is_even or np.mean(off_centre < _OFF_CENTRE) < _MOST_CENTRED:
        return None
    return (
        f"the directions are those of a range image of {n_columns} columns, not of returns; "
        "compare scans as recorded"
    )


def _are_multiples(values: FloatArray, unit: float) -> bool:
    """True if all values are about multiples of a unit, whose exact value follows from them."""
    numbers = np.round(values / unit)
    exact = values / np.median(values / numbers)
    return bool(np.abs(exact - numbers).max() < _OFF_ROW)


def thinned_text(sweep: Sweep, points: FloatArray) -> str | None:
    """The doubt that a scan was thinned by a voxel grid, because steps of its beams are wider near the sensor, or None.

    With too few returns near or far, the points are tested as in `_grid_text`.

    Parameters
    ----------
    points : (m, 3) all points, metres
    """
    gap_deg = sweep.gap_deg
    nearer_m = sweep.nearer_m
    is_gap = (gap_deg > _SAME_DEG) & (gap_deg < _MOST_DEG)
    is_surface = is_gap & (sweep.apart_m < _SAME_DEPTH * nearer_m)
    is_near = (nearer_m > _NEAREST_GRID_M) & (nearer_m < _NEAR_GRID_M)
    near_deg = gap_deg[is_surface & is_near]
    far_deg = gap_deg[is_surface & (nearer_m > _FAR_GRID_M)]
    if min(len(near_deg), len(far_deg)) < _FEWEST_OF_GRID:
        return _grid_text(points)
    for average in (np.median, np.mean):  # of a scan with many losses only one may differ
        if average(near_deg) < _WIDER_NEAR * average(far_deg):
            return None
    return _THINNED.format("steps of a beam are wider near the sensor")


def _grid_text(points: FloatArray) -> str | None:
    """The doubt that a scan was thinned by a voxel grid, or None.

    No voxel then has two points, although most points have a neighbour nearer than the edge. Voxels have a corner at
    the origin, or half an edge below the lowest coordinates.

    Parameters
    ----------
    points : (n, 3) float64, metres
    """
    sample = points[:: math.ceil(len(points) / _SAMPLE)]
    apart_m, _ = scipy.spatial.cKDTree(points).query(sample, k=2)
    nearest_m = np.median(apart_m[:, 1])
    for size_m in _GRIDS_M:
        if nearest_m > size_m:
            continue
        for origin in (np.zeros(3), points.min(axis=0) - size_m / 2):
            if not shares_voxel(points - origin, size_m).any():
                return _THINNED.format(f"no two points share a voxel of {size_m:g} m")
    return None


def _repeats_unevenly(gap_deg: FloatArray, n: int, most_deg: float) -> bool:
    """True if gaps are uneven and repeat after n of them.

    In enough groups of 2 n gaps, any n in a row have about the same sum, the standard deviation of the gaps is a fifth
    of their mean or more, and both halves correlate.
    """
    groups = sliding_window_view(gap_deg, 2 * n)
    chosen = slice(None, None, math.ceil(len(groups) / _MOST_GROUPS))
    groups = groups[chosen]
    sums = sliding_window_view(sliding_window_view(gap_deg, n).T.sum(axis=0), n + 1)[chosen]
    with np.errstate(invalid="ignore"):  # NaN between beams
        sum_deg = np.median(sums, axis=1, keepdims=True)
        is_alike = np.abs(sums - sum_deg) < 0.1 * sum_deg
        is_repeated = is_alike.all(axis=1) & (sum_deg[:, 0] < most_deg)
    off = groups[is_repeated] * (n / sum_deg[is_repeated]) - 1.0
    first = off[:, :n]
    second = off[:, n:]
    power = (first**2).sum() * (second**2).sum()
    if not power:
        return False
    unevenness = np.sqrt((first**2).mean())
    likeness = (first * second).sum() / np.sqrt(power)
    repeated = is_repeated.mean() * unevenness
    return bool(unevenness >= _UNEVEN and likeness >= _ALIKE and repeated >= _REPEATED)


def _is_several_sweeps(points: FloatArray) -> bool:
    """True if a scan is 2, 3, 5 or 10 sweeps one after the other.

    The first and the last part then have the same directions, which parts of a single sweep in the order of azimuths or
    beams have not, and one of them has recognisable beams, which the scan as a whole has not.

    Parameters
    ----------
    points : (n, 3) float64, in the order of the file
    """
    row = (slopes_deg(points) + 90.0) // _CELL_DEG
    column = (azimuths_deg(points) + 180.0) // _CELL_DEG
    cell = row * 361 + column
    for n_sweeps in (2, 3, 5, 10):
        n_rows = len(points) // n_sweeps
        first = np.unique(cell[:n_rows])
        last = np.unique(cell[-n_rows:])
        n_common = len(np.intersect1d(first, last))
        if n_common > _SAME_CELLS * max(len(first), len(last)):
            parts = (points[:n_rows], points[-n_rows:])
            if any(isinstance(find_beams(part), BeamPattern) for part in parts):
                return True
    return False


@np.errstate(over="ignore")  # distances may be infinite
def is_far_from_origin(points: FloatArray, near_m: float = _NEAR_M) -> bool:
    """True if hardly any point lies near the origin, where the sensor should be."""
    range_m = np.linalg.norm(points[points.any(axis=1)], axis=1)
    return bool(np.count_nonzero(range_m < near_m) < _NEAR_SHARE * len(range_m))


def _position_text(points: FloatArray) -> str | None:
    """The doubt that a scan without recognisable beams is not in the frame of its sensor, or None.

    Points are densest around the sensor: the fifth with the nearest neighbours has its median place near the origin.

    Parameters
    ----------
    points : (n, 3) float64, metres
    """
    if is_far_from_origin(points, _NEAR_ROAD_M):
        reason = f"nothing within {_NEAR_ROAD_M:g} m of the origin (are they in metres?)"
    else:
        rows = np.random.default_rng(0).permutation(len(points))
        sample = points[rows[:_SAMPLE]]
        apart_m, _ = scipy.spatial.cKDTree(sample).query(sample, k=_NEIGHBOURS)
        densest = np.argsort(apart_m[:, -1])
        dense = sample[densest[: len(sample) // _DENSE_PART]]
        place_m = float(np.hypot(*np.median(dense[:, :2], axis=0)))
        if place_m < _DENSE_M:
            return None
        reason = f"they are densest {place_m:.0f} m from the origin"
    return (
        f"the points are not in the sensor's frame: {reason}, beams not recognised; "
        "set input.sensor_position, x y z of the sensor among the points"
    )
