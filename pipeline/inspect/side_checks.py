"""Checks of a side as a whole: sensor, late, standing still, nearly empty, ego-vehicle hits, times of points.

Based on a few scans: two stretches of five neighbouring pairs, a quarter into the dataset and
before its last quarter.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
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
    find_ego_hits,
    find_empty_side,
    find_static_side,
    find_time_offset,
    is_moving,
    moved_m,
)
from ...stages.inspect.stamps import check_stamps
from ...stages.intensity import intensity_law
from ...stages.sensor_description import (
    SensorDescription,
    describe_sensor,
    has_other_beams,
    name_text,
)
from ...stages.trust import SERIOUS
from ..datasets.pairs import ScanPair
from ..datasets.readers.scan import Scan
from ..results.overview import doubt_lines

_STRETCH = 5
_WITH_STAMPS = 2  # pairs
_UNIT_SCALE = 10.0  # a scale that reaches this is not that from 0 to 1


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


class SideSamples:
    """Samples from the scans of a few pairs, and the checks of both sides with them.

    pairs : all of the dataset
    """

    def __init__(self, pairs: Sequence[ScanPair], settings: InputSettings) -> None:
        self._settings = settings
        self._stretches = _stretches(pairs)
        self._sampled = {pair.pair_id for pair in chain(*self._stretches)}
        self._with_stamps = {pair.pair_id for pair in pairs[:_WITH_STAMPS]}
        self.pair_ids = self._sampled | self._with_stamps  # sampled pairs
        self._points: dict[str, dict[str, FloatArray]] = {
            side: {} for side in SIDES
        }  # clean, own frame, z up
        self._places: dict[str, dict[str, SequenceScan]] = {side: {} for side in SIDES}
        self._stamps: dict[str, tuple[float, list[str]]] = {}
        self._sensors: dict[str, dict[str, SensorDescription]] = {side: {} for side in SIDES}
        self._notes: dict[str, tuple[str, ...]] = {}
        self._intensity: dict[
            str, tuple[FloatArray, FloatArray]
        ] = {}  # of the first scan that has it, with its ranges

    def add(
        self, pair: ScanPair, scans: Mapping[str, Scan], sensors: Mapping[str, SensorDescription]
    ) -> None:
        """Add the samples of one of `pair_ids`; scans that could not be read have no points.

        Parameters
        ----------
        sensors : by side, those that were described
        """
        for side, scan in scans.items():
            # neither cleaned nor moved: beams are those of its frame
            points = at_sensor(scan.points, side, self._settings)
            if len(scan.points):
                self._sensors[side][pair.pair_id] = sensors.get(side) or describe_sensor(
                    points, scan.rings, scan.times_s is not None
                )
            if scan.notes:
                self._notes[side] = scan.notes
            if scan.intensity is not None and len(scan.points) and side not in self._intensity:
                is_finite = np.isfinite(scan.points).all(axis=1) & np.isfinite(scan.intensity)
                ranges_m = np.linalg.norm(scan.points[is_finite], axis=1)
                self._intensity[side] = (scan.intensity[is_finite], ranges_m)
            if (
                pair.pair_id in self._with_stamps
                and scan.times_s is not None
                and side not in self._stamps
            ):
                self._stamps[side] = check_stamps(scan.times_s, points)
            if pair.pair_id in self._sampled:
                uncut = self._settings.model_copy(update={"include_box": None, "voxel_m": None})
                points = clean_scan(scan.points, uncut, frame=self._settings.frame_of(side)).points
                self._points[side][pair.pair_id] = points
                T = transform_of(pair.motion(side))
                if T is not None:
                    points = points @ T[:, :3].T + T[:, 3]
                self._places[side][pair.pair_id] = SequenceScan(points)

    def sensors(self) -> SensorCheck:
        """The sensors of both sides, and those that differ from the others of their side."""
        sides = {}
        unlike = []
        pair_ids: set[str] = set()
        for side, sensors in self._sensors.items():
            if sensors:
                usual, lines = _unlike_others(sensors)
                sides[side] = sensors[usual]
                unlike += [f"{SIDE_NAMES[side]} scan of pair {line}" for line in lines]
                pair_ids |= sensors.keys()
        return SensorCheck(tuple(sorted(pair_ids)), sides, unlike)

    def doubts(self, *, serious: bool) -> list[str]:
        """Doubts about the scans that make the check fail, or the others: one line for each side and kind."""
        lines = []
        for side, sensors in self._sensors.items():
            texts = []
            for sensor in sensors.values():
                texts += [
                    text for need, text in sensor.doubts.items() if (need in SERIOUS) == serious
                ]
            lines += doubt_lines(side, texts, len(sensors))
        return lines

    def notes(self) -> list[str]:
        """Notes on the columns of a side's files and on the times of its points, one line each."""
        lines = []
        for side, notes in self._notes.items():
            lines += [f"{SIDE_NAMES[side]} scans: {note}" for note in notes]
        for side, (span_s, faults) in self._stamps.items():
            if span_s and not faults:
                lines.append(f"{SIDE_NAMES[side]} scans: {span_s:.3g} s from first to last point")
        return lines

    def warnings(self, n_clean: Mapping[str, Sequence[int]]) -> list[str]:
        """Warnings about a side as a whole, one line each.

        Parameters
        ----------
        n_clean : by side, points of each scan after cleaning, 0 of one that cannot be used
        """
        lines = []
        for side, (_, faults) in self._stamps.items():
            lines += [f"{SIDE_NAMES[side]} scans: {text}" for text in faults]
        lines += self._intensity_lines()
        counts = {side: np.array(n_clean[side], dtype=np.intp) for side in SIDES}
        empty = find_empty_side(counts["real"], counts["sim"])
        if empty is not None:
            lines.append(
                f"the {SIDE_NAMES[empty]} side is nearly empty: median of "
                f"{np.median(counts['real']):.0f} points real and {np.median(counts['sim']):.0f} "
                "simulated, after cleaning; was the sensor on, are its columns right?"
            )
            return lines
        moved = {side: moved_m(self._sequences(side)) for side in SIDES}
        static = find_static_side(moved["real"], moved["sim"])
        if static is not None:
            other = "sim" if static == "real" else "real"
            lines.append(
                f"all {SIDE_NAMES[static]} scans are nearly identical: neighbouring ones are "
                f"{moved[static]:.2f} m apart, {SIDE_NAMES[other]} ones {moved[other]:.2f} m; is one "
                "scan written again and again?"
            )
        else:
            lines += self._time_offset()
        for side in SIDES:
            lines += self._ego_hits(side, moved[side])
        return lines

    def _sequences(self, side: str) -> list[list[SequenceScan]]:
        """The scans of a side in each stretch."""
        places = self._places[side]

        def in_stretch(pairs: Sequence[ScanPair]) -> list[SequenceScan]:
            return [places[pair.pair_id] for pair in pairs if pair.pair_id in places]

        return [in_stretch(pairs) for pairs in self._stretches]

    def _intensity_lines(self) -> list[str]:
        """Intensities that no material can explain, and scales that differ, where both sides have intensities."""
        if len(self._intensity) < len(SIDES):
            return []
        laws = {}
        highest = {}
        for side, (intensity, ranges_m) in self._intensity.items():
            laws[side] = intensity_law(intensity, ranges_m)
            if len(intensity):
                highest[side] = float(np.quantile(intensity, 0.999))
        if set(laws.values()) == {"constant (0)"}:  # files with an empty column
            return []
        lines = []
        for side, law in laws.items():
            if law:
                question = "are materials simulated?" if side == "sim" else "is it recorded?"
                lines.append(f"{SIDE_NAMES[side]} scans: intensity is {law}; {question}")
        if (
            len(highest) == len(SIDES)
            and min(highest.values()) <= 1.0
            and max(highest.values()) > _UNIT_SCALE
        ):
            lines.append(
                f"intensities have different scales: up to {highest['real']:.3g} on the real "
                f"side, up to {highest['sim']:.3g} on the simulated side; expected 0 to 1 or 0 to "
                "255 on both"
            )
        return lines

    def _time_offset(self) -> list[str]:
        real = self._places["real"]
        sim = self._places["sim"]
        sequences = []
        times: list[float] = []
        for stretch in self._stretches:
            pairs = [pair for pair in stretch if pair.pair_id in real and pair.pair_id in sim]
            sequences.append(
                ([real[pair.pair_id] for pair in pairs], [sim[pair.pair_id] for pair in pairs]),
            )
            if stretch is self._stretches[0]:
                times = [pair.timestamp_s for pair in pairs if pair.timestamp_s is not None]
        offset = find_time_offset(sequences)
        if offset is None:
            return []
        n_frames = abs(offset.frames)
        lag = "a frame" if n_frames == 1 else f"{n_frames} frames"
        if n_frames == MAX_FRAMES_LATE:
            lag += " or more"
        lag += " late" if offset.frames > 0 else " early"
        if len(times) > 1:
            lag += f" ({n_frames * float(np.median(np.diff(times))):.2g} s)"
        return [
            f"simulated scans seem {lag}: real ones are {offset.misfit_m:.2f} m from those of "
            f"pair {offset.frames:+d}, {offset.as_paired_m:.2f} m from their own (better in "
            f"{offset.n_better} of {offset.n}); is fidpipe pair's --offset right, or is the "
            "simulated sensor mounted farther ahead or back?"
        ]

    def _ego_hits(self, side: str, side_moved_m: float) -> list[str]:
        scans = self._points[side]
        if not is_moving(side_moved_m) or not scans:
            return []
        ground_m = float(np.median([SequenceScan(points).ground_m for points in scans.values()]))
        hits = find_ego_hits(list(scans.values()), ground_m)
        if hits is None:
            return []
        return [f"{SIDE_NAMES[side]} scans: {_ego_text(hits, side, self._settings)}"]


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
            lines.append(f"{name}: beams {name_text(sensor)}, others {name_text(seen[usual])}")
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
