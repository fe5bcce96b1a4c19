"""`fidpipe check`: reads every file of a dataset once and names everything that is wrong or implausible."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from rich.console import Console

from ...schemas.columns import SIDES, Row
from ...schemas.errors import FidpipeError, StageError
from ...schemas.results import Cause, Unknown
from ...schemas.settings import Settings
from ...stages.arrays import transform_of
from ...stages.clean import clean_scan, too_few_left
from ...stages.frame_search import FrameCheck, check_frames
from ...stages.ground import MIN_OBJECT_POINTS
from ...stages.plausibility import ScanInspection, inspect_points
from ...stages.sensor_description import SensorDescription
from ...stages.statistics.bands import evenly
from ...stages.statistics.comparison import blocks_of
from ..datasets.content import scan_content
from ..datasets.pairing import require_partners
from ..datasets.pairs import ScanPair, may_crash, read_dataset
from ..datasets.readers import read_scan
from ..datasets.readers.scan import Scan
from ..engine.pool import one_blas_thread
from ..engine.progress import Reporter
from ..engine.tasks import map_tasks
from ..engine.worker import run_in_memory
from ..jobs import STAGES
from ..pair_checks import pair_warnings, shared_files, swapped_sides
from ..results.causes import cause_values, named_causes, unknown_causes
from .side_checks import (
    SampledScan,
    describe_sides,
    sample_scan,
    sensor_doubts,
    side_notes,
    side_warnings,
    stretches_of,
)

#: Most pairs whose causes are estimated: each takes a few seconds.
MOST_PAIRS = 3
_STAGES = ("ground", "sensor", "rays", "causes")


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
    samples : by side, scans of a pair that is compared with others
    causes : rows of the table `causes`; [] if they are not estimated
    """

    pair: ScanPair
    sides: dict[str, ScanCheck] = field(default_factory=dict)
    frames: FrameCheck | None = None
    fault: str | None = None
    samples: dict[str, SampledScan] = field(default_factory=dict)
    causes: list[Row] = field(default_factory=list)

    @property
    def faults(self) -> list[str]:
        """One line for each reason why the pair cannot be evaluated."""
        reasons = [self.pair.fault, self.fault, *(scan.fault for scan in self.sides.values())]
        return [f"pair {self.pair.pair_id}: {reason}" for reason in reasons if reason]


@dataclass(frozen=True)
class DatasetCheck:
    """Result of checking a dataset.

    sensors : by side, from a few scans
    causes : named ones of a few pairs; those that affect most of the surface first
    unknown : causes that cannot be estimated
    notes : of each side as a whole, one line each, that is nothing wrong
    doubts : one line each: points that would make what a run prescribes wrong
    `faults`, warnings : one line each, with the name of the pair
    """

    folder: Path
    pairs: list[PairCheck]
    sensors: dict[str, SensorDescription]
    causes: list[Cause]
    unknown: list[Unknown]
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
    stretches = stretches_of(dataset.pairs)
    checks = _check_pairs(dataset.pairs, stretches, settings, dataset.label_names)
    warnings = [
        *dataset.warnings,
        *swapped_sides(dataset.pairs, folder),
        *_pair_warnings(checks),
    ]
    faults = []
    for check in checks:
        faults += check.faults
    samples = {}
    n_clean = {}
    for side in SIDES:
        samples[side] = {
            check.pair.pair_id: check.samples[side] for check in checks if side in check.samples
        }
        n_clean[side] = [check.sides[side].n_clean for check in checks if side in check.sides]
    warnings += sensor_doubts(samples, serious=False)
    warnings += side_warnings(samples, n_clean, stretches, settings.input)
    estimated = [check for check in checks if check.causes]
    values = cause_values([check.causes for check in estimated])
    # copies of a real scan count once
    contents = [check.sides["real"].sha256 for check in estimated]
    blocks = blocks_of(contents, [check.pair.timestamp_s for check in estimated])
    return DatasetCheck(
        folder=folder,
        pairs=checks,
        sensors=describe_sides(samples),
        causes=named_causes(values, blocks),
        unknown=unknown_causes(values),
        notes=side_notes(samples),
        doubts=[*_frame_doubts(checks), *sensor_doubts(samples, serious=True)],
        faults=faults,
        warnings=warnings,
    )


