"""`fidpipe check`: reads every file of a dataset once and names everything that is wrong or implausible."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from rich.console import Console

from ...schemas.columns import SIDES
from ...schemas.errors import FidpipeError
from ...schemas.settings import InputSettings, Settings
from ...stages.arrays import FloatArray, transform_of
from ...stages.clean import clean_scan, too_few_left
from ...stages.frame_search import FrameCheck, check_frames
from ...stages.ground import MIN_OBJECT_POINTS
from ...stages.plausibility import ScanInspection, inspect_points
from ..datasets.content import scan_content
from ..datasets.pairing import require_partners
from ..datasets.pairs import ScanPair, may_crash, read_dataset
from ..datasets.readers import read_scan
from ..datasets.readers.scan import Scan
from ..datasets.readers.scan_ref import ScanRef
from ..engine.progress import Reporter
from ..engine.tasks import map_tasks
from ..pair_checks import pair_warnings, shared_files, swapped_sides
from .cause_checks import CauseCheck, check_causes, evenly_chosen, sample_pair
from .side_checks import SensorCheck, SideSamples


@dataclass(frozen=True)
class ScanCheck:
    """Result of checking one scan file.

    sha256 : of its content; "" if it cannot be read
    inspection : None if it cannot be read
    n_raw, n_clean : points in the file, and after cleaning
    dropped : points dropped by cleaning, by reason
    low, high : corners of the axis-aligned box of the clean points, metres
    `fault` : reason why the file cannot be used, or None
    """

    sha256: str = ""
    n_raw: int = 0
    n_clean: int = 0
    dropped: dict[str, int] = field(default_factory=dict)
    low: list[float] = field(default_factory=list)
    high: list[float] = field(default_factory=list)
    inspection: ScanInspection | None = None
    fault: str | None = None


@dataclass(frozen=True)
class PairCheck:
    """Result of checking a pair.

    sides : by side; a missing file is left out
    frames : of both scans together; None if one is missing or too little can be compared
    `fault` : reason why the pair could not be checked; the sides have those of their files
    """

    pair: ScanPair
    sides: dict[str, ScanCheck] = field(default_factory=dict)
    frames: FrameCheck | None = None
    fault: str | None = None


@dataclass(frozen=True)
class DatasetCheck:
    """Result of checking a dataset.

    sensors : of the two sides
    causes : of a few pairs
    notes : of each side as a whole, one line each, that is nothing wrong
    doubts : one line each: points that would make what a run prescribes wrong
    `faults`, warnings : one line each, with the name of the pair
    """

    folder: Path
    pairs: list[PairCheck]
    sensors: SensorCheck
    causes: CauseCheck
    notes: list[str]
    doubts: list[str]
    faults: list[str]
    warnings: list[str]


def check_dataset(folder: Path, settings: Settings) -> DatasetCheck:
    """Read every file of a dataset once and name every problem; computes no score.

    If a reader may end its process, files are read in worker processes.

    Raises
    ------
    DatasetError
        The dataset as a whole cannot be used.
    """
    dataset = read_dataset(folder)
    require_partners(dataset)
    checks = _check_pairs(dataset.pairs, settings.input, dataset.label_names)
    sides = SideSamples(dataset.pairs, settings.input)
    chosen = evenly_chosen(
        [
            check.pair.pair_id
            for check in checks
            if check.frames and not check.frames.doubt and check.pair.pair_id in sides.pair_ids
        ]
    )
    samples = []
    for check in checks:
        pair = check.pair
        if pair.pair_id not in sides.pair_ids:
            continue
        scans = _read_again(check, settings.input, dataset.label_names)
        sample = None
        if pair.pair_id in chosen:
            sample = sample_pair(pair, scans, check.sides["real"].sha256, settings)
        if sample:
            samples.append(sample)
        sides.add(pair, scans, sample.sensors if sample else {})
    warnings = []
    faults = []
    counts: dict[str, list[int]] = {side: [] for side in SIDES}
    hashes = {}
    for check in checks:
        reasons = [check.pair.fault, check.fault, *(scan.fault for scan in check.sides.values())]
        faults += [f"pair {check.pair.pair_id}: {reason}" for reason in reasons if reason]
        inspections = {
            side: scan.inspection for side, scan in check.sides.items() if scan.inspection
        }
        warnings += pair_warnings(check.pair, inspections, check.frames)
        for side, scan in check.sides.items():
            counts[side].append(scan.n_clean)
        hashes[check.pair.pair_id] = {side: scan.sha256 for side, scan in check.sides.items()}
    return DatasetCheck(
        folder=folder,
        pairs=checks,
        sensors=sides.sensors(),
        causes=check_causes(samples),
        notes=sides.notes(),
        doubts=[*_frame_doubts(checks), *sides.doubts(serious=True)],
        faults=faults,
        warnings=[
            *dataset.warnings,
            *swapped_sides(dataset.pairs, folder),
            *shared_files(hashes),
            *warnings,
            *sides.doubts(serious=False),
            *sides.warnings(counts),
        ],
    )


def _frame_doubts(checks: list[PairCheck]) -> list[str]:
    """One line if the scans of most pairs are of two frames or of two places."""
    compared = [check.frames for check in checks if check.frames]
    doubts = Counter(frames.doubt for frames in compared if frames.doubt)
    if 2 * doubts.total() <= len(compared):
        return []
    (text, n_pairs), *_ = doubts.most_common(1)
    return [f"{text} ({n_pairs} of {len(compared)} pairs, see below)"]


def check_pair(task: tuple[ScanPair, InputSettings, dict[int, str]]) -> PairCheck:
    """Check the files of a pair, and the frames of both scans."""
    pair, settings, label_names = task
    checks = {}
    points = {}
    for side, ref in pair.scans.items():
        T_real_sim = transform_of(pair.motion(side))
        checks[side], points[side] = _check_scan(ref, side, T_real_sim, settings, label_names)
    if len(checks) < len(SIDES):
        return PairCheck(pair, checks)
    frames = check_frames(points["real"], points["sim"], settings, transform_of(pair.T_real_sim))
    return PairCheck(pair, checks, frames)


def _check_scan(
    ref: ScanRef,
    side: str,
    T_real_sim: FloatArray | None,
    settings: InputSettings,
    label_names: dict[int, str],
) -> tuple[ScanCheck, FloatArray]:
    """Check one scan; returns its points too, none if it cannot be read."""
    try:
        content = scan_content(ref)
        scan = read_scan(ref, settings.columns_of(side), label_names)
    except FidpipeError as error:
        return ScanCheck(fault=str(error)), np.empty((0, 3))
    clean = clean_scan(scan.points, settings, frame=settings.frame_of(side), T_real_sim=T_real_sim)
    n_clean = len(clean.points)
    fault = None
    if n_clean < MIN_OBJECT_POINTS:
        fault = f"{ref}: {too_few_left(n_clean, MIN_OBJECT_POINTS, clean.dropped)}"
    check = ScanCheck(
        sha256=content.sha256,
        n_raw=len(scan.points),
        n_clean=n_clean,
        dropped=clean.dropped,
        low=clean.points.min(axis=0).tolist() if n_clean else [],
        high=clean.points.max(axis=0).tolist() if n_clean else [],
        inspection=inspect_points(scan.points, side, settings, T_real_sim),
        fault=fault,
    )
    return check, scan.points


def _check_pairs(
    pairs: tuple[ScanPair, ...],
    settings: InputSettings,
    label_names: dict[int, str],
) -> list[PairCheck]:
    """Check each pair: in this process, unless a reader may end it."""
    in_workers = may_crash(pairs)
    checks, failures = map_tasks(
        check_pair,
        {pair.pair_id: (pair, settings, label_names) for pair in pairs},
        Reporter(Console(quiet=True)),
        n_workers=None if in_workers else 1,
        may_end_workers=in_workers,
    )
    for pair in pairs:
        if pair.pair_id in failures:
            checks[pair.pair_id] = PairCheck(pair, fault=failures[pair.pair_id])
    return [checks[pair.pair_id] for pair in pairs]


def _read_again(
    check: PairCheck,
    settings: InputSettings,
    label_names: dict[int, str],
) -> dict[str, Scan]:
    """The scans of a pair that was checked; one without points if it could not be read."""
    scans = {}
    for side, result in check.sides.items():
        scans[side] = Scan(np.empty((0, 3)))
        if result.sha256:
            scans[side] = read_scan(check.pair.scans[side], settings.columns_of(side), label_names)
    return scans
