"""A dataset of two recordings or folders of scans, paired by name or by time; its manifest points into them."""

from __future__ import annotations

import os
import re
import shlex
import warnings
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from dataclasses import replace as with_values
from pathlib import Path

import numpy as np

from ...schemas.columns import SIDES
from ...schemas.errors import DatasetError
from ...stages.arrays import FloatArray, IndexArray
from ..storage.files import csv_bytes, write_whole
from .pairs import (
    LIST_NAMES,
    MANIFEST,
    NO_PARTNER,
    Dataset,
    folders_of_scans,
    read_rows,
    scans_in,
)
from .readers import frames_of
from .readers.formats import known_formats
from .readers.scan_ref import ScanRef, scan_ref

_TIMES = ("times.txt", "poses.tum")
#: Largest time between the two frames of a pair, seconds.
TOLERANCE_S = 0.05
_SECONDS = re.compile(r"\d+\.\d+")


@dataclass(frozen=True)
class Timeline:
    """The frames of one side.

    source : what the user named
    frames : in the order of time
    times_s : (n,) float64, seconds, rising; NaN if unknown, where names pair the frames
    """

    source: Path
    frames: tuple[ScanRef, ...]
    times_s: FloatArray


@dataclass(frozen=True)
class Pairing:
    """Frames of two time lines that belong together.

    real_ids, sim_ids : (n,) positions in the time lines, side by side
    gaps_s : (n,) float64, time of the simulated frame plus the offset, minus that of the real one
    offset_s : added to simulated times
    others_s : offsets by which as many frames pair as well; a choice of one of them is arbitrary
    by_name : True if the names of the files pair them; gaps and offset are 0 then
    """

    real_ids: IndexArray
    sim_ids: IndexArray
    gaps_s: FloatArray
    offset_s: float
    others_s: tuple[float, ...] = ()
    by_name: bool = False

    @property
    def gap_s(self) -> float:
        """Mean time between the two frames of a pair; 0 without a pair."""
        return float(np.abs(self.gaps_s).mean()) if len(self.gaps_s) else 0.0


def dataset_of(real: Path, sim: Path, out: Path) -> tuple[Path, str]:
    """Folder of the dataset of two sides, and one line on how they were paired; "" if it was a dataset before.

    Scans may be one level down, in the only folder that has any. Files of two folders are paired by
    equal names, else by equal numbers in their names, else by time, as recordings are. The manifest
    of an earlier call for the same two sides is replaced, unless it has the same pairs: it may have
    further columns by now, such as T_real_sim.

    Parameters
    ----------
    real, sim : folders of scans, or recordings
    out : folder for the manifest, if one is needed

    Raises
    ------
    FidpipeError
        A side cannot be read, nothing pairs them, or `out` has the pairs of other sides.
    """
    real, sim = _side(real), _side(sim)
    if _are_a_dataset(real, sim):
        return real.parent, ""
    real_line, sim_line, pairing = _paired(real, sim)
    _require_same_sides(real, sim, out)
    return out, write_dataset(out, real_line, sim_line, pairing, replace=True)


def _side(source: Path) -> Path:
    """The recording or folder of scans that the user means: the only folder with scans, also one level down."""
    if scan_ref(source).format.holds_frames:
        return source
    if not source.is_dir():
        raise DatasetError(
            f"{source}: expected a folder of scans or a recording (bag, capture)"
        )
    folders = folders_of_scans(source)
    if len(folders) > 1:
        names = ", ".join(path.name for path in folders)
        raise DatasetError(
            f"{source}: {len(folders)} folders hold scans ({names}); name one of them",
        )
    return folders[0] if folders else source


def _paired(real: Path, sim: Path) -> tuple[Timeline, Timeline, Pairing]:
    """The frames of both sides, paired by name if both are folders, else by time."""
    is_recording = any(scan_ref(side).format.holds_frames for side in (real, sim))
    if not is_recording:
        lines = read_timeline(real, needs_times=False), read_timeline(sim, needs_times=False)
        for name_of in (str, _only_number):
            pairing = _pair_names(lines[0].frames, lines[1].frames, name_of)
            if len(pairing.real_ids):
                return *lines, pairing
    try:
        lines = read_timeline(real), read_timeline(sim)
    except DatasetError as error:
        if is_recording:
            raise
        raise DatasetError(f"{_no_partner(real, sim)} (by time: {error})") from error
    return *lines, pair_times(lines[0].times_s, lines[1].times_s, TOLERANCE_S)


