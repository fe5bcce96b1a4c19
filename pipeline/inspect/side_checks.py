"""Checks of a side as a whole: sensor, late, standing still, nearly empty, ego-vehicle hits, times of points.

Based on a few scans: two stretches of five neighbouring pairs, a quarter into the dataset and
before its last quarter.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import chain

import numpy as np

from ...schemas.columns import SIDE_NAMES, SIDES
from ...schemas.settings import InputSettings
from ...stages.arrays import FloatArray, transform_of
from ...stages.clean import as_ros, at_sensor, clean_scan
from ...stages.inspect.sequence_checks import (
    MAX_FRAMES_LATE,
    EgoHits,
    SequenceScan,
    TimeOffset,
    find_ego_hits,
    find_empty_side,
    find_static_side,
    find_time_offset,
    is_moving,
    moved_m,
)
from ...stages.inspect.stamps import check_stamps
from ...stages.sensor_description import (
    SensorDescription,
    beams_text,
    describe_sensor,
    has_other_beams,
)
from ...stages.trust import SERIOUS
from ..datasets.pairs import ScanPair
from ..datasets.readers.scan import Scan
from ..results.overview import doubt_lines

_STRETCH = 5


@dataclass(frozen=True)
class SensorCheck:
    """Sensors of both sides.

    pair_ids : pairs whose scans were described
    sides : by side, the most frequent sensor; a side none of whose files can be read is left out
    unlike : one line for each scan whose sensor is not that of the other scans of its side
    """

    pair_ids: tuple[str, ...]
    sides: dict[str, SensorDescription]
    unlike: list[str]


@dataclass
class _SideScans:
    """Sampled scans of a side, by pair.

    points : clean, in the scan's own frame, z up
    places : clean, in the real sensor's frame
    notes : on the columns of its files
    stamps : duration of the first scan that has times, and their problems
    """

    sensors: dict[str, SensorDescription] = field(default_factory=dict)
    points: dict[str, FloatArray] = field(default_factory=dict)
    places: dict[str, SequenceScan] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    stamps: tuple[float, list[str]] | None = None


class SideSamples:
    """Samples from the scans of a few pairs, and the checks of both sides with them.

    pairs : all of the dataset
    """

    def __init__(self, pairs: Sequence[ScanPair], settings: InputSettings) -> None:
        self._settings = settings
        self._stretches = _stretches(pairs)
        self.pair_ids = {pair.pair_id for pair in chain(*self._stretches)}  # sampled pairs
        self._sides = {side: _SideScans() for side in SIDES}

    def add(
        self, pair: ScanPair, scans: Mapping[str, Scan], sensors: Mapping[str, SensorDescription]
    ) -> None:
        """Add the samples of one of `pair_ids`; scans that could not be read have no points.

        Parameters
        ----------
        sensors : by side, those that were described
        """
        uncut = self._settings.model_copy(update={"include_box": None, "voxel_m": None})
        for side, scan in scans.items():
            kept = self._sides[side]
            kept.notes = scan.notes or kept.notes
            # neither cleaned nor moved: beams are those of its frame
            points = at_sensor(scan.points, side, self._settings)
            if len(points):
                kept.sensors[pair.pair_id] = sensors.get(side) or describe_sensor(
                    points, scan.rings
                )
            if scan.times_s is not None and kept.stamps is None:
                kept.stamps = check_stamps(scan.times_s, points)
            clean = clean_scan(scan.points, uncut, frame=self._settings.frame_of(side)).points
            kept.points[pair.pair_id] = clean
            T = transform_of(pair.motion(side))
            placed = clean if T is None else clean @ T[:, :3].T + T[:, 3]
            kept.places[pair.pair_id] = SequenceScan(placed)

    def sensors(self) -> SensorCheck:
        """The sensors of both sides, and those that differ from the others of their side."""
        sides = {}
        unlike = []
        pair_ids: set[str] = set()
        for side, kept in self._sides.items():
            if kept.sensors:
                usual, lines = _unlike_others(kept.sensors)
                sides[side] = kept.sensors[usual]
                unlike += [f"{SIDE_NAMES[side]} scan of pair {line}" for line in lines]
                pair_ids |= kept.sensors.keys()
        return SensorCheck(tuple(sorted(pair_ids)), sides, unlike)

    def doubts(self, *, serious: bool) -> list[str]:
        """Doubts about the scans that make the check fail, or the others: one line for each side and kind."""
        lines = []
        for side, kept in self._sides.items():
            texts = []
            for sensor in kept.sensors.values():
                texts += [
                    text for need, text in sensor.doubts.items() if (need in SERIOUS) == serious
                ]
            lines += doubt_lines(side, texts, len(kept.sensors))
        return lines

    def notes(self) -> list[str]:
        """Notes on the columns of a side's files and on the times of its points, one line each."""
        lines = []
        for side, kept in self._sides.items():
            notes = list(kept.notes)
            if kept.stamps and not kept.stamps[1]:
                notes.append(f"{kept.stamps[0]:.3g} s from first to last point")
            lines += [f"{SIDE_NAMES[side]} scans: {note}" for note in notes]
        return lines

    def warnings(self, n_clean: Mapping[str, Sequence[int]]) -> list[str]:
        """Warnings about a side as a whole, one line each.

        Parameters
        ----------
        n_clean : by side, points of each scan after cleaning, 0 of one that cannot be used
        """
        lines = []
        for side, kept in self._sides.items():
            if kept.stamps:
                lines += [f"{SIDE_NAMES[side]} scans: {text}" for text in kept.stamps[1]]
        counts = {side: np.array(n_clean[side], dtype=np.intp) for side in SIDES}
        empty = find_empty_side(counts["real"], counts["sim"])
        if empty is not None:
            lines.append(
                f"the {SIDE_NAMES[empty]} side is nearly empty: median of "
                f"{np.median(counts['real']):.0f} points real and {np.median(counts['sim']):.0f} "
                "simulated, after cleaning; was the sensor on, are its columns right?"
            )
            return lines
        sequences = {side: self._sequences(side) for side in SIDES}
        moved = {side: moved_m(sequences[side]) for side in SIDES}
        static = find_static_side(moved["real"], moved["sim"])
        if static is not None:
            other = "sim" if static == "real" else "real"
            lines.append(
                f"all {SIDE_NAMES[static]} scans are nearly identical: neighbouring ones are "
                f"{moved[static]:.2f} m apart, {SIDE_NAMES[other]} ones {moved[other]:.2f} m; is one "
                "scan written again and again?"
            )
        elif offset := find_time_offset([*zip(*sequences.values(), strict=True)]):
            lines.append(_offset_text(offset, self._stretches[0]))
        for side, kept in self._sides.items():
            if is_moving(moved[side]):
                ground_m = float(np.median([place.ground_m for place in kept.places.values()]))
                if hits := find_ego_hits(list(kept.points.values()), ground_m):
                    lines.append(
                        f"{SIDE_NAMES[side]} scans: {_ego_text(hits, side, self._settings)}"
                    )
        return lines

    def _sequences(self, side: str) -> list[list[SequenceScan]]:
        """The scans of a side in each stretch, of the pairs that have both sides."""
        has_both = set.intersection(*(set(kept.places) for kept in self._sides.values()))
        places = self._sides[side].places
        sequences = []
        for pairs in self._stretches:
            sequences.append([places[pair.pair_id] for pair in pairs if pair.pair_id in has_both])
        return sequences


