"""What every reader returns, and how it is made from named columns and a label file."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ....schemas.errors import ScanError
from ....stages.arrays import FloatArray, IntArray

_INTENSITY = ("intensity", "scalar_intensity")
_LABEL = ("label", "scalar_label", "objtag")  # the last is CARLA's
_INSTANCE = ("instance", "scalar_instance", "objidx")  # the last is CARLA's
_RING = ("ring", "scalar_ring", "channel")
_TIME = ("time", "scalar_time", "t", "timestamp", "time_stamp", "offset_time", "gps_time")


@dataclass(frozen=True)
class Scan:
    """One scan as it lies in its file.

    points : (n, 3) float64, metres, the scan's own frame
    intensity : (n,) float64, or None
    labels : (n,) str, or None
    instances : (n,) int32, number of the thing that a point belongs to, 0 for none; or None
    rings : (n,) int32, number of the beam, or None; -1 where it is NaN
    times_s : (n,) float64, seconds, from where the file counts them; or None
    """

    points: FloatArray
    intensity: FloatArray | None = None
    labels: NDArray[np.str_] | None = None
    instances: IntArray | None = None
    rings: IntArray | None = None
    times_s: FloatArray | None = None


def scan_from_columns(path: Path, columns: Mapping[str, NDArray[Any]]) -> Scan:
    """A scan from named columns; what readers end with.

    Parameters
    ----------
    path : the file, for errors
    columns : by name, upper or lower case: (n,) numbers for x, y, z in metres and intensity; label as text or numbers;
        instance and ring as whole numbers; time in seconds, or in nanoseconds where it is of an integer type

    Raises
    ------
    ScanError
        x, y or z is missing, or a value is no number (named by row and column). NaN and infinity are let through in
        coordinates and intensity.
    """
    by_name = {name.lower(): np.asarray(column) for name, column in columns.items()}
    missing = [name for name in ("x", "y", "z") if name not in by_name]
    if missing:
        raise ScanError(f"{path}: columns {', '.join(columns)} found; {', '.join(missing)} wanted as well")
    intensity = next((by_name[name] for name in _INTENSITY if name in by_name), None)
    labels = next((by_name[name] for name in _LABEL if name in by_name), None)
    instances = next((by_name[name] for name in _INSTANCE if name in by_name), None)
    rings = next((by_name[name] for name in _RING if name in by_name), None)
    times = next((by_name[name] for name in _TIME if name in by_name), None)
    return Scan(
        points=np.column_stack([_numbers(path, name, by_name[name]) for name in ("x", "y", "z")]),
        intensity=None if intensity is None else _numbers(path, "intensity", intensity),
        labels=None if labels is None else _label_text(labels),
        instances=None if instances is None else _instance_numbers(path, instances),
        rings=None if rings is None else _ring_numbers(path, rings),
        times_s=None if times is None else _numbers(path, "time", times) * (1e-9 if times.dtype.kind in "iu" else 1.0),
    )


@contextmanager
def refused_unless(path: Path, wanted: str, *errors: type[Exception]) -> Iterator[None]:
    """Around the call of a format's library.

    Parameters
    ----------
    wanted : what the file should be: "a CSV table"
    errors : what the library raises on a broken file

    Raises
    ------
    ScanError
        In place of these errors. An `OSError` of the file itself is let through.
    """
    try:
        yield
    except OSError:
        raise
    except errors as error:
        raise ScanError(f"{path}: not {wanted} ({str(error).strip()})") from error


def with_label_file(scan: Scan, path: Path, stem: str, names: Mapping[int, str]) -> Scan:
    """The scan with the labels of the `.label` file beside it, if there is one: uint32 per point.

    The low 16 bits are the class, the high 16 bits the instance, 0 for none (SemanticKITTI).

    Parameters
    ----------
    names : of classes by number; a class without a name is called by its number

    Raises
    ------
    ScanError
        There is not one label for each point.
    """
    label_path = label_path_of(path, stem)
    if not label_path.exists():
        return scan
    n_bytes = label_path.stat().st_size
    if n_bytes != 4 * len(scan.points):
        raise ScanError(
            f"{label_path}: {n_bytes} bytes found, {4 * len(scan.points)} wanted (one uint32 for each of the "
            f"{len(scan.points)} points of {path.name})"
        )
    numbers = np.fromfile(label_path, dtype="<u4")
    upper = (numbers >> 16).astype(np.int32)
    classes, class_ids = np.unique(numbers & 0xFFFF, return_inverse=True)
    return replace(
        scan,
        labels=np.array([names.get(int(number), str(number)) for number in classes])[class_ids],
        instances=scan.instances if scan.instances is not None and not upper.any() else upper,
    )


def label_path_of(path: Path, stem: str) -> Path:
    """Where the labels of a scan file lie, if it has any; the file may be absent."""
    return path.with_name(stem + ".label")


def _numbers(path: Path, name: str, column: NDArray[Any]) -> FloatArray:
    try:
        return column.astype(np.float64)
    except (TypeError, ValueError):
        for row, value in enumerate(column.tolist()):
            try:
                float(value)
            except (TypeError, ValueError):
                raise ScanError(f"{path}: row {row + 1}, column {name}: {value!r} found, a number wanted") from None
        raise


def _instance_numbers(path: Path, column: NDArray[Any]) -> IntArray:
    """Numbers of things from 1; 0 for none, which files also write as a negative number or none at all."""
    numbers = _numbers(path, "instance", column)
    is_thing = numbers > 0  # not where it is NaN
    things, ids = np.unique(numbers[is_thing], return_inverse=True)
    if len(things) and (things[-1] >= 2**31 or np.any(things != np.round(things))):
        things = np.arange(1.0, len(things) + 1)
    instances = np.zeros(len(numbers), dtype=np.int32)
    instances[is_thing] = things[ids].astype(np.int32)
    return instances


def _ring_numbers(path: Path, column: NDArray[Any]) -> IntArray | None:
    """Numbers of beams; None where the column holds others than whole ones."""
    numbers = np.nan_to_num(_numbers(path, "ring", column), nan=-1.0)
    is_whole = bool(np.all((np.abs(numbers) < 2**31) & (numbers == np.round(numbers))))
    return numbers.astype(np.int32) if is_whole else None


def _label_text(column: NDArray[Any]) -> NDArray[np.str_]:
    if column.dtype.kind == "f" and np.array_equal(column, np.round(column)):
        column = column.astype(np.int64)
    return column.astype(np.str_)
