"""Checks of a side as a whole: sensor, late, standing still, nearly empty, ego-vehicle hits.

Based on a few scans: two stretches of five neighbouring pairs, a quarter into the dataset and
before its last quarter.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ...schemas.columns import SIDE_NAMES, SIDES
from ...schemas.settings import InputSettings
from ...stages.arrays import FloatArray, moved, transform_of
from ...stages.clean import as_ros, at_sensor, clean_scan
from ...stages.inspect.sequence_checks import (
    MAX_FRAMES_LATE,
    EgoHits,
    SequenceScan,
    TimeOffset,
    find_ego_hits,
    find_time_offset,
    is_moving,
    is_nearly_empty,
    is_static,
    moved_m,
)
from ...stages.sensor_description import (
    SensorDescription,
    describe_sensor,
)
from ...stages.trust import SERIOUS
from ..datasets.pairs import ScanPair
from ..datasets.readers.scan import Scan
from ..report.view import count
from ..results.overview import doubt_lines

_STRETCH = 5


def stretches_of(pairs: Sequence[ScanPair]) -> list[list[ScanPair]]:
    """Two times a few neighbouring pairs, in order of time; those without one come first, by their names."""
    ordered = sorted(pairs, key=lambda pair: (pair.timestamp_s or 0.0, pair.pair_id))
    if len(ordered) <= 2 * _STRETCH:
        return [ordered]
    first = len(ordered) // 4
    second = max(first + _STRETCH, 3 * len(ordered) // 4 - _STRETCH)
    return [ordered[start : start + _STRETCH] for start in (first, second)]


@dataclass(frozen=True)
class SampledScan:
    """A scan that is compared with others of its side and of the other side.

    sensor : from all its points; None if it has none
    points : clean, in the scan's own frame, z up
    place : clean, in the real sensor's frame
    notes : on the columns of its file, and from when to when it was measured
    """

    sensor: SensorDescription | None
    points: FloatArray
    place: SequenceScan
    notes: tuple[str, ...]


Samples = Mapping[str, Mapping[str, SampledScan]]  #: by side and pair


def sample_scan(
    pair: ScanPair,
    side: str,
    scan: Scan,
    sensor: SensorDescription | None,
    settings: InputSettings,
) -> SampledScan:
    """Sample of a scan for the checks of its side; without points if the scan could not be read.

    Parameters
    ----------
    sensor : of the scan, if it was described already
    """
    points = at_sensor(scan.points, side, settings)
    if sensor is None and len(points):
        # neither cleaned nor moved: beams are those of its frame
        sensor = describe_sensor(points, scan.rings)
    uncut = settings.model_copy(update={"include_box": None, "voxel_m": None})
    clean = clean_scan(scan.points, uncut, frame=settings.frame_of(side)).points
    placed = moved(clean, transform_of(pair.motion(side)))
    notes = scan.notes
    if scan.times_s is not None and np.isfinite(scan.times_s).all():
        notes = (*notes, f"{np.ptp(scan.times_s):.3g} s from first to last point")
    return SampledScan(sensor, clean, SequenceScan(placed), notes)


def describe_sides(samples: Samples) -> dict[str, SensorDescription]:
    """The sensor of each side: of its scan with the most points among those whose beams are recognised.

    A side none of whose files can be read is left out.
    """
    sensors = {}
    for side, scans in samples.items():
        described = [scan.sensor for scan in scans.values() if scan.sensor]
        if described:
            sensors[side] = max(described, key=lambda s: (bool(s.elevation_deg), s.n_points))
    return sensors


def sensor_doubts(samples: Samples, *, serious: bool) -> list[str]:
    """Doubts about the scans that make the check fail, or the others: one line for each side and kind."""
    lines = []
    for side, scans in samples.items():
        sensors = [scan.sensor for scan in scans.values() if scan.sensor]
        texts = []
        for sensor in sensors:
            texts += [
                text for need, text in sensor.doubts.items() if (need in SERIOUS) == serious
            ]
        lines += doubt_lines(side, texts, len(sensors))
    return lines


def side_notes(samples: Samples) -> list[str]:
    """Notes of the first scan of each side that has any, one line each."""
    lines = []
    for side, scans in samples.items():
        notes = next((scan.notes for scan in scans.values() if scan.notes), ())
        lines += [f"{SIDE_NAMES[side]} scans: {note}" for note in notes]
    return lines


def side_warnings(
    samples: Samples,
    n_clean: Mapping[str, Sequence[float]],
    stretches: Sequence[Sequence[ScanPair]],
    settings: InputSettings,
) -> list[str]:
    """Warnings about a side as a whole, one line each.

    Parameters
    ----------
    n_clean : by side, points of each scan after cleaning, 0 of one that cannot be used
    stretches : see `stretches_of`
    """
    n_points = {side: float(np.median(n_clean[side] or [np.nan])) for side in SIDES}
    for side, other in (SIDES, SIDES[::-1]):
        if is_nearly_empty(n_points[side], n_points[other]):
            return [
                f"the {SIDE_NAMES[side]} side is nearly empty: median of {n_points['real']:.0f} points "
                f"real and {n_points['sim']:.0f} simulated, after cleaning; was the sensor on, are its "
                "columns right?"
            ]
    sequences = {side: _sequences(samples, stretches, side) for side in SIDES}
    moved = {side: moved_m(sequences[side]) for side in SIDES}
    lines = []
    for side, other in (SIDES, SIDES[::-1]):
        if is_static(moved[side], moved[other]):
            lines.append(
                f"all {SIDE_NAMES[side]} scans are nearly identical: neighbouring ones are "
                f"{moved[side]:.2f} m apart, {SIDE_NAMES[other]} ones {moved[other]:.2f} m; is one "
                "scan written again and again?"
            )
    offset = find_time_offset([*zip(*sequences.values(), strict=True)])
    if offset and not lines:
        lines.append(_offset_text(offset))
    for side, scans in samples.items():
        if is_moving(moved[side]):
            ground_m = float(np.median([scan.place.ground_m for scan in scans.values()]))
            if hits := find_ego_hits([scan.points for scan in scans.values()], ground_m):
                lines.append(f"{SIDE_NAMES[side]} scans: {_ego_text(hits, side, settings)}")
    return lines


def _sequences(
    samples: Samples, stretches: Sequence[Sequence[ScanPair]], side: str
) -> list[list[SequenceScan]]:
    """The scans of a side in each stretch, of the pairs that have both sides."""
    has_both = samples["real"].keys() & samples["sim"].keys()
    sequences = []
    for pairs in stretches:
        names = [pair.pair_id for pair in pairs if pair.pair_id in has_both]
        sequences.append([samples[side][name].place for name in names])
    return sequences


def _offset_text(offset: TimeOffset) -> str:
    """By how many frames the simulated side is late."""
    n_frames = abs(offset.frames)
    or_more = " or more" if n_frames == MAX_FRAMES_LATE else ""
    late = "late" if offset.frames > 0 else "early"
    return (
        f"simulated scans seem {count(n_frames, 'frame')}{or_more} {late}: real ones are "
        f"{offset.misfit_m:.2f} m from those of pair {offset.frames:+d}, {offset.as_paired_m:.2f} m from their own; "
        "is fidpipe pair's --offset right, or is the simulated sensor mounted farther ahead or back?"
    )


def _ego_text(hits: EgoHits, side: str, settings: InputSettings) -> str:
    """The hits, the setting that drops them, and the share of other points that it drops."""
    # a row for each axis of the side's own frame
    axes = as_ros(np.eye(3), settings.frame_of(side))
    corners = np.array([hits.low, hits.high]) @ axes.T
    box = ",".join(
        f"{value + 0.0:.1f}" for value in (*corners.min(axis=0), *corners.max(axis=0))
    )
    return (
        f"{hits.share:.1%} of the points move with the sensor: hits on the ego vehicle? "
        f"input.exclude_box={box} drops them and {hits.others_in_box:.1%} others"
    )
