"""Checks of a side as a whole: sensor, late, standing still, nearly empty, ego-vehicle hits, times of points.

Based on a few scans: two stretches of five neighbouring pairs, a quarter into the dataset and before its last quarter.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ...schemas.columns import SIDES
from ...schemas.settings import InputSettings
from ...stages.arrays import FloatArray
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
from ...stages.inspect.stamps import StampCheck, describe_stamps, stamp_differences
from ...stages.intensity import intensity_law
from ...stages.sensor_description import SensorDescription, describe_sensor, has_other_beams, name_text
from ...stages.trust import SERIOUS
from ..datasets.pairs import ScanPair
from ..datasets.readers.scan import Scan

_STRETCH = 5
_WITH_STAMPS = 2  # pairs
_UNIT_SCALE = 10.0  # a scale that reaches this is not that from 0 to 1
_NAMES = {"real": "real", "sim": "simulated"}


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
        self._sampled = {pair.pair_id for stretch in self._stretches for pair in stretch}
        self._with_stamps = {pair.pair_id for pair in pairs[:_WITH_STAMPS]}
        self.pair_ids = self._sampled | self._with_stamps  # sampled pairs
        self._points: dict[str, dict[str, FloatArray]] = {side: {} for side in SIDES}  # clean, own frame, z up
        self._places: dict[str, dict[str, SequenceScan]] = {side: {} for side in SIDES}
        self._stamps: dict[str, StampCheck] = {}
        self._sensors: dict[str, dict[str, SensorDescription]] = {side: {} for side in SIDES}
        self._notes: dict[str, tuple[str, ...]] = {}
        self._intensity: dict[str, tuple[FloatArray, FloatArray]] = {}  # of the first scan that has it, with its ranges

    def add(self, pair: ScanPair, scans: Mapping[str, Scan]) -> None:
        """Add the samples of one of `pair_ids`; scans that could not be read have no points."""
        for side, scan in scans.items():
            frame = self._settings.frame_of(side)
            # neither cleaned nor moved: beams are those of its frame
            own_axes = at_sensor(scan.points, side, self._settings)
            if len(scan.points):
                self._sensors[side][pair.pair_id] = describe_sensor(own_axes, scan.rings, scan.times_s is not None)
            if scan.notes:
                self._notes[side] = scan.notes
            if scan.intensity is not None and len(scan.points) and side not in self._intensity:
                is_finite = np.isfinite(scan.points).all(axis=1) & np.isfinite(scan.intensity)
                self._intensity[side] = scan.intensity[is_finite], np.linalg.norm(scan.points[is_finite], axis=1)
            if pair.pair_id in self._with_stamps and scan.times_s is not None and side not in self._stamps:
                self._stamps[side] = describe_stamps(scan.times_s, own_axes, scan.stamp_s)
            if pair.pair_id in self._sampled:
                own = self._settings.model_copy(update={"include_box": None})
                points = clean_scan(scan.points, own, frame=frame).points
                self._points[side][pair.pair_id] = points
                if side == "sim" and pair.T_real_sim:
                    T = np.array(pair.T_real_sim).reshape(3, 4)
                    points = points @ T[:, :3].T + T[:, 3]
                self._places[side][pair.pair_id] = SequenceScan(points)

    def sensors(self) -> SensorCheck:
        """The sensors of both sides, and those that differ from the others of their side."""
        sides, unlike = {}, []
        for side, sensors in self._sensors.items():
            if sensors:
                usual, lines = _unlike_others(sensors)
                sides[side] = sensors[usual]
                unlike += [f"{_NAMES[side]} scan of pair {line}" for line in lines]
        pair_ids = sorted({pair_id for sensors in self._sensors.values() for pair_id in sensors})
        return SensorCheck(tuple(pair_ids), sides, unlike)

    def sensors_of(self, pair_id: str) -> dict[str, SensorDescription]:
        """The sensors of a pair by side; a side that could not be read is left out."""
        return {side: sensors[pair_id] for side, sensors in self._sensors.items() if pair_id in sensors}

    def doubts(self, *, serious: bool) -> list[str]:
        """Doubts about the scans that make the check fail, or the others: one line for each side and kind."""
        lines = []
        for side, sensors in self._sensors.items():
            pair_ids: dict[str, list[str]] = {}
            texts: dict[str, str] = {}
            for pair_id, sensor in sensors.items():
                for need, text in sensor.doubts.items():
                    if (need in SERIOUS) == serious:
                        pair_ids.setdefault(need, []).append(pair_id)
                        texts.setdefault(need, text)
            for need, text in texts.items():
                lines.append(f"{_NAMES[side]} scans ({len(pair_ids[need])} of {len(sensors)}): {text}")
        return lines

    def notes(self) -> list[str]:
        """Notes on the columns of a side's files and on the times of its points, one line each."""
        lines = [f"{_NAMES[side]} scans: {note}" for side, notes in self._notes.items() for note in notes]
        for side, stamps in self._stamps.items():
            if stamps.span_s and not stamps.faults:
                own = f"; a scan's own time is that of its {stamps.place} point" if stamps.place else ""
                lines.append(f"{_NAMES[side]} scans: {stamps.span_s:.3g} s from first to last point{own}")
        return lines

    def warnings(self, n_clean: Mapping[str, Sequence[int]]) -> list[str]:
        """Warnings about a side as a whole, one line each.

        Parameters
        ----------
        n_clean : by side, points of each scan after cleaning, 0 of one that cannot be used
        """
        lines = [f"{_NAMES[side]} scans: {text}" for side, own in self._stamps.items() for text in own.faults]
        lines += stamp_differences(self._stamps.get("real"), self._stamps.get("sim"))
        lines += self._intensity_lines()
        counts = {side: np.array(n_clean[side], dtype=np.intp) for side in SIDES}
        if empty := find_empty_side(counts["real"], counts["sim"]):
            medians = {side: f"{np.median(own):.0f}" for side, own in counts.items()}
            lines.append(
                f"the {_NAMES[empty]} side is nearly empty: median of {medians['real']} points real and "
                f"{medians['sim']} simulated, after cleaning; was the sensor on, are its columns right?"
            )
            return lines
        moved = {
            side: moved_m(
                [[own[pair.pair_id] for pair in stretch if pair.pair_id in own] for stretch in self._stretches]
            )
            for side, own in self._places.items()
        }
        if static := find_static_side(moved["real"], moved["sim"]):
            other = "sim" if static == "real" else "real"
            lines.append(
                f"all {_NAMES[static]} scans are nearly identical: neighbouring ones are {moved[static]:.2f} m apart, "
                f"{_NAMES[other]} ones {moved[other]:.2f} m; is one scan written again and again?"
            )
        else:
            lines += self._time_offset()
        for side in SIDES:
            lines += self._ego_hits(side, moved[side])
        return lines

    def _intensity_lines(self) -> list[str]:
        """Intensities that no material can explain, and scales that differ, where both sides have intensities."""
        if len(self._intensity) < len(SIDES):
            return []
        laws = {side: intensity_law(*own) for side, own in self._intensity.items()}
        if set(laws.values()) == {"constant (0)"}:  # files with an empty column
            return []
        lines = []
        for side, law in laws.items():
            if law:
                question = "are materials simulated?" if side == "sim" else "is it recorded?"
                lines.append(f"{_NAMES[side]} scans: intensity is {law}; {question}")
        highest = {side: float(np.quantile(own, 0.999)) for side, (own, _) in self._intensity.items() if len(own)}
        if len(highest) == len(SIDES) and min(highest.values()) <= 1.0 and max(highest.values()) > _UNIT_SCALE:
            lines.append(
                f"intensities have different scales: up to {highest['real']:.3g} on the real side, up to "
                f"{highest['sim']:.3g} on the simulated side; expected 0 to 1 or 0 to 255 on both"
            )
        return lines

    def _time_offset(self) -> list[str]:
        real, sim = (self._places[side] for side in SIDES)
        known = real.keys() & sim.keys()
        stretches = [[pair for pair in stretch if pair.pair_id in known] for stretch in self._stretches]
        found = find_time_offset(
            [([real[pair.pair_id] for pair in own], [sim[pair.pair_id] for pair in own]) for own in stretches]
        )
        if found is None:
            return []
        word = "late" if found.frames > 0 else "early"
        times = [pair.timestamp_s for pair in stretches[0] if pair.timestamp_s is not None]
        seconds = f" ({abs(found.frames) * float(np.median(np.diff(times))):.2g} s)" if len(times) > 1 else ""
        n = abs(found.frames)
        frames = "a frame" if n == 1 else f"{n} frames{' or more' * (n == MAX_FRAMES_LATE)}"
        return [
            f"simulated scans seem {frames} {word}{seconds}: real ones are {found.misfit_m:.2f} m from those of pair "
            f"{found.frames:+d}, {found.as_paired_m:.2f} m from their own (better in {found.n_better} of {found.n}); "
            "is fidpipe pair's --offset right, or is the simulated sensor mounted farther ahead or back?"
        ]

    def _ego_hits(self, side: str, side_moved_m: float) -> list[str]:
        scans = self._points[side]
        if not is_moving(side_moved_m) or not scans:
            return []
        ground_m = float(np.median([SequenceScan(points).ground_m for points in scans.values()]))
        hits = find_ego_hits(list(scans.values()), ground_m)
        return [] if hits is None else [f"{_NAMES[side]} scans: {_ego_text(hits, side, self._settings)}"]


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
    n_alike = {name: sum(not has_other_beams(own, other) for other in seen.values()) for name, own in seen.items()}

    def rank(name: str) -> tuple[int, bool, bool, int]:
        own = seen[name]
        return n_alike[name], own.model is not None, bool(own.is_sharp), own.n_points

    usual = max(seen, key=rank)
    others = [name for name, own in seen.items() if has_other_beams(seen[usual], own)]
    return usual, [f"{name}: beams {name_text(seen[name])}, others {name_text(seen[usual])}" for name in others]


def _ego_text(hits: EgoHits, side: str, settings: InputSettings) -> str:
    """The hits, the settings that drop them, and the share of other points that these drop."""
    axes = as_ros(np.eye(3), settings.frame_of(side))  # a row for each axis of the side's own frame
    corners = np.array([hits.low, hits.high]) @ axes.T
    box = ",".join(f"{value + 0.0:.1f}" for value in (*corners.min(axis=0), *corners.max(axis=0)))
    return (
        f"{hits.share:.1%} of the points lie within {hits.farthest_m:.1f} m and move with the sensor: hits on the ego "
        f"vehicle? input.exclude_box={box} drops them and {hits.others_in_box:.1%} others, "
        f"input.min_range_m={hits.farthest_m:.1f} them and {hits.others_in_range:.1%} others"
    )
