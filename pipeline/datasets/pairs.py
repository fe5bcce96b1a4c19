"""A dataset's layout: which files form a pair. Opens the manifest and the label names, no scan.

Either folders `real/` and `sim/` with files of the same stem, or a manifest `pairs.csv` with the columns pair_id,
real, sim and perhaps timestamp_s, T_real_sim and T_world_sensor (12 numbers separated by spaces, [R | t] row by row).
A scan of a manifest may be one frame of a recording, named as in `readers/frames.py`: `drive.mcap#/points@12`.
"""

from __future__ import annotations

import csv
import shlex
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ...schemas.columns import FARTHEST_M, SIDES
from ...schemas.data_files import parse_toml
from ...schemas.errors import DatasetError, ScanError, nearest
from ...stages.arrays import FloatArray
from ..storage.files import path_exists
from ..storage.urls import STUB, is_stub, is_url, url_of_cache
from .readers import formats, holds_frames, is_scan_path, stem_of, suffix_of
from .readers.scan import LONGEST_LABEL

MANIFEST = "pairs.csv"
UNPAIRED = "unpaired.csv"
LIST_NAMES = f"list real and simulated file names in a {MANIFEST}, see docs/formats.md"
LABEL_NAMES = "labels.toml"
_MANIFEST_COLUMNS = ("pair_id", "real", "sim", "timestamp_s", "T_real_sim", "T_world_sensor")
_ROTATION_TOLERANCE = 1e-3
_IGNORED = "not a known scan format, ignored"
_FORMATS = "see docs/formats.md"
NO_PARTNER = "no partner"


@dataclass(frozen=True, order=True)
class ScanPair:
    """One pair of scans.

    real, sim : the scan files, or addresses of frames in one; None if the partner is missing
    timestamp_s : when the real scan was taken, if the manifest says so
    T_real_sim : 12 numbers, [R | t] row by row: maps simulated points into the real sensor's frame; None if they are
        in it already
    fault : why the pair cannot be evaluated, or None
    T_world_sensor : 12 numbers, [R | t] row by row: where the real sensor was, in the frame of the recording
    """

    pair_id: str
    real: Path | None
    sim: Path | None
    timestamp_s: float | None = None
    T_real_sim: tuple[float, ...] | None = None
    fault: str | None = None
    T_world_sensor: tuple[float, ...] | None = None

    def path(self, side: str) -> Path | None:
        """The scan file of a side ("real" or "sim"), or None."""
        return self.real if side == "real" else self.sim

    def motion(self, side: str) -> tuple[float, ...] | None:
        """The motion of a side's points into the real sensor's frame; None if they are in it."""
        return self.T_real_sim if side == "sim" else None

    @property
    def paths(self) -> list[Path]:
        """The scan files that the pair has."""
        return [path for path in (self.real, self.sim) if path is not None]


@dataclass(frozen=True)
class Dataset:
    """A folder of scan pairs.

    pairs : sorted by pair_id, including those with an error
    label_names : class names by number, {} without a `labels.toml`
    warnings : files that were ignored, one line each
    """

    folder: Path
    pairs: tuple[ScanPair, ...]
    label_names: dict[int, str]
    warnings: tuple[str, ...] = ()


def read_dataset(folder: Path) -> Dataset:
    """The pairs of a dataset folder; a missing partner is an error of its pair alone.

    Raises
    ------
    DatasetError
        The folder does not exist or holds no pair, the manifest or `labels.toml` is wrong, or two files have one stem.
    """
    if folder.is_file():
        hint = "fidpipe pair REAL SIM makes one of two recordings"
        if folder.name == MANIFEST:
            hint = f"its folder is {folder.parent}"
        raise DatasetError(f"dataset {folder}: expected a folder, got a file; {hint}")
    if not folder.is_dir():
        raise DatasetError(f"dataset {folder}: no such folder")
    manifest = folder / MANIFEST
    warnings: list[str] = []
    pairs = read_manifest(manifest, warnings) if manifest.exists() else _from_folders(folder, warnings)
    if not pairs:
        wanted = f"expected scans in real/ and sim/, or a {MANIFEST}, {_FORMATS}"
        why = f"{MANIFEST} is empty" if manifest.exists() else wanted
        raise DatasetError(f"dataset {folder}: no scan pairs found; {why}")
    pairs.sort(key=lambda pair: pair.pair_id)
    return Dataset(folder, tuple(pairs), read_label_names(folder), tuple(warnings))


