"""A dataset's layout: which files form a pair. Opens the manifest and the label names, no scan.

Either folders `real/` and `sim/` with files of the same stem, or a manifest `pairs.csv` with the
columns pair_id, real, sim and perhaps timestamp_s, T_real_sim and T_world_sensor (12 numbers
separated by spaces, [R | t] row by row). A scan of a manifest may be one frame of a recording,
named as in `readers/scan_ref.py`: `drive.mcap#/points@12`.
"""

from __future__ import annotations

import csv
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ...schemas.columns import FARTHEST_M, SIDES
from ...schemas.data_files import parse_toml
from ...schemas.errors import DatasetError, ScanError, nearest
from ...stages.arrays import FloatArray
from ..storage.files import path_exists
from ..storage.urls import STUB, is_stub, is_url, url_of_cache
from .readers import frames_of
from .readers.scan import LONGEST_LABEL
from .readers.scan_ref import ScanRef, scan_ref

MANIFEST = "pairs.csv"
LIST_NAMES = f"list real and simulated file names in a {MANIFEST}, see docs/formats.md"
LABEL_NAMES = "labels.toml"
_MANIFEST_COLUMNS = ("pair_id", "real", "sim", "timestamp_s", "T_real_sim", "T_world_sensor")
_ROTATION_TOLERANCE = 1e-3
#: File names shown in the error if a folder is not a dataset.
_MOST_NAMES = 5
NO_PARTNER = "no partner"


