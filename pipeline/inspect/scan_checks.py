"""What the scan files of a dataset hold, and what is wrong with them or odd about a pair, before anything heavy starts.

Each file is read once, hashed and cleaned. What was learnt are plain facts that a run can keep beside the file's
length and times, so that an unchanged file need not be read again.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import TypeAdapter

from ...schemas.columns import SIDES
from ...schemas.errors import FidpipeError
from ...schemas.settings import InputSettings, Settings
from ...stages.arrays import FloatArray
from ...stages.clean import CleanResult, as_ros, clean_scan, too_few_left
from ...stages.ground import MIN_OBJECT_POINTS
from ...stages.inspect.frames import FRAMES_VERSION, can_move, check_frames
from ...stages.inspect.plausibility import HALF_SWEEP_GAP_DEG, implausible, widest_azimuth_gap_deg
from ..datasets.pairs import ScanPair, read_dataset
from ..datasets.readers import files_of, formats, holds_frames, read_scan, stem_of, suffix_of
from ..datasets.readers.frames import address_of
from ..datasets.readers.scan import Scan, label_path_of
from ..storage.files import hash_file, key_of
from .frame_checks import FrameFacts, frame_warning, place_warning, recall_frames, shared_files, swapped_sides
from .sensor_checks import SensorCheck, SensorSamples
from .side_checks import SideSamples

_MOST_NOT_FINITE = 0.25


@dataclass(frozen=True, slots=True)
class ScanContent:
    """What the keys of a pair are made of, and how many points it has.

    sha256, label_sha256 : content hashes of a scan file and of its labels, "" where it has none
    """

    sha256: str
    label_sha256: str
    n_raw: int

    def key(self, label_names: Mapping[int, str]) -> str:
        """A hash of all that the scan is read from; class names count only where it has labels."""
        names = key_of(sorted(label_names.items()) if self.label_sha256 else [])
        return key_of(key_of(self.sha256, self.label_sha256), names)


@dataclass(frozen=True)
class ScanFacts:
    """What was learnt of one scan file.

    marks : length and times of the file and its labels when it was read; the facts hold while these do
    settings_key : hash of what else the facts depend on; see `settings_key`
    sha256, label_sha256 : content hashes
    n_raw, n_clean : points in the file, and after cleaning
    dropped : points dropped by cleaning, by reason
    low, high : corners of the axis-aligned box of the clean points, metres
    azimuth_gap_deg : widest sector around the sensor without a point
    fault : why the file cannot be used, or None
    """

    marks: list[list[int]]
    settings_key: str
    sha256: str = ""
    label_sha256: str = ""
    n_raw: int = 0
    n_clean: int = 0
    dropped: dict[str, int] = field(default_factory=dict)
    low: list[float] = field(default_factory=list)
    high: list[float] = field(default_factory=list)
    azimuth_gap_deg: float = 0.0
    warnings: list[str] = field(default_factory=list)
    fault: str | None = None

    @property
    def content(self) -> ScanContent:
        """The part that keys are made of."""
        return ScanContent(self.sha256, self.label_sha256, self.n_raw)

    def as_dict(self) -> dict[str, Any]:
        """Plain values, as `recall_scan` takes them back."""
        return asdict(self)


_SCAN_FACTS = TypeAdapter(ScanFacts)


@dataclass(frozen=True)
class PairFacts:
    """What was learnt of the files of a pair.

    sides : by side; one whose file is missing is left out
    frames : of both scans together; None where one is missing
    """

    sides: dict[str, ScanFacts]
    frames: FrameFacts | None


@dataclass(frozen=True)
class DatasetCheck:
    """What would be read from a dataset, and what is wrong with it.

    pairs : each with the facts of its sides; a missing file has none
    sensors : of the two sides
    notes : of each side as a whole, one line each, that is nothing wrong
    faults, warnings : one line each, with the name of the pair
    """

    folder: Path
    pairs: list[tuple[ScanPair, dict[str, ScanFacts]]]
    sensors: SensorCheck
    notes: list[str]
    faults: list[str]
    warnings: list[str]


def check_dataset(folder: Path, settings: Settings) -> DatasetCheck:
    """Reads every file of a dataset once and names every fault; computes no score.

    Raises
    ------
    DatasetError
        The dataset as a whole cannot be used.
    """
    dataset = read_dataset(folder)
    facts, samples = [], SideSamples(dataset.pairs, settings.input)
    sensors = SensorSamples(samples.pair_ids, settings.input)
    for pair in dataset.pairs:
        own, scans = _inspect_pair(pair, settings.input, dataset.label_names)
        facts.append(own)
        samples.add(pair, scans)
        sensors.add(pair, scans)
    pairs = [(pair, own.sides) for pair, own in zip(dataset.pairs, facts, strict=True)]
    faults, warnings = [], [*dataset.warnings, *swapped_sides(dataset.pairs, folder)]
    warnings += shared_files(
        {pair.pair_id: {side: scan.sha256 for side, scan in sides.items()} for pair, sides in pairs}
    )
    for own, (pair, sides) in zip(facts, pairs, strict=True):
        own_faults = [pair.fault, *(scan.fault for scan in sides.values())]
        faults += [f"pair {pair.pair_id}: {fault}" for fault in own_faults if fault]
        warnings += [f"pair {pair.pair_id}: {text}" for text in pair_warnings(pair, sides, own.frames)]
    counts = {side: [own.sides[side].n_clean for own in facts if side in own.sides] for side in SIDES}
    warnings += samples.warnings(counts)
    return DatasetCheck(folder, pairs, sensors.check(), samples.notes(), faults, warnings)


def inspect_pairs(pairs: Sequence[ScanPair], settings: InputSettings, label_names: dict[int, str]) -> list[PairFacts]:
    """What the files of each pair hold, by side; a side whose file is missing is left out."""
    return [_inspect_pair(pair, settings, label_names)[0] for pair in pairs]


def _inspect_pair(
    pair: ScanPair, settings: InputSettings, label_names: dict[int, str]
) -> tuple[PairFacts, dict[str, Scan]]:
    """What the files of a pair hold, and their scans."""
    sides, scans = {}, {}
    for side in SIDES:
        path = pair.path(side)
        if path is not None:
            sides[side], scans[side] = inspect_scan(path, side, pair.T_real_sim, settings, label_names)
    if len(sides) < len(SIDES):
        return PairFacts(sides, None), scans
    T = np.array(pair.T_real_sim).reshape(3, 4) if pair.T_real_sim else None
    check = check_frames(scans["real"].points, scans["sim"].points, settings, T)
    return PairFacts(sides, FrameFacts(*_marks_and_keys(sides), check)), scans


def inspect_scan(
    path: Path, side: str, T_real_sim: tuple[float, ...] | None, settings: InputSettings, label_names: dict[int, str]
) -> tuple[ScanFacts, Scan]:
    """What one scan file holds, and the scan; a fault of the file is a fact, not an error, and leaves no points.

    Parameters
    ----------
    side : "real" or "sim"; the simulated side is mirrored and moved before it is cut by `include_box`
    T_real_sim : of the pair, or None
    """
    marks, key = file_marks(path), settings_key(side, T_real_sim, settings)
    try:
        scan = read_scan(path, settings.columns_of(side), label_names)
        sha256, label_sha256 = hash_scan(path)
    except (FidpipeError, OSError) as error:
        return ScanFacts(marks, key, fault=str(error)), Scan(np.empty((0, 3)))
    frame = settings.frame_of(side)
    T = np.array(T_real_sim).reshape(3, 4) if side == "sim" and T_real_sim else None
    clean = clean_scan(scan.points, settings, frame=frame, T_real_sim=T)
    own = as_ros(scan.points[np.isfinite(scan.points).all(axis=1) & scan.points.any(axis=1)], frame)
    facts = ScanFacts(
        marks=marks,
        settings_key=key,
        sha256=sha256,
        label_sha256=label_sha256,
        n_raw=len(scan.points),
        n_clean=len(clean.points),
        dropped=clean.dropped,
        low=clean.points.min(axis=0).tolist() if len(clean.points) else [],
        high=clean.points.max(axis=0).tolist() if len(clean.points) else [],
        azimuth_gap_deg=widest_azimuth_gap_deg(own),
        warnings=[
            f"{path}: {text}" for text in (*implausible(own, side, settings.min_range_m), *_not_finite(scan.points))
        ],
        fault=_too_few(path, clean, settings),
    )
    return facts, scan


def pair_warnings(pair: ScanPair, facts: dict[str, ScanFacts], frames: FrameFacts | None) -> list[str]:
    """What is odd about a pair that can be evaluated all the same, one line each."""
    warnings = [text for side in facts.values() for text in side.warnings]
    if len(facts) == 2 and not any(scan.fault for scan in facts.values()):
        (narrow_deg, narrow), (wide_deg, wide) = sorted((scan.azimuth_gap_deg, side) for side, scan in facts.items())
        if wide_deg > HALF_SWEEP_GAP_DEG >= narrow_deg:
            warnings.append(
                f"{pair.path(wide)}: no point in a sector of {wide_deg:.0f} degrees, {narrow_deg:.0f} on the "
                f"{narrow} side; is it a half sweep (rotation frequency and tick rate of the simulator differ)?"
            )
    if frames and frames.suspect:
        warnings.append(frame_warning(frames.suspect))
    if frames and frames.check and frames.check.is_elsewhere:
        warnings.append(place_warning(frames.check))
    return warnings


def hash_scan(path: Path) -> tuple[str, str]:
    """Content hashes of a scan file and of its labels; of a frame that of its points alone.

    The latter is "" where it can have none, and "column" where the file itself may hold them.
    """
    (*_, label_path), suffix = _files(path), suffix_of(path)
    sha256 = read_scan(path).content_hash() if holds_frames(path) else hash_file(path)
    if label_path.exists():
        return sha256, hash_file(label_path)
    return sha256, "column" if suffix is not None and not formats()[suffix].columns else ""


def input_hashes(
    pair: ScanPair, label_names: Mapping[int, str], contents: Mapping[str, ScanContent] | None = None
) -> dict[str, str]:
    """What a pair's numbers come from besides settings and code: each scan's hash by side, and `content` of it all.

    `content` hashes scans, their labels, the names of these, and T_real_sim.

    Parameters
    ----------
    contents : by side, where the files were read already; else they are read now
    """
    if contents is None:
        hashes = {side: hash_scan(path) for side in SIDES if (path := pair.path(side)) is not None}
    else:
        hashes = {side: (scan.sha256, scan.label_sha256) for side, scan in contents.items()}
    has_labels = any(label_sha256 for _, label_sha256 in hashes.values())
    content = key_of(hashes, sorted(label_names.items()) if has_labels else [], pair.T_real_sim)
    return {side: sha256 for side, (sha256, _) in hashes.items()} | {"content": content}


def input_name(pair: ScanPair, side: str) -> str:
    """What a file is called in a ledger: by its absolute path, so that it is known wherever the command is called."""
    path = pair.path(side)
    return f"{pair.pair_id} {side} {path and path.absolute()}"


def recall_scan(
    known: Callable[[str], Mapping[str, Any] | None], pair: ScanPair, side: str, settings: InputSettings
) -> ScanFacts | None:
    """What was learnt of a scan file before, if it still holds; else None.

    Parameters
    ----------
    known : gives the facts of a file by its `input_name`, as a run's ledger has them
    """
    path, facts = pair.path(side), known(input_name(pair, side))
    if path is None or facts is None:
        return None
    try:
        known_facts = _SCAN_FACTS.validate_python(facts)
    except ValueError:  # not as this version writes them
        return None
    is_same_file = known_facts.marks == file_marks(path)
    is_same_reading = known_facts.settings_key == settings_key(side, pair.T_real_sim, settings)
    return known_facts if is_same_file and is_same_reading else None


def file_marks(path: Path) -> list[list[int]]:
    """Length and times of a scan file and of its labels, if it has any: while they stay, so does the content."""
    marks = []
    for file in _files(path):
        try:
            status = file.stat()
        except FileNotFoundError:
            continue
        marks.append([status.st_size, status.st_mtime_ns, status.st_ctime_ns, status.st_ino])
    return marks


def recall_pair_frames(
    known: Callable[[str], Mapping[str, Any] | None], pair: ScanPair, facts: Mapping[str, ScanFacts]
) -> FrameFacts | None:
    """What was learnt of a pair's frames before, if it still holds for these facts of its files; else None."""
    return recall_frames(known, pair, *_marks_and_keys(facts))