def read_label_names(folder: Path) -> dict[int, str]:
    """Class names by number from `labels.toml` in a folder; {} without one.

    Raises
    ------
    DatasetError
        Its lines are not of the form 4 = "tree".
    """
    path = folder / LABEL_NAMES
    if not path.exists():
        return {}
    try:
        lines = parse_toml(path.read_text(encoding="utf-8"))
        names = {int(number): str(name) for number, name in lines.items()}
    except (OSError, ValueError) as error:  # TOML and unicode errors are ValueErrors
        raise DatasetError(f'{path}: expected lines such as 4 = "tree" ({error})') from error
    if (longest := max(map(len, names.values()), default=0)) > LONGEST_LABEL:  # each point takes room for the longest
        raise DatasetError(f"{path}: expected names of at most {LONGEST_LABEL} characters, got one of {longest}")
    return names


def _from_folders(folder: Path, warnings: list[str]) -> list[ScanPair]:
    by_side: dict[str, dict[str, Path]] = {}
    for side in SIDES:
        if not (folder / side).is_dir():
            folders = sorted(path.name for path in folder.iterdir() if path.is_dir())
            near = next((name for name in folders if name.lower().startswith(side)), None) or nearest(side, folders)
            inner = next((path for path in sorted(folder.iterdir()) if (path / "real").is_dir()), None)
            hint = f"; did you mean {near}/? rename it {side}/" if near else f"; expected one of the two, {_FORMATS}"
            other = folder / next(name for name in SIDES if name != side)
            recordings = [path for path in sorted(folder.iterdir()) if holds_frames(path)]
            if inner:
                hint = f"; it is one level below: {inner}"
            elif recordings and not near:
                named = [*map(str, recordings)] if len(recordings) == 2 else ["REAL", "SIM"]
                words = shlex.join(["fidpipe", "pair", *named, "-o", f"{folder.resolve().name}-pairs"])
                names = ", ".join(path.name for path in recordings[:4])
                hint = f"; it holds recordings ({names}); to pair them, the real one first: {words}"
            elif any(suffix_of(path) for path in _files(folder)):
                hint = f"; it holds scans of one side: fidpipe run {shlex.quote(str(folder))} SIM"
            elif other.is_dir() and not near:
                words = shlex.join(
                    ["fidpipe", "run", *([str(other), "SIM"] if side == "sim" else ["REAL", str(other)])]
                )
                hint = f"; expected it next to {other.name}/; if its scans are elsewhere: {words}"
            elif not any(folder.iterdir()):
                hint = f"; the folder is empty: expected scans of the same names in real/ and sim/, {_FORMATS}"
            raise DatasetError(f"dataset {folder}: no folder {side}/ and no {MANIFEST} found{hint}")
        by_side[side] = _scans_by_stem(folder / side, warnings)
    unread = {side: {path.stem: path for path in _files(folder / side) if suffix_of(path) is None} for side in SIDES}
    orphans = {side: by_side[side].keys() - by_side[other].keys() for side, other in (SIDES, SIDES[::-1])}
    pairs = []
    for stem in by_side["real"].keys() | by_side["sim"].keys():
        real, sim = by_side["real"].get(stem), by_side["sim"].get(stem)
        absent = "sim" if real else "real"
        fault = f"{real or sim}: {NO_PARTNER}; expected a scan named {stem} in {folder / absent}"
        if stem in unread[absent]:
            fault = f"{unread[absent][stem]}: not readable; known formats are {', '.join(formats())}"
            if not (real and sim):
                warnings.remove(f"{unread[absent][stem]}: {_IGNORED}")  # the error says it
        pairs.append(ScanPair(stem, real, sim, fault=None if real and sim else fault))
    n_real, n_sim = len(orphans["real"]), len(orphans["sim"])
    if n_real + n_sim > 1:
        warnings.append(
            f"{folder}: {n_real} real and {n_sim} simulated scans have no partner of the same name, such as "
            f"{min(orphans['real'] or orphans['sim'])}; rename them, or {LIST_NAMES}"
        )
    return pairs