@dataclass(frozen=True)
class ScanPair:
    """One pair of scans.

    real, sim : the scans; None if the partner is missing
    timestamp_s : when the real scan was taken, if the manifest says so
    T_real_sim : 12 numbers, [R | t] row by row: maps simulated points into the real sensor's frame;
        None if they are in it already
    fault : why the pair cannot be evaluated, or None
    T_world_sensor : 12 numbers, [R | t] row by row: where the real sensor was, in the frame of the
        recording
    """

    pair_id: str
    real: ScanRef | None
    sim: ScanRef | None
    timestamp_s: float | None = None
    T_real_sim: tuple[float, ...] | None = None
    fault: str | None = None
    T_world_sensor: tuple[float, ...] | None = None

    @property
    def scans(self) -> dict[str, ScanRef]:
        """The scans that the pair has, by side."""
        return {
            side: scan for side, scan in zip(SIDES, (self.real, self.sim), strict=True) if scan
        }

    def motion(self, side: str) -> tuple[float, ...] | None:
        """The motion of a side's points into the real sensor's frame; None if they are in it."""
        return self.T_real_sim if side == "sim" else None


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
        The folder does not exist or holds no pair, the manifest or `labels.toml` is wrong, or two
        files have one stem.
    """
    if folder.is_file():
        raise DatasetError(
            f"dataset {folder}: expected a folder, such as {folder.parent}, got a file; two "
            "recordings are one: fidpipe run REAL SIM"
        )
    if not folder.is_dir():
        raise DatasetError(f"dataset {folder}: no such folder")
    manifest = folder / MANIFEST
    warnings: list[str] = []
    pairs = (
        read_manifest(manifest, warnings)
        if manifest.exists()
        else _from_folders(folder, warnings)
    )
    if not pairs:
        raise DatasetError(
            f"dataset {folder}: no scan pairs found; expected scans in real/ and sim/, or in a "
            f"{MANIFEST}, see docs/formats.md"
        )
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
    longest = max(map(len, names.values()), default=0)
    if longest > LONGEST_LABEL:  # each point takes room for the longest
        raise DatasetError(
            f"{path}: expected names of at most {LONGEST_LABEL} characters, got one of {longest}"
        )
    return names


def _from_folders(folder: Path, warnings: list[str]) -> list[ScanPair]:
    if not all((folder / side).is_dir() for side in SIDES):
        names = sorted(path.name for path in folder.iterdir())
        raise DatasetError(
            f"dataset {folder}: expected folders real/ and sim/ or a {MANIFEST}, got "
            f"{', '.join(names[:_MOST_NAMES]) or 'nothing'}; two "
            "folders of scans, or two recordings, may have any name: fidpipe run REAL SIM"
        )
    scans = {side: _scans_by_stem(folder / side, warnings) for side in SIDES}
    pairs = []
    for stem in scans["real"].keys() | scans["sim"].keys():
        fault = None
        for side, other in (SIDES, SIDES[::-1]):
            if stem not in scans[other]:
                scan = scans[side][stem]
                fault = (
                    f"{scan}: {NO_PARTNER}; expected a scan named {stem} in {folder / other}"
                )
        pairs.append(
            ScanPair(stem, scans["real"].get(stem), scans["sim"].get(stem), fault=fault)
        )
    return pairs


def may_crash(pairs: Iterable[ScanPair]) -> bool:
    """True if reading a scan of some pairs may end the process; see `Format`."""
    return any(scan.format.may_crash for pair in pairs for scan in pair.scans.values())


def scans_of(source: Path) -> list[ScanRef]:
    """The frames of a recording, the scans of a folder, or the scan of a file."""
    scan = scan_ref(source)
    if scan.format.holds_frames:
        return frames_of(scan)
    return scans_in(source) if source.is_dir() else [scan]


def scans_in(folder: Path) -> list[ScanRef]:
    """The scan files of a folder, in the order of their names; recordings of many scans are left out."""
    scans = [scan_ref(path) for path in _files(folder) if path.name != MANIFEST]
    return [scan for scan in scans if scan.format.module and not scan.format.holds_frames]


def folders_of_scans(folder: Path) -> list[Path]:
    """The folder itself if it holds scans, else those one level down that do."""
    if scans_in(folder):
        return [folder]
    folders = [path for path in sorted(folder.iterdir()) if path.is_dir()]
    return [path for path in folders if not path.name.startswith(".") and scans_in(path)]


def _files(folder: Path) -> list[Path]:
    """Files that may be scans: no hidden files, folders, labels or settings."""
    files = []
    for path in sorted(folder.iterdir()):
        is_other = path.name.removesuffix(STUB).endswith((".label", ".toml"))
        if not (path.name.startswith(".") or is_other or path.is_dir()):
            files.append(path)
    return files


def _scans_by_stem(folder: Path, warnings: list[str]) -> dict[str, ScanRef]:
    """The scans of a folder by stem; `warnings` gets a line for each file of an unknown format."""
    scans: dict[str, ScanRef] = {}
    for path in _files(folder):
        scan = scan_ref(path)
        if not scan.format.module:
            warnings.append(f"{path}: not a known scan format, ignored")
            continue
        stem = scan.stem
        if not stem or stem.encode(errors="ignore").decode() != stem:
            raise DatasetError(f"{path}: the name is not UTF-8; rename the file")
        if stem in scans:
            raise DatasetError(
                f"{folder}: {scans[stem].file.name} and {path.name} have the same stem {stem}; keep one of them",
            )
        scans[stem] = scan
    return scans


def read_manifest(
    manifest: Path,
    warnings: list[str],
    *,
    needs_sim: bool = True,
) -> list[ScanPair]:
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
    columns, lines = read_rows(manifest)
    _check_columns(manifest, columns, warnings, needs_sim=needs_sim)
    rows = []
    for line, values in enumerate(lines, start=2):
        if None in values:  # the key of values beyond the header
            raise DatasetError(
                f"{manifest}, line {line}: expected {len(columns)} values, got more"
            )
        rows.append({name: values.get(name, "").strip() for name in _MANIFEST_COLUMNS})
    stubs = _stubs_of(manifest.parent, [row[side] for side in SIDES for row in rows])
    pairs: dict[str, ScanPair] = {}
    for line, row in enumerate(rows, start=2):
        where = f"{manifest}, line {line}"
        pair = _pair_of_row(where, manifest.parent, row, stubs)
        if pair.pair_id in pairs:
            raise DatasetError(
                f"{where}: pair_id {pair.pair_id} occurs twice; expected it once"
            )
        pairs[pair.pair_id] = pair
    return list(pairs.values())


def read_rows(manifest: Path) -> tuple[list[str], list[dict[Any, Any]]]:
    """Columns and rows of a manifest, as text.

    Raises
    ------
    DatasetError
        The file is not a CSV table.
    """
    try:
        with manifest.open(newline="", encoding="utf-8-sig") as file:
            table = csv.DictReader(file, restval="", skipinitialspace=True, strict=True)
            return list(table.fieldnames or ()), list(table)
    except (OSError, ValueError, csv.Error) as error:
        raise DatasetError(f"{manifest}: not a CSV table ({str(error).strip()})") from error


def _check_columns(
    manifest: Path, columns: list[str], warnings: list[str], *, needs_sim: bool
) -> None:
    """Raise `DatasetError` if a manifest lacks a column, repeats one, or has one that resembles a known one."""
    required = ("pair_id", *SIDES) if needs_sim else ("pair_id", "real")
    missing = [name for name in required if name not in columns]
    if missing:
        raise DatasetError(
            f"{manifest}: missing columns {', '.join(missing)}; got {', '.join(columns)}",
        )
    for name in columns:
        if columns.count(name) > 1:
            raise DatasetError(f"{manifest}: column {name} occurs twice; expected it once")
        if name not in _MANIFEST_COLUMNS:
            meant = nearest(name, _MANIFEST_COLUMNS)
            if meant is not None and meant not in columns:
                raise DatasetError(
                    f"{manifest}: column {name} is not known; did you mean {meant}?",
                )
            warnings.append(f"{manifest}: column {name} is not known, ignored")


def _pair_of_row(
    where: str,
    folder: Path,
    row: Mapping[str, str],
    stubs: Mapping[str, Path | str],
) -> ScanPair:
    if not row["pair_id"]:
        raise DatasetError(f"{where}: pair_id is empty; expected a name")
    scans: dict[str, ScanRef] = {}
    fault = None
    for side in SIDES:
        try:
            scans[side] = _named_scan(folder, row[side], side, stubs)
        except ScanError as error:
            fault = fault or f"{where}: {error}"
    return ScanPair(
        row["pair_id"],
        scans.get("real"),
        scans.get("sim"),
        timestamp_s=_number(f"{where}: timestamp_s", row["timestamp_s"]),
        T_real_sim=_transform(f"{where}: T_real_sim", row["T_real_sim"]),
        fault=fault,
        T_world_sensor=_transform(f"{where}: T_world_sensor", row["T_world_sensor"]),
    )


def local_folder(name: str) -> Path:
    """The folder of a run or a dataset; that of a URL is fetched.

    Raises
    ------
    StoreError
        The URL cannot be read.
    """
    if not is_url(name):
        return Path(name)
    from ..storage.remote_run import local_of

    return local_of(name)


def _stubs_of(folder: Path, names: list[str]) -> dict[str, Path | str]:
    """The stub of each scan of a manifest that is in an object store, or the reason why there is none."""
    base = url_of_cache(folder)
    urls = {}
    for name in filter(None, names):
        if is_url(name):
            urls[name] = name
        elif base and not (path_exists(folder / name) or path_exists(f"{folder / name}{STUB}")):
            urls[name] = f"{base}/{name}"  # of a server that cannot list its objects
    if not urls:
        return {}
    from ..storage.remote_dataset import stubs_of

    return stubs_of(urls)


def _named_scan(
    folder: Path,
    name: str,
    side: str,
    stubs: Mapping[str, Path | str],
) -> ScanRef:
    """The scan that a manifest names; `ScanError` if it does not exist."""
    if not name:
        raise ScanError(f"no {side} scan is named")
    if name in stubs:
        stub_or_reason = stubs[name]
        if isinstance(stub_or_reason, str):
            raise ScanError(stub_or_reason)
        return scan_ref(stub_or_reason)
    path = folder / name
    stub = Path(f"{path}{STUB}")
    try:
        scan = scan_ref(stub if stub.exists() and is_stub(stub) else path)
        if scan.exists:
            return scan
    except OSError as error:  # a name that no file can have
        raise ScanError(error.strerror or str(error)) from error
    raise ScanError(f"{path} is not a file; expected the {side} scan")


def _number(where: str, text: str) -> float | None:
    if not text:
        return None
    try:
        value = float(text)
    except ValueError:
        value = np.nan
    if not np.isfinite(value):
        raise DatasetError(f"{where}: expected a number, got {text!r}")
    return value


def _transform(where: str, text: str) -> tuple[float, ...] | None:
    if not text:
        return None
    numbers = np.array([_number(where, word) for word in text.split()], dtype=np.float64)
    return tuple(check_rigid(where, numbers).ravel().tolist())


def check_rigid(where: str, numbers: FloatArray) -> FloatArray:
    """The rigid motion of 12 numbers, (3, 4) float64, [R | t].

    Parameters
    ----------
    where : place and name of the numbers, for errors

    Raises
    ------
    DatasetError
        The numbers are not 12, R is not a rotation, or t is beyond a million kilometres.
    """
    if len(numbers) != 12:
        raise DatasetError(
            f"{where}: expected 12 numbers ([R | t] row by row), got {len(numbers)}",
        )
    motion = numbers.reshape(3, 4)
    rotation = motion[:, :3]
    with np.errstate(over="ignore", invalid="ignore"):  # infinite values are not a rotation
        off = float(np.abs(rotation @ rotation.T - np.eye(3)).max())
    shift_m = float(np.abs(motion[:, 3]).max())
    if not (off <= _ROTATION_TOLERANCE and shift_m <= FARTHEST_M):
        raise DatasetError(
            f"{where} is not a rigid motion: R R^T is off the identity by {off:.2g}, at most "
            f"{_ROTATION_TOLERANCE:g} is taken for rounding, or t of {shift_m:g} m is above {FARTHEST_M:g} m"
        )
    if np.linalg.det(rotation) < 0:
        hint = "expected det R = 1"
        if where.endswith("T_real_sim"):
            hint = 'set input.sim_frame = "carla" for a left-handed simulator'
        raise DatasetError(f"{where} is a mirror image; {hint}")
    return motion
