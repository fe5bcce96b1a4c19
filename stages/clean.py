"""Cleaning of a scan: drop points that are not measurements, and convert the rest to the real sensor's frame."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..schemas.settings import Box, FrameName, InputSettings
from .arrays import BoolArray, FloatArray, IntArray, moved
from .thinning import repeats_earlier_row, shares_voxel
from .trust import find_misses

#: Column and sign of x forward, y left and z up in each frame.
_AXES: dict[FrameName, tuple[list[int], list[float]]] = {
    "ros": ([0, 1, 2], [1.0, 1.0, 1.0]),
    "carla": ([0, 1, 2], [1.0, -1.0, 1.0]),
    "nuscenes": ([1, 0, 2], [1.0, -1.0, 1.0]),
    "kitti-cam": ([2, 0, 1], [1.0, -1.0, -1.0]),
}


@dataclass(frozen=True)
class CleanResult:
    """Points of a scan that are measurements.

    point_ids : (m,) int32, rows of the input, ascending
    points : (m, 3) float64, metres, real sensor's frame, x forward, y left, z up
    dropped : number of points dropped, by reason, in the order in which the reasons are tried
    """

    point_ids: IntArray
    points: FloatArray
    dropped: dict[str, int]


def clean_scan(
    points: FloatArray,
    settings: InputSettings,
    *,
    frame: FrameName = "ros",
    T_real_sim: FloatArray | None = None,
) -> CleanResult:
    """Drop points that are not measurements, and return the others in the real sensor's frame.

    In the scan's own frame these points are dropped, in this order: points that are not finite; exact (0, 0, 0); exact
    duplicates of an earlier row; rays without a return that are written at one range, see `trust.find_misses`; points
    with a range |p| outside [min_range_m, max_range_m]; points inside `exclude_box`. Then the axes are converted to x
    forward, y left, z up, p becomes R p + t if `T_real_sim` = [R | t] is given, and points outside `include_box` are
    dropped. With `voxel_m`, only the first row of each voxel is kept, in the real sensor's frame.

    Parameters
    ----------
    points : (n, 3) float64, metres, the scan's own frame; may hold NaN and infinities
    settings : ranges and boxes
    frame : frame that defines the axes of the scan; see `as_ros`
    T_real_sim : (3, 4) float64, maps the simulated sensor's frame into the real one's, both x forward, y left, z up

    Examples
    --------
    >>> import numpy as np
    >>> scan = np.array([[5.0, 0, 0], [0, 0, 0], [5, 0, 0], [np.nan, 0, 0], [1, 0, 0]])
    >>> clean = clean_scan(scan, InputSettings())
    >>> clean.point_ids.tolist(), [reason for reason, n in clean.dropped.items() if n]
    ([0], ['not_finite', 'zero', 'duplicate', 'too_near'])
    """
    ids = np.arange(len(points), dtype=np.int32)
    dropped: dict[str, int] = {}

    def drop(reason: str, is_dropped: BoolArray) -> None:
        nonlocal ids, points
        dropped[reason] = int(np.count_nonzero(is_dropped))
        if dropped[reason]:
            ids = ids[~is_dropped]
            points = points[~is_dropped]

    drop("not_finite", ~np.all(np.isfinite(points), axis=1))
    drop("zero", ~np.any(points, axis=1))
    drop("duplicate", repeats_earlier_row(points))
    with np.errstate(over="ignore"):  # an infinite range is too far
        range_m = np.sqrt((points**2).sum(axis=1))
    limit_m, _ = find_misses(range_m)
    is_no_return = range_m > limit_m
    drop("no_return", is_no_return)
    range_m = range_m[~is_no_return]
    near = range_m < settings.min_range_m
    drop("too_near", near)
    drop("too_far", range_m[~near] > settings.max_range_m)
    drop("in_exclude_box", inside(points, settings.exclude_box, default=False))
    points = moved(as_ros(points, frame), T_real_sim)
    drop("outside_include_box", ~inside(points, settings.include_box))
    if settings.voxel_m is not None:
        drop("thinned", shares_voxel(points, settings.voxel_m))
    return CleanResult(ids, np.ascontiguousarray(points), dropped)


def as_ros(points: FloatArray, frame: FrameName) -> FloatArray:
    """Points converted to x forward, y left and z up (REP 103), (n, 3) float64; the input array if frame is "ros".

    Parameters
    ----------
    points : (n, 3) float64, metres
    frame : frame of the recording: "ros"; "carla", left-handed; "nuscenes", that of its LIDAR_TOP; "kitti-cam"

    Examples
    --------
    >>> import numpy as np
    >>> as_ros(np.array([[1.0, 2.0, 3.0]]), "kitti-cam").tolist()
    [[3.0, -1.0, -2.0]]
    """
    if frame == "ros":
        return points
    columns, signs = _AXES[frame]
    return points[:, columns] * signs


def at_sensor(points: FloatArray, side: str, settings: InputSettings) -> FloatArray:
    """Points in the axes of `as_ros`, with the sensor of the side ("real" or "sim") at the origin."""
    points = as_ros(points, settings.frame_of(side))
    if settings.sensor_position is None:
        return points
    return points - settings.sensor_position


def seen_from(
    position: tuple[float, float, float],
    T_real_sim: FloatArray | None,
) -> FloatArray | None:
    """T_real_sim between points relative to the sensor, if it is at the same position among the points of both sides.

    Parameters
    ----------
    position : x y z of the sensor among the points as recorded, metres
    T_real_sim : (3, 4) float64, between the points as recorded; None for the identity
    """
    if T_real_sim is None:
        return None
    R = T_real_sim[:, :3]
    t = T_real_sim[:, 3]
    return np.column_stack([R, t - position + R @ position])


def too_few_left(clean: CleanResult, n_fewest: int, settings: InputSettings) -> str:
    """Message for a scan with too few points after cleaning: counts by reason, and how to keep more.

    Examples
    --------
    >>> settings = InputSettings()
    >>> clean = clean_scan(np.array([[9.0, 0, 0], [1, 0, 0], [2, 0, 0], [0, 0, 999]]), settings)
    >>> too_few_left(clean, 8, settings)
    'expected at least 8 points after cleaning, got 1 (2 too near, 1 too far); lower input.min_range_m (now 2.5)'
    """
    counts = {reason: n for reason, n in clean.dropped.items() if n}
    reasons = [f"{n} {reason.replace('_', ' ')}" for reason, n in counts.items()]
    why = ", ".join(reasons) or "no more in the file"
    remedies = {
        "too_near": f"lower input.min_range_m (now {settings.min_range_m:g})",
        "too_far": "give the points in metres, in the sensor's frame",
        "in_exclude_box": "shrink input.exclude_box",
        "outside_include_box": "widen input.include_box",
        "thinned": f"lower input.voxel_m (now {settings.voxel_m})",
    }
    if settings.max_range_m < InputSettings().max_range_m:
        remedies["too_far"] += f", or raise input.max_range_m (now {settings.max_range_m:g})"
    worst = max(counts, key=counts.__getitem__, default="")
    remedy = remedies.get(worst, "check that the export is complete")
    return f"expected at least {n_fewest} points after cleaning, got {len(clean.points)} ({why}); {remedy}"


def inside(points: FloatArray, box: Box | None, *, default: bool = True) -> BoolArray:
    """True for points in the box, bounds included, (n,) bool; without a box, the default for all points."""
    if box is None:
        return np.full(len(points), default)
    low = box[:3]
    high = box[3:]
    return np.all((points >= low) & (points <= high), axis=1)