def _offset_text(offset: TimeOffset, pairs: Sequence[ScanPair]) -> str:
    """By how many frames, and seconds by the times of some pairs, the simulated side is late."""
    n_frames = abs(offset.frames)
    lag = "a frame" if n_frames == 1 else f"{n_frames} frames"
    if n_frames == MAX_FRAMES_LATE:
        lag += " or more"
    lag += " late" if offset.frames > 0 else " early"
    times_s = [pair.timestamp_s for pair in pairs if pair.timestamp_s is not None]
    if len(times_s) > 1:
        lag += f" ({n_frames * float(np.median(np.diff(times_s))):.2g} s)"
    return (
        f"simulated scans seem {lag}: real ones are {offset.misfit_m:.2f} m from those of "
        f"pair {offset.frames:+d}, {offset.as_paired_m:.2f} m from their own; "
        "is fidpipe pair's --offset right, or is the simulated sensor mounted farther ahead or back?"
    )


def _stretches(pairs: Sequence[ScanPair]) -> list[list[ScanPair]]:
    """Neighbouring pairs, in order of time where it is known, else of their names."""
    ordered = list(pairs)
    if all(pair.timestamp_s is not None for pair in ordered):
        ordered.sort(key=lambda pair: (pair.timestamp_s or 0.0, pair.pair_id))
    if len(ordered) <= 2 * _STRETCH:
        return [ordered]
    first = len(ordered) // 4
    second = max(first + _STRETCH, 3 * len(ordered) // 4 - _STRETCH)
    return [ordered[start : start + _STRETCH] for start in (first, second)]


def _unlike_others(sensors: Mapping[str, SensorDescription]) -> tuple[str, list[str]]:
    """Name of the scan whose sensor is the most frequent, and one line for each scan with another sensor.

    Parameters
    ----------
    sensors : by name of the scan, at least one
    """
    seen = {name: sensor for name, sensor in sensors.items() if sensor.elevation_deg} or sensors

    def n_alike(name: str) -> tuple[int, int]:
        others = [other for other in seen.values() if not has_other_beams(seen[name], other)]
        return len(others), seen[name].n_points

    usual = max(seen, key=n_alike)
    lines = []
    for name, sensor in seen.items():
        if has_other_beams(seen[usual], sensor):
            lines.append(f"{name}: {beams_text(sensor)}; others {beams_text(seen[usual])}")
    return usual, lines


def _ego_text(hits: EgoHits, side: str, settings: InputSettings) -> str:
    """The hits, the setting that drops them, and the share of other points that it drops."""
    axes = as_ros(np.eye(3), settings.frame_of(side))  # a row for each axis of the side's own frame
    corners = np.array([hits.low, hits.high]) @ axes.T
    box = ",".join(f"{value + 0.0:.1f}" for value in (*corners.min(axis=0), *corners.max(axis=0)))
    return (
        f"{hits.share:.1%} of the points move with the sensor: hits on the ego vehicle? "
        f"input.exclude_box={box} drops them and {hits.others_in_box:.1%} others"
    )