def _require_same_sides(real: Path, sim: Path, out: Path) -> None:
    """Raise `DatasetError` if a folder has the pairs of other sides."""
    for row in _listed(out / MANIFEST)[:1]:
        for source, name in zip((real, sim), row[1:], strict=True):
            # no path has a null byte
            file = scan_ref(out / name.replace("\0", "?")).file.resolve()
            if scan_ref(source).file.resolve() not in (file, file.parent):
                raise DatasetError(
                    f"{out}: has the pairs of other scans ({file.parent}); give another --out",
                )


def require_partners(dataset: Dataset) -> None:
    """Raise `DatasetError` if no scan of a dataset has a partner."""
    if all(NO_PARTNER in (pair.fault or "") for pair in dataset.pairs):
        real = dataset.folder / "real"
        sim = dataset.folder / "sim"
        raise DatasetError(
            f"dataset {dataset.folder}: {_no_partner(real, sim)}; or pair them by numbers in their "
            f"names or by time: {shlex.join(['fidpipe', 'run', str(real), str(sim)])}"
        )


def _are_a_dataset(real: Path, sim: Path) -> bool:
    """True if the folders are `real/` and `sim/` of one dataset that has a manifest or scans of the same name."""
    dataset = real.resolve().parent
    if (real.resolve(), sim.resolve()) != (dataset / "real", dataset / "sim"):
        return False
    if (dataset / MANIFEST).exists():
        return True
    stems = {scan.stem for scan in scans_in(real)}
    return any(scan.stem in stems for scan in scans_in(sim))


def _no_partner(real: Path, sim: Path) -> str:
    """Error of two folders of scans that no name pairs."""
    real_scans, sim_scans = scans_in(real), scans_in(sim)
    if not (real_scans and sim_scans):
        empty = sim if real_scans else real
        return f"no scans found in {empty}; known formats are {', '.join(known_formats())}"
    return (
        f"none of {len(real_scans)} real and {len(sim_scans)} simulated scans has a partner of the "
        f"same name, such as {real_scans[0]} and {sim_scans[0]}; rename them, or {LIST_NAMES}"
    )