def _files(folder: Path) -> list[Path]:
    """Files that may be scans: no hidden files, folders, labels or settings."""
    return [
        path
        for path in sorted(folder.iterdir())
        if not path.name.startswith(".")
        and not path.is_dir()
        and not path.name.removesuffix(STUB).endswith((".label", ".toml"))
    ]


def _scans_by_stem(folder: Path, warnings: list[str]) -> dict[str, Path]:
    scans: dict[str, Path] = {}
    for path in _files(folder):
        if suffix_of(path) is None:
            warnings.append(f"{path}: {_IGNORED}")
            continue
        stem = stem_of(path)
        if not stem or any("\ud800" <= sign <= "\udfff" for sign in stem):  # lone surrogates: bytes that are not UTF-8
            raise DatasetError(f"{path}: the name is not UTF-8; rename the file")
        if stem in scans:
            raise DatasetError(
                f"{folder}: {scans[stem].name} and {path.name} have the same stem {stem}; keep one of them"
            )
        scans[stem] = path
    return scans


def read_manifest(manifest: Path, warnings: list[str], *, needs_sim: bool = True) -> list[ScanPair]:
    """The pairs of a manifest, in its order.

    Parameters
    ----------
    warnings : gets a line for each column that is not known
    needs_sim : require the column sim; without it pairs have no simulated scan

    Raises
    ------
    DatasetError
        The file is not a CSV table, lacks a column, repeats a pair, or a value is not a number.
    """
    try:
        with manifest.open(newline="", encoding="utf-8-sig") as file:
            table = csv.DictReader(file, restval="", skipinitialspace=True, strict=True)
            rows, columns = list(table), [*(table.fieldnames or ())]
    except (OSError, ValueError, csv.Error) as error:
        raise DatasetError(f"{manifest}: not a CSV table ({str(error).strip()})") from error
    wanted = ("pair_id", "real", "sim") if needs_sim else ("pair_id", "real")
    if missing := [name for name in wanted if name not in columns]:
        raise DatasetError(f"{manifest}: missing columns {', '.join(missing)}; got {', '.join(columns)}")
    for name in columns:
        if columns.count(name) > 1:
            raise DatasetError(f"{manifest}: column {name} occurs {columns.count(name)} times; expected it once")
        if name not in _MANIFEST_COLUMNS:
            meant = nearest(name, _MANIFEST_COLUMNS)
            if meant is not None and meant not in columns:
                raise DatasetError(f"{manifest}: column {name} is not known; did you mean {meant}?")
            warnings.append(f"{manifest}: column {name} is not known, ignored")
    pairs = []
    seen: dict[str, int] = {}
    stubs = _stubs_of(manifest.parent, [row.get(side, "").strip() for row in rows for side in SIDES])
    for line, row in enumerate(rows, start=2):
        where = f"{manifest}, line {line}"
        if None in row:
            raise DatasetError(f"{where}: expected {len(columns)} values, got {len(columns) + len(row[None])}")
        pair_id = row["pair_id"].strip()
        if not pair_id:
            raise DatasetError(f"{where}: pair_id is empty; expected a name")
        if pair_id in seen:
            raise DatasetError(f"{where}: pair_id {pair_id} is already in line {seen[pair_id]}; expected unique names")
        seen[pair_id] = line
        (real, no_real), (sim, no_sim) = (
            _named_scan(where, manifest.parent, row.get(side, "").strip(), side, stubs) for side in SIDES
        )
        time_s = _number(where, "timestamp_s", row.get("timestamp_s", ""))
        T_real_sim, T_world_sensor = (_transform(where, name, row.get(name, "")) for name in _MANIFEST_COLUMNS[-2:])
        pairs.append(ScanPair(pair_id, real, sim, time_s, T_real_sim, no_real or no_sim, T_world_sensor))
    return pairs


