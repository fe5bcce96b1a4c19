"""Checks of pairs: one frame, one place, whole sweeps, two different files, each on its own side."""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Mapping
from dataclasses import replace
from pathlib import Path

from ..schemas.columns import SIDE_NAMES, SIDES
from ..schemas.record import ELSEWHERE, FrameSuspect
from ..stages.frame_search import MIN_SAME_PLACE, FrameCheck, is_only_lifted
from ..stages.plausibility import HALF_SWEEP_GAP_DEG, ScanInspection
from .datasets.pairs import ScanPair
from .stage import FRAMES, INSPECTION
from .storage.table_files import JobRecord

_WORDS = {"real": {"real"}, "sim": {"sim", "simulated", "simulation"}}


def inspection_of(
    jobs: Iterable[JobRecord],
) -> tuple[dict[str, ScanInspection], FrameCheck | None]:
    """Inspection results in the finished jobs of a pair: by side, and of both scans together."""
    sides = {}
    frames = None
    metadata = {(job.stage, job.part): job.metadata for job in jobs}
    for side in SIDES:
        sensor = metadata.get(("sensor", side), {})
        doubts = sensor["sensor"]["doubts"].values() if sensor else ()
        if sensor.get(FRAMES):
            frames = FrameCheck(**sensor[FRAMES])
        if ("ground", side) in metadata:
            inspection = ScanInspection(**metadata["ground", side][INSPECTION])
            sides[side] = replace(inspection, warnings=(*doubts, *inspection.warnings))
    return sides, frames


def frame_suspect(check: FrameCheck | None) -> FrameSuspect | None:
    """The entry of a run's record for a pair; None unless its scans seem to be of two frames or of two places."""
    if check is None or not (check.is_suspect or check.is_elsewhere):
        return None
    return FrameSuspect(
        reading=check.reading if check.is_suspect else ELSEWHERE,
        coverage=round(check.coverage, 4),
        as_it_lies=round(check.as_it_lies, 4),
        setting=check.setting,
    )


def pair_warnings(
    pair: ScanPair,
    sides: Mapping[str, ScanInspection],
    frames: FrameCheck | None,
) -> list[str]:
    """Warnings about a pair that can be evaluated all the same, one line each.

    Parameters
    ----------
    sides : inspection of its usable scans
    frames : comparison of both scans, if there is one
    """
    name = f"pair {pair.pair_id}"
    warnings = []
    for side, inspection in sides.items():
        warnings += [f"{name}: {pair.scans[side]}: {text}" for text in inspection.warnings]
    if len(sides) == len(SIDES):
        gaps = sorted((inspection.azimuth_gap_deg, side) for side, inspection in sides.items())
        (narrow_deg, narrow), (wide_deg, wide) = gaps
        if wide_deg > HALF_SWEEP_GAP_DEG >= narrow_deg:
            warnings.append(
                f"{name}: {pair.scans[wide]}: no point in a sector of {wide_deg:.0f} degrees, "
                f"{narrow_deg:.0f} on the {narrow} side; is it a half sweep (rotation frequency "
                "and tick rate of the simulator differ)?"
            )
    if frames and frames.is_suspect:
        warnings.append(f"{name}: {frame_warning(frames)}")
    if frames and frames.is_elsewhere:
        warnings.append(
            f"{name}: the two scans do not show the same place: the simulated scan covers "
            f"{frames.coverage:.2f} of the real one in the best of all frames, units and shifts "
            f"({frames.as_it_lies:.2f} as given); expected at least {MIN_SAME_PLACE:g}; pair "
            "scans of one place, or set T_real_sim"
        )
    return warnings


def frame_warning(suspect: FrameSuspect | FrameCheck) -> str:
    """One line with both figures and the setting that fixes it."""
    if is_only_lifted(suspect.reading, suspect.coverage - suspect.as_it_lies):
        return (
            "the ground of the two scans is at the same height if the simulated scan is "
            f"{suspect.reading}; is the mount height wrong? set {suspect.setting}"
        )
    condition = ""
    if "input.real_frame" in suspect.setting:
        condition = (
            ", if the real scans have these axes: directions, roll and pitch follow from it"
        )
    return (
        f"the simulated scan covers {suspect.as_it_lies:.2f} of the real one as given and "
        f"{suspect.coverage:.2f} {suspect.reading}; is it in another frame? set {suspect.setting}"
        f"{condition}"
    )


def shared_files(hashes: Mapping[str, Mapping[str, str]]) -> list[str]:
    """One line for each content that is in more than one pair or on both sides of one.

    Parameters
    ----------
    hashes : by pair and side, the content hash of the scan file
    """
    places: dict[str, list[str]] = {}
    for pair_id, sides in hashes.items():
        for side in SIDES:
            if content := sides.get(side):
                places.setdefault(content, []).append(f"{pair_id} ({side})")
    lines = []
    for names in places.values():
        if len(names) > 1:
            more = f" and {len(names) - 5} more" if len(names) > 5 else ""
            lines.append(
                f"pairs {', '.join(names[:5])}{more}: the files hold the same points; expected each "
                "scan in one pair, on one side"
            )
    return lines


def swapped_sides(pairs: Iterable[ScanPair], folder: Path) -> list[str]:
    """One line for each pair one of whose files is named after the other side, by its own name or its folders.

    Folders are those below the dataset's, or else those in which both files differ.
    """
    root = Path(os.path.realpath(folder))
    lines = []
    for pair in pairs:
        files = {side: Path(os.path.realpath(scan.file)) for side, scan in pair.scans.items()}
        if len(files) < len(SIDES) or pair.real == pair.sim:
            continue
        for side, other in (SIDES, SIDES[::-1]):
            if files[side].is_relative_to(root):
                names = set(files[side].relative_to(root).parts)
            else:
                names = set(files[side].parts) - set(files[other].parts)
            names.add(pair.scans[side].topic or "")
            words = set(re.split("[^a-z]+", "/".join(names).lower()))
            if words & _WORDS[other] and not words & _WORDS[side]:
                lines.append(
                    f"pair {pair.pair_id}: the {SIDE_NAMES[side]} scan is {pair.scans[side]}, which is "
                    f"named {SIDE_NAMES[other]}; are the sides swapped?"
                )
                break
    return lines