def read_timeline(source: Path, *, needs_times: bool = True) -> Timeline:
    """The frames of a recording, or of a folder of scans, with their times.

    The times of a folder are the lines of its `times.txt`, the first numbers in its `poses.tum`, or
    the names of the files, if these are seconds with a decimal point.

    Parameters
    ----------
    needs_times : False if a folder may have no times, and no frames

    Raises
    ------
    FidpipeError
        It cannot be read, or its times are not known.
    """
    recording = scan_ref(source)
    if recording.format.holds_frames:
        frames = frames_of(recording)
        times_s = np.array([(frame.time_ns or 0) // 1000 for frame in frames]) / 1e6
    elif source.is_dir():
        frames = scans_in(source)
        times_s = _times_of_folder(source, [frame.stem for frame in frames], needs_times)
    else:
        raise DatasetError(
            f"{source}: expected a recording (bag, capture) or a folder of scans"
        )
    if needs_times and not frames:
        raise DatasetError(f"{source}: no frames found; expected at least one")
    order = np.argsort(times_s, kind="stable")
    return Timeline(source, tuple(frames[i] for i in order), times_s[order])


def _times_of_folder(folder: Path, stems: list[str], needs_times: bool) -> FloatArray:
    """The time of each scan of a folder, seconds; NaN if none are known and none are needed."""
    for path in (folder / name for name in _TIMES):
        if path.is_file():
            return read_times(path, len(stems))
    if all(_SECONDS.fullmatch(stem) for stem in stems):
        return np.array(stems, dtype=np.float64)
    if needs_times:
        raise DatasetError(
            f"{folder}: no times found; expected {' or '.join(_TIMES)} with a line for each scan, "
            "or names such as 12.100.ply"
        )
    return np.full(len(stems), np.nan)


def read_times(path: Path, n_scans: int) -> FloatArray:
    """(n_scans,) float64, seconds, the first numbers of the lines of times or of poses."""
    times_s = read_numbers(path, (1, 8))[:, 0]
    if len(times_s) != n_scans:
        raise DatasetError(
            f"{path}: expected one time per scan, got {len(times_s)} for {n_scans} scans",
        )
    return times_s


def _pair_names(
    real: Sequence[ScanRef], sim: Sequence[ScanRef], name_of: Callable[[str], str]
) -> Pairing:
    """The frames of both sides that have the same name, which is made of their stems."""
    real_places = _unique_places(real, name_of)
    sim_places = _unique_places(sim, name_of)
    names = [name for name in real_places if name in sim_places]
    real_ids = np.array([real_places[name] for name in names])
    sim_ids = np.array([sim_places[name] for name in names])
    return Pairing(real_ids, sim_ids, np.zeros(len(names)), 0.0, by_name=True)


def _unique_places(frames: Sequence[ScanRef], name_of: Callable[[str], str]) -> dict[str, int]:
    """Positions of the frames by name, which is made of their stems; without those that share one."""
    names = [name_of(frame.stem) for frame in frames]
    counts = Counter(names)
    return {name: i for i, name in enumerate(names) if name and counts[name] == 1}


def _only_number(stem: str) -> str:
    """The number in the name of a file, without leading zeros; "" if it has none or several."""
    numbers = re.findall("[0-9]+", stem)
    return str(int(numbers[0])) if len(numbers) == 1 else ""


def pair_times(
    real_s: FloatArray,
    sim_s: FloatArray,
    tolerance_s: float,
    offset_s: float | None = None,
) -> Pairing:
    """Frames that are each other's nearest in time, at most the tolerance apart.

    Without an offset that is taken by which most frames pair; of several such 0, or else the one of
    the smallest gaps; of equals that which brings both beginnings together. Tried are 0 and all
    that bring the first frame of one side to a frame of the other.

    Parameters
    ----------
    real_s, sim_s : (n,), (m,) float64, rising, at least one each
    offset_s : added to simulated times; None if unknown

    Examples
    --------
    >>> pairing = pair_times(np.array([100.0, 100.1, 100.2]), np.array([0.1, 0.2]), 0.05, 100.0)
    >>> pairing.real_ids.tolist(), pairing.sim_ids.tolist()
    ([1, 2], [0, 1])
    """
    if offset_s is not None:
        return _nearest(real_s, sim_s, offset_s, tolerance_s)
    offsets_s = np.concatenate([[0.0], real_s - sim_s[0], real_s[0] - sim_s])
    step_s = tolerance_s / 100
    _, first = np.unique(np.round(offsets_s / step_s), return_index=True)
    tried = []
    for tried_s in offsets_s[np.sort(first)].tolist():
        tried.append(_nearest(real_s, sim_s, tried_s, tolerance_s))

    def rank(pairing: Pairing) -> tuple[int, bool, int]:
        is_moved = pairing.offset_s != 0
        return -len(pairing.gaps_s), is_moved, round(pairing.gap_s / step_s)

    best = min(tried, key=rank)
    others_s = []
    for pairing in tried:
        is_as_good = pairing.gap_s <= best.gap_s + tolerance_s / 10
        if pairing is not best and is_as_good and len(pairing.gaps_s) == len(best.gaps_s):
            others_s.append(pairing.offset_s)
    return with_values(best, others_s=tuple(others_s) if best.offset_s else ())


def _nearest(
    real_s: FloatArray, sim_s: FloatArray, offset_s: float, tolerance_s: float
) -> Pairing:
    """Frames that are each other's nearest, with an offset added to simulated times."""
    moved_s = sim_s + offset_s
    to_sim = _nearest_ids(real_s, moved_s)
    to_real = _nearest_ids(moved_s, real_s)
    real_ids = np.arange(len(real_s))
    gaps_s = moved_s[to_sim] - real_s
    kept = (to_real[to_sim] == real_ids) & (np.abs(gaps_s) <= tolerance_s)
    return Pairing(real_ids[kept], to_sim[kept], gaps_s[kept], offset_s)


def _nearest_ids(of_s: FloatArray, among_s: FloatArray) -> IndexArray:
    """For each time the position of the nearest among others; of two equally near ones the earlier."""
    after = np.clip(np.searchsorted(among_s, of_s), 1, max(len(among_s) - 1, 1))
    before = after - 1
    after = np.minimum(after, len(among_s) - 1)
    return np.where(of_s - among_s[before] <= among_s[after] - of_s, before, after)


def read_numbers(path: Path, widths: tuple[int, ...]) -> FloatArray:
    """(n, width) float64, the lines of a file; those that begin with # are left out."""
    expected = f"expected lines of {' or '.join(map(str, widths))} numbers"
    try:
        with warnings.catch_warnings(action="ignore"):  # of a file without lines
            rows = np.loadtxt(path, ndmin=2, encoding="utf-8")
    except OSError as error:
        raise DatasetError(f"{path}: cannot be read ({error.strerror or error})") from error
    except ValueError as error:
        raise DatasetError(f"{path}: {expected} ({error})") from error
    if not len(rows):
        raise DatasetError(f"{path}: {expected}, got lines of no")
    if rows.shape[1] not in widths:
        raise DatasetError(f"{path}: {expected}, got lines of {rows.shape[1]}")
    return rows


def write_dataset(
    out: Path,
    real: Timeline,
    sim: Timeline,
    pairing: Pairing,
    kept: slice | IndexArray = slice(None),
    *,
    replace: bool = False,
) -> str:
    """Write `pairs.csv`; return one line on how frames were paired.

    Parameters
    ----------
    out : folder of the dataset
    kept : positions in the pairing of those that become pairs; by default all

    Raises
    ------
    DatasetError
        There is a manifest already and `replace` is False, or no pair.
    """
    manifest = out / MANIFEST
    if manifest.exists() and not replace:
        raise DatasetError(f"{manifest}: already exists; use --replace to overwrite it")
    real_ids = pairing.real_ids[kept]
    if not len(real_ids):
        raise DatasetError(
            f"{real.source} and {sim.source}: no two frames at one time; real are "
            f"{real.times_s[0]:.3f} to {real.times_s[-1]:.3f}, simulated {sim.times_s[0]:.3f} to "
            f"{sim.times_s[-1]:.3f} s (offset {pairing.offset_s:+.3f}); give another --offset or --tolerance"
        )
    rows: list[tuple[str, ...]] = []
    for real_id, sim_id in zip(real_ids.tolist(), pairing.sim_ids[kept].tolist(), strict=True):
        frame = real.frames[real_id]
        pair_id = frame.stem if pairing.by_name else f"{len(rows):06}"
        time_s = real.times_s[real_id]
        names = _name(frame, out), _name(sim.frames[sim_id], out)
        rows.append((pair_id, *names, "" if np.isnan(time_s) else f"{time_s:.6f}"))
    if _listed(manifest) != [row[:3] for row in rows]:
        content = csv_bytes(("pair_id", *SIDES, "timestamp_s"), rows)
        write_whole(manifest, content)
    n_unpaired = len(real.frames) + len(sim.frames) - 2 * len(pairing.real_ids)
    unpaired = f"; frames without a partner: {n_unpaired}" if n_unpaired else ""
    return f"{_how_paired(pairing, kept, manifest)}{unpaired}"


def _how_paired(pairing: Pairing, kept: slice | IndexArray, manifest: Path) -> str:
    gaps_s = np.abs(pairing.gaps_s[kept])
    pairs = "1 pair" if len(gaps_s) == 1 else f"{len(gaps_s)} pairs"
    if pairing.by_name:
        return f"{pairs} by name: {manifest}"
    text = (
        f"{pairs} by time, at most {gaps_s.max():.4f} s apart: {manifest}; clock offset "
        f"{pairing.offset_s:+.4f} s"
    )
    if pairing.others_s:
        text += (
            f", {len(pairing.others_s)} others such as {pairing.others_s[0]:+.4f} s pair as many: if "
            "it is not the right one, set it with fidpipe pair --offset"
        )
    return text


def _listed(manifest: Path) -> list[tuple[str, ...]]:
    """Name of each pair of a manifest, and those of its scans; [] if it does not exist."""
    if not manifest.exists():
        return []
    _, rows = read_rows(manifest)
    return [(row.get("pair_id", ""), row.get("real", ""), row.get("sim", "")) for row in rows]


def _name(frame: ScanRef, folder: Path) -> str:
    """The name of a frame relative to a folder."""
    path = os.path.relpath(frame.file.absolute(), folder.absolute())
    return str(with_values(frame, file=Path(path)))