def _files(path: Path) -> list[Path]:
    """What a scan is read from; the last is that of its labels, which may be absent."""
    return [*files_of(path), label_path_of(address_of(path).file, stem_of(path))]


@lru_cache(maxsize=64)
def settings_key(side: str, T_real_sim: tuple[float, ...] | None, settings: InputSettings) -> str:
    """A hash of what `inspect_scan` depends on besides the file."""
    return key_of(side, T_real_sim, settings.model_dump(mode="json"))


def _too_few(path: Path, clean: CleanResult, settings: InputSettings) -> str | None:
    """Why too little of a scan is left after cleaning; None if there is enough."""
    n_left = len(clean.points)
    if n_left >= MIN_OBJECT_POINTS:
        return None
    return f"{path}: {too_few_left(n_left, MIN_OBJECT_POINTS, clean.dropped, settings)}"


def _not_finite(points: FloatArray) -> list[str]:
    share = 1.0 - float(np.isfinite(points).all(axis=1).mean())
    if share <= _MOST_NOT_FINITE:
        return []
    return [f"{share:.0%} of the points are not finite (NaN or infinite) and are dropped; is the export whole?"]


def _marks_and_keys(facts: Mapping[str, ScanFacts]) -> tuple[list[list[list[int]]], list[str]]:
    """What the comparison of a pair's frames depends on: marks of both files, their settings, and the code."""
    keys = [facts[side].settings_key for side in SIDES]
    return [facts[side].marks for side in SIDES], [*keys, key_of(FRAMES_VERSION, can_move())]
