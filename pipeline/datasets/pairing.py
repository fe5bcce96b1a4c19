"""A dataset of two recordings or folders of scans, paired by name or by time; its manifest points into them."""

from __future__ import annotations

import os
import re
import shlex
import warnings
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ...schemas.columns import SIDES
from ...schemas.errors import DatasetError
from ...stages.arrays import FloatArray, IntArray
from ..storage.files import csv_bytes, write_whole
from .pairs import LIST_NAMES, MANIFEST, NO_PARTNER, UNPAIRED, Dataset, read_manifest
from .readers import formats, frames_of, holds_frames, stem_of, suffix_of
from .readers.frame_address import address_of

_TIMES = ("times.txt", "poses.tum")
#: Largest time between the two frames of a pair, seconds.
TOLERANCE_S = 0.05
_SECONDS = re.compile(r"\d+\.\d+")


@dataclass(frozen=True)
class Timeline:
    """The frames of one side.

    source : what the user named
    frames : scan files, or what names a frame in one; in the order of time
    times_s : (n,) float64, seconds, rising; NaN if unknown, where names pair the frames
    """

    source: Path
    frames: tuple[Path, ...]
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

    real_ids: IntArray
    sim_ids: IntArray
    gaps_s: FloatArray
    offset_s: float
    others_s: tuple[float, ...] = ()
    by_name: bool = False


def dataset_of(real: Path, sim: Path, out: Path) -> tuple[Path, str]:
    """Folder of the dataset of two sides, and one line on how they were paired; "" if it was a dataset before.

    Scans may be one level down, in the only folder that has any. Files of two folders are paired by equal names, else
    by equal numbers in their names, else by time, as recordings are. The manifest of an earlier call for the same two
    sides is replaced.

    Parameters
    ----------
    real, sim : folders of scans, or recordings
    out : folder for the manifest, if one is needed

    Raises
    ------
    FidpipeError
        A side cannot be read, nothing pairs them, or `out` has the pairs of other sides.
    """
    for source in (real, sim):
        if not (source.is_dir() or holds_frames(source)):
            raise DatasetError(f"{source}: expected a folder of scans or a recording (bag, capture)")
    real, sim = _side(real), _side(sim)
    if _are_a_dataset(real, sim):
        return real.parent, ""
    is_recording = holds_frames(real) or holds_frames(sim)
    if by_name := None if is_recording else _paired_by_name(real, sim):
        lines, pairing = by_name
    else:
        try:
            lines = read_timeline(real), read_timeline(sim)
        except DatasetError as error:
            if is_recording:
                raise
            by_time = f" (by time: {error})" if all(map(scans_in, (real, sim))) else ""
            raise DatasetError(f"{_no_partner(real, sim)}{by_time}") from error
        pairing = pair_times(lines[0].times_s, lines[1].times_s, TOLERANCE_S)
    before = read_manifest(out / MANIFEST, []) if (out / MANIFEST).exists() else []
    for source, path in ((real, before[0].real), (sim, before[0].sim)) if before else ():
        file = address_of(path).file.resolve() if path else out
        if address_of(source).file.resolve() not in (file, file.parent):
            raise DatasetError(f"{out}: has the pairs of other scans ({file.parent}); give another --out")
    n_unpaired = write_dataset(out, *lines, pairing, np.arange(len(pairing.real_ids), dtype=np.int32), replace=True)
    others = f"; {len(pairing.others_s)} other offsets pair as many, see fidpipe pair" if pairing.others_s else ""
    how = "name" if pairing.by_name else f"time (simulated times {pairing.offset_s:+.4f} s{others})"
    return out, f"{len(pairing.real_ids)} pairs by {how}, {n_unpaired} frames without a partner: {out / MANIFEST}"


def require_partners(dataset: Dataset) -> None:
    """Raise `DatasetError` if no scan of a dataset has a partner."""
    if all(NO_PARTNER in (pair.fault or "") for pair in dataset.pairs):
        raise DatasetError(f"dataset {dataset.folder}: {_no_partner(*(dataset.folder / side for side in SIDES))}")


def _are_a_dataset(real: Path, sim: Path) -> bool:
    """True if the folders are `real/` and `sim/` of one dataset that has a manifest or scans of the same name."""
    own, other = real.resolve(), sim.resolve()
    if (own.name, other.name) != SIDES or own.parent != other.parent:
        return False
    names = ({stem_of(frame) for frame in scans_in(side)} for side in (real, sim))
    return (own.parent / MANIFEST).exists() or bool(set.intersection(*names))


def _no_partner(real: Path, sim: Path) -> str:
    """Error of two folders of scans that no name pairs: counts, an example, and the next step."""
    frames = {side: scans_in(side) for side in (real, sim)}
    for side, other in ((real, sim), (sim, real)):
        if not frames[side]:
            return (
                f"no scans found in {side}; expected one of the same name for each of the {len(frames[other])} in "
                f"{other}; known formats are {', '.join(formats())}"
            )
    first = " and ".join(str(own[0]) for own in frames.values())
    counts = f"none of {len(frames[real])} real and {len(frames[sim])} simulated scans has a partner of the same name"
    if _paired_by_name(real, sim):
        advice = f"their numbers pair them: {shlex.join(['fidpipe', 'run', str(real), str(sim)])}"
    else:
        advice = f"rename them, or {LIST_NAMES}"
    return f"{counts}, such as {first}; {advice}"