def _check_pairs(
    pairs: Sequence[ScanPair],
    stretches: Sequence[Sequence[ScanPair]],
    settings: Settings,
    label_names: dict[int, str],
) -> list[PairCheck]:
    """Check each pair: in this process, unless a reader may end it."""
    sampled = [pair for stretch in stretches for pair in stretch]
    estimated = [sampled[i] for i in evenly(len(sampled), MOST_PAIRS)]
    tasks = {}
    for pair in pairs:
        tasks[pair.pair_id] = (pair, settings, label_names, pair in sampled, pair in estimated)
    in_workers = may_crash(pairs)
    checks, failures = map_tasks(
        check_pair,
        tasks,
        Reporter(Console(quiet=True)),
        n_workers=None if in_workers else 1,
        may_end_workers=in_workers,
    )
    broken = {
        name: PairCheck(tasks[name][0], fault=reason) for name, reason in failures.items()
    }
    return [(checks | broken)[name] for name in tasks]


def check_pair(task: tuple[ScanPair, Settings, dict[int, str], bool, bool]) -> PairCheck:
    """Check the files of a pair, and the frames of both scans.

    Parameters
    ----------
    task : pair, settings, class names by number, whether it is compared with others, and whether its
        causes are estimated
    """
    pair, settings, label_names, is_sampled, with_causes = task
    checks = {}
    scans = {}
    for side in pair.scans:
        checks[side], scans[side] = _check_scan(pair, side, settings, label_names)
    frames = None
    if len(scans) == len(SIDES):
        T_real_sim = transform_of(pair.T_real_sim)
        frames = check_frames(
            scans["real"].points, scans["sim"].points, settings.input, T_real_sim
        )
    if not is_sampled:
        return PairCheck(pair, checks, frames)
    causes: list[Row] = []
    sensors: dict[str, SensorDescription] = {}
    if with_causes and frames and not frames.doubt:
        causes, sensors = _estimate_causes(pair, scans, settings)
    samples = {}
    for side, scan in scans.items():
        samples[side] = sample_scan(pair, side, scan, sensors.get(side), settings.input)
    return PairCheck(pair, checks, frames, samples=samples, causes=causes)


def _check_scan(
    pair: ScanPair,
    side: str,
    settings: Settings,
    label_names: dict[int, str],
) -> tuple[ScanCheck, Scan]:
    """Check one scan; returns it too, without points if it cannot be read."""
    ref = pair.scans[side]
    inputs = settings.input
    try:
        content = scan_content(ref)
        scan = read_scan(ref, inputs.columns_of(side), label_names)
    except FidpipeError as error:
        return ScanCheck(fault=str(error)), Scan(np.empty((0, 3)))
    T_real_sim = transform_of(pair.motion(side))
    clean = clean_scan(scan.points, inputs, frame=inputs.frame_of(side), T_real_sim=T_real_sim)
    n_clean = len(clean.points)
    fault = None
    if n_clean < MIN_OBJECT_POINTS:
        fault = f"{ref}: {too_few_left(clean, MIN_OBJECT_POINTS, inputs)}"
    check = ScanCheck(
        sha256=content.sha256,
        n_raw=len(scan.points),
        n_clean=n_clean,
        dropped=clean.dropped,
        low=clean.points.min(axis=0).tolist() if n_clean else [],
        high=clean.points.max(axis=0).tolist() if n_clean else [],
        inspection=inspect_points(scan.points, side, inputs, T_real_sim),
        fault=fault,
    )
    return check, scan


def _estimate_causes(
    pair: ScanPair, scans: Mapping[str, Scan], settings: Settings
) -> tuple[list[Row], dict[str, SensorDescription]]:
    """Rows of the causes of a pair, and the sensors of both sides; none if one of its jobs fails."""
    stages = [stage for stage in STAGES if stage.name in _STAGES]
    with one_blas_thread():
        try:
            tables, outputs = run_in_memory(stages, settings, pair=pair, scans=scans)
        except StageError:
            return [], {}
    sensors = {side: SensorDescription(**outputs["sensor", side]["sensor"]) for side in scans}
    return tables["causes", ""].to_pylist(), sensors


def _pair_warnings(checks: Sequence[PairCheck]) -> list[str]:
    """Warnings about pairs that can be evaluated all the same, those about equal files first."""
    warnings = []
    hashes = {}
    for check in checks:
        hashes[check.pair.pair_id] = {side: scan.sha256 for side, scan in check.sides.items()}
        inspections = {}
        for side, scan in check.sides.items():
            if scan.inspection:
                inspections[side] = scan.inspection
        warnings += pair_warnings(check.pair, inspections, check.frames)
    return [*shared_files(hashes), *warnings]


def _frame_doubts(checks: Sequence[PairCheck]) -> list[str]:
    """One line if the scans of most pairs are of two frames or of two places."""
    compared = [check.frames for check in checks if check.frames]
    doubts = Counter(frames.doubt for frames in compared if frames.doubt)
    if 2 * doubts.total() <= len(compared):
        return []
    (text, n_pairs), *_ = doubts.most_common(1)
    return [f"{text} ({n_pairs} of {len(compared)} pairs, see below)"]