def local_folder(name: str) -> Path:
    """The folder of a run or a dataset; that of a URL is fetched.

    Raises
    ------
    DatasetError
        The URL cannot be read.
    """
    if not is_url(name):
        return Path(name)
    from ..storage.remote_run import local_of

    return local_of(name)


def _stubs_of(folder: Path, names: list[str]) -> dict[str, Path | str]:
    """The stub of each scan of a manifest that is in an object store, or the reason why there is none."""
    base, urls = url_of_cache(folder), {}
    for name in filter(None, names):
        if is_url(name):
            urls[name] = name
        elif base and not any(path_exists(f"{folder / name}{ending}") for ending in ("", STUB)):
            urls[name] = f"{base}/{name}"  # of a server that cannot list its objects
    if not urls:
        return {}
    from ..storage.remote_dataset import stubs_of

    return stubs_of(urls)


def _named_scan(
    where: str, folder: Path, name: str, side: str, stubs: Mapping[str, Path | str]
) -> tuple[Path | None, str | None]:
    """The scan file that a line of the manifest names, or the reason why it is missing."""
    path = folder / name
    if not name:
        return None, f"{where}: no {side} scan is named"
    if name in stubs:
        found = stubs[name]
        return (found, None) if isinstance(found, Path) else (None, f"{where}: {found}")
    try:
        stub = Path(f"{path}{STUB}")
        path = stub if is_stub(stub) and stub.exists() else path
        is_there = is_scan_path(path)
    except (OSError, ScanError) as error:  # a name that no file can have, or that names no frame
        return None, f"{where}: {error.strerror or error if isinstance(error, OSError) else error}"
    return (path, None) if is_there else (None, f"{where}: {path} is not a file; expected the {side} scan")


def _number(where: str, name: str, text: str) -> float | None:
    if not text.strip():
        return None
    try:
        value = float(text)
    except ValueError:
        value = np.nan
    if not np.isfinite(value):
        raise DatasetError(f"{where}: {name}: expected a number, got {text!r}")
    return value


def _transform(where: str, name: str, text: str) -> tuple[float, ...] | None:
    words = text.split()
    if not words:
        return None
    numbers = np.array([_number(where, name, word) for word in words], dtype=np.float64)
    return tuple(check_rigid(where, name, numbers).ravel().tolist())


def check_rigid(where: str, name: str, numbers: FloatArray) -> FloatArray:
    """The rigid motion of 12 numbers, (3, 4) float64, [R | t].

    Parameters
    ----------
    where, name : of the motion, for errors

    Raises
    ------
    DatasetError
        The numbers are not 12, R is not a rotation, or t is beyond a million kilometres.
    """
    if len(numbers) != 12:
        raise DatasetError(f"{where}: {name}: expected 12 numbers ([R | t] row by row), got {len(numbers)}")
    motion = numbers.reshape(3, 4)
    rotation = motion[:, :3]
    with np.errstate(over="ignore", invalid="ignore"):  # infinite values are not a rotation
        off = float(np.abs(rotation @ rotation.T - np.eye(3)).max())
    if not (off <= _ROTATION_TOLERANCE and np.isfinite(motion).all()):
        raise DatasetError(
            f"{where}: {name} is not a rigid motion (R R^T is off the identity by {off:.2g}, "
            f"at most {_ROTATION_TOLERANCE:g} is taken for rounding)"
        )
    if (shift_m := float(np.abs(motion[:, 3]).max())) > FARTHEST_M:
        raise DatasetError(f"{where}: {name}: expected a translation of at most {FARTHEST_M:g} m, got {shift_m:g} m")
    if np.linalg.det(rotation) < 0:
        hint = (
            'set input.sim_frame = "carla" for a left-handed simulator'
            if name == "T_real_sim"
            else "expected det R = 1"
        )
        raise DatasetError(f"{where}: {name} is a mirror image; {hint}")
    return motion