def read_timeline(source: Path) -> Timeline:
    """The frames of a recording, or of a folder of scans, with their times.

    The times of a folder are the lines of its `times.txt`, the first numbers in its `poses.tum`, or the names of the
    files, if these are seconds with a decimal point.

    Raises
    ------
    FidpipeError
        It cannot be read, or its times are not known.
    """
    if holds_frames(source):
        frames = frames_of(source)
        times_ns = [address_of(frame).time_ns for frame in frames]
        return _in_order(source, frames, np.array([(ns or 0) // 1000 for ns in times_ns]) / 1e6)
    if not source.is_dir():
        raise DatasetError(f"{source}: expected a recording (bag, capture) or a folder of scans")
    frames = scans_in(source)
    times = next((source / name for name in _TIMES if (source / name).is_file()), None)
    if times is not None:
        seconds = read_numbers(times, (1, 8))[:, 0]
        if len(seconds) != len(frames):
            raise DatasetError(f"{times}: expected one time per scan, got {len(seconds)} for {len(frames)} scans")
        return _in_order(source, frames, seconds)
    names = [stem_of(frame) for frame in frames]
    if not all(map(_SECONDS.fullmatch, names)):
        raise DatasetError(
            f"{source}: no times found; expected {' or '.join(_TIMES)} with a line for each scan, or names such as "
            "12.100.ply"
        )
    return _in_order(source, frames, np.array(names, dtype=np.float64))


def _in_order(source: Path, frames: Sequence[Path], times_s: FloatArray) -> Timeline:
    if not frames:
        raise DatasetError(f"{source}: no frames found; expected at least one")
    order = np.argsort(times_s, kind="stable")
    return Timeline(source, tuple(frames[i] for i in order), times_s[order])


def _paired_by_name(real: Path, sim: Path) -> tuple[tuple[Timeline, Timeline], Pairing] | None:
    """The files of two folders that have the same name, or the same number in it; None without any."""
    frames = scans_in(real), scans_in(sim)
    for name_of in (stem_of, _only_number):
        names, others = ([name_of(frame) for frame in own] for own in frames)
        place = {name: i for i, name in enumerate(others) if name and others.count(name) == 1}
        ids = np.array([(i, place[name]) for i, name in enumerate(names) if name in place and names.count(name) == 1])
        if len(ids):
            times_s = [np.full(len(own), np.nan) for own in frames]
            with suppress(DatasetError):
                line = read_timeline(real)
                time_of = dict(zip(line.frames, line.times_s.tolist(), strict=True))
                times_s[0] = np.array([time_of[frame] for frame in frames[0]])
            lines = Timeline(real, tuple(frames[0]), times_s[0]), Timeline(sim, tuple(frames[1]), times_s[1])
            return lines, Pairing(ids[:, 0], ids[:, 1], np.zeros(len(ids)), 0.0, by_name=True)
    return None


def _only_number(frame: Path) -> str:
    """The number in the name of a file, without leading zeros; "" if it has none or several."""
    numbers = re.findall("[0-9]+", stem_of(frame))
    return str(int(numbers[0])) if len(numbers) == 1 else ""


def pair_times(real_s: FloatArray, sim_s: FloatArray, tolerance_s: float, offset_s: float | None = None) -> Pairing:
    """Frames that are each other's nearest in time, at most the tolerance apart.

    Without an offset that is taken by which most frames pair; of several such 0, or else the one of the smallest gaps;
    of equals that which brings both beginnings together. Tried are 0 and all that bring the first frame of one side to
    a frame of the other.

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
        return Pairing(*_nearest(real_s, sim_s + offset_s, tolerance_s), offset_s)
    tried = np.concatenate([[0.0], real_s - sim_s[0], real_s[0] - sim_s])
    step = tolerance_s / 100
    tried = tried[np.sort(np.unique(np.round(tried / step), return_index=True)[1])]
    found = [_nearest(real_s, sim_s + offset, tolerance_s) for offset in tried]
    most = max(len(gaps) for *_, gaps in found)
    spread = [float(np.abs(gaps).mean()) if len(gaps) == most and most else np.inf for *_, gaps in found]
    if np.isfinite(spread[0]) or not most:
        return Pairing(*found[0], 0.0)
    best = int(np.argmin(np.round(np.array(spread) / step)))
    limit_s = spread[best] + tolerance_s / 10
    alike = [float(offset) for i, offset in enumerate(tried) if i != best and spread[i] <= limit_s]
    return Pairing(*found[best], float(tried[best]), tuple(alike))


def _nearest(real_s: FloatArray, sim_s: FloatArray, tolerance_s: float) -> tuple[IntArray, IntArray, FloatArray]:
    """Positions of frames that are each other's nearest, and their gaps."""
    to_sim, to_real = _nearest_ids(real_s, sim_s), _nearest_ids(sim_s, real_s)
    real_ids = np.arange(len(real_s))
    gaps_s = sim_s[to_sim] - real_s
    kept = (to_real[to_sim] == real_ids) & (np.abs(gaps_s) <= tolerance_s)
    return real_ids[kept], to_sim[kept], gaps_s[kept]


def _nearest_ids(of_s: FloatArray, among_s: FloatArray) -> IntArray:
    """For each time the position of the nearest among others; of two equally near ones the earlier."""
    after = np.clip(np.searchsorted(among_s, of_s), 1, max(len(among_s) - 1, 1))
    before = after - 1
    after = np.minimum(after, len(among_s) - 1)
    return np.where(of_s - among_s[before] <= among_s[after] - of_s, before, after)


def folders_of_scans(folder: Path) -> list[Path]:
    """The folder itself if it holds scans, else those one level down that do."""
    if scans_in(folder):
        return [folder]
    inner = [path for path in sorted(folder.iterdir()) if path.is_dir() and not path.name.startswith(".")]
    return [path for path in inner if scans_in(path)]


def _side(source: Path) -> Path:
    """The recording or folder of scans that the user means: the only folder with scans, also one level down."""
    if holds_frames(source) or not source.is_dir():
        return source
    folders = folders_of_scans(source)
    if len(folders) > 1:
        names = ", ".join(path.name for path in folders)
        raise DatasetError(f"{source}: {len(folders)} folders hold scans ({names}); name one of them")
    return folders[0] if folders else source


def scans_in(folder: Path) -> list[Path]:
    """The scan files of a folder, in the order of their names; recordings of many scans are left out."""
    return sorted(
        path
        for path in folder.iterdir()
        if path.is_file()
        and not path.name.startswith(".")
        and path.name not in (MANIFEST, UNPAIRED)
        and suffix_of(path) is not None
        and not holds_frames(path)
    )


def read_numbers(path: Path, widths: tuple[int, ...]) -> FloatArray:
    """(n, width) float64, the lines of a file; those that begin with # are left out."""
    wanted = " or ".join(map(str, widths))
    try:
        with warnings.catch_warnings(action="ignore"):  # of a file without lines
            rows = np.loadtxt(path, ndmin=2, encoding="utf-8")
    except OSError as error:
        raise DatasetError(f"{path}: cannot be read ({error.strerror or error})") from error
    except ValueError as error:
        raise DatasetError(f"{path}: expected lines of {wanted} numbers ({error})") from error
    if not len(rows) or rows.shape[1] not in widths:
        raise DatasetError(
            f"{path}: expected lines of {wanted} numbers, got lines of {rows.shape[1] if len(rows) else 'no'}"
        )
    return rows


def write_dataset(
    out: Path, real: Timeline, sim: Timeline, pairing: Pairing, kept: IntArray, *, replace: bool = False
) -> int:
    """Write `pairs.csv`, and `unpaired.csv` with the frames without a partner; return the number of these.

    Parameters
    ----------
    out : folder of the dataset
    kept : positions in the pairing of those that become pairs

    Raises
    ------
    DatasetError
        There is a manifest already and `replace` is False, or no pair.
    """
    manifest = out / MANIFEST
    if manifest.exists() and not replace:
        raise DatasetError(f"{manifest}: already exists; use --replace to overwrite it")
    if not len(kept):
        raise DatasetError(
            f"{real.source} and {sim.source}: no two frames at one time; real are {_span(real)}, simulated "
            f"{_span(sim)} s (offset {pairing.offset_s:+.3f}); give another --offset or --tolerance"
        )
    rows = []
    for number, i in enumerate(kept.tolist()):
        frame, time_s = real.frames[pairing.real_ids[i]], real.times_s[pairing.real_ids[i]]
        name = stem_of(frame) if pairing.by_name else f"{number:06}"
        rows.append((name, _relative(frame, out), _relative(sim.frames[pairing.sim_ids[i]], out), _seconds(time_s)))
    lonely = []
    for side, line, ids in zip(SIDES, (real, sim), (pairing.real_ids, pairing.sim_ids), strict=True):
        without = np.setdiff1d(np.arange(len(line.frames)), ids)
        lonely += [(side, _relative(line.frames[i], out), _seconds(line.times_s[i])) for i in without.tolist()]
    write_whole(out / UNPAIRED, csv_bytes(("side", "frame", "timestamp_s"), lonely), advice="")
    write_whole(manifest, csv_bytes(("pair_id", *SIDES, "timestamp_s"), rows), advice="")
    return len(lonely)


def _seconds(time_s: float) -> str:
    return "" if np.isnan(time_s) else f"{time_s:.6f}"


def _relative(frame: Path, folder: Path) -> str:
    """Address of a frame, relative to a folder."""
    return os.path.relpath(frame.absolute(), folder.absolute())


def _span(line: Timeline) -> str:
    return f"{line.times_s[0]:.3f} to {line.times_s[-1]:.3f}"
