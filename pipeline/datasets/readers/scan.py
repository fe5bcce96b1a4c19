"""The result of every reader, built from named columns and a label file."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ....schemas.data_files import read_data
from ....schemas.errors import ScanError
from ....stages.arrays import FloatArray, IntArray, slopes_deg
from .scan_ref import ScanRef

# Names of each column in lower case, ours first. Names of others: CARLA's I, ObjTag, ObjIdx; Ouster's t;
# Hesai's timestamp; Livox' offset_time, line and Reflectivity; openpylivox' Inten-sity; Autoware's channel and
# time_stamp; Argoverse's laser_number and offset_ns; VeloView's Points_m_XYZ:0 and laser_id.
_NAMES = {
    "x": ("x", "points_m_xyz:0", "points:0"),
    "y": ("y", "points_m_xyz:1", "points:1"),
    "z": ("z", "points_m_xyz:2", "points:2"),
    "intensity": ("intensity", "scalar_intensity", "i", "inten-sity", "reflectivity"),
    "label": ("label", "scalar_label", "objtag"),
    "instance": ("instance", "scalar_instance", "objidx"),
    "ring": ("ring", "scalar_ring", "channel", "laser_number", "laser_id", "line"),
    "time": (
        "time",
        "scalar_time",
        "t",
        "timestamp",
        "time_stamp",
        "offset_time",
        "offset_ns",
        "gps_time",
    ),
}
_ARGOVERSE_BEAMS = 32  # of each of its two sensors
_MAX_RING_SPREAD_DEG = 1.0
_NO_NUMBERS = "bcV"  # kinds of NumPy's types: truth values, complex numbers, records
#: Names of columns that are read, in lower case.
KNOWN_COLUMNS = frozenset(chain(*_NAMES.values()))
LONGEST_LABEL = 200  #: characters
_LONGEST_CAUSE = 300

#: Names of classes by number, by format.
CLASSES = {}
for _format, _labels in read_data("class_names").items():
    CLASSES[_format] = {int(number): label for number, label in _labels.items()}


@dataclass(frozen=True)
class Scan:
    """One scan as stored in its file.

    points : (n, 3) float64, metres, the scan's own frame
    intensity : (n,) float64, or None
    labels : (n,) str, or None
    instances : (n,) int32, number of the thing that a point belongs to, 0 for none; or None
    rings : (n,) int32, number of the beam, or None; -1 where it is NaN
    times_s : (n,) float64, seconds, from where the file counts them; or None
    label_names : what the format calls the labels that are numbers; {} where it names none
    notes : properties of the sensor or the export that the columns show, one line each
    """

    points: FloatArray
    intensity: FloatArray | None = None
    labels: NDArray[np.str_] | None = None
    instances: IntArray | None = None
    rings: IntArray | None = None
    times_s: FloatArray | None = None
    label_names: Mapping[int, str] = field(default_factory=dict)
    notes: tuple[str, ...] = ()


def scan_from_columns(
    path: Path,
    columns: Mapping[str, NDArray[Any]],
    label_names: Mapping[int, str] | None = None,
) -> Scan:
    """A scan from named columns: the last step of every reader.

    Parameters
    ----------
    path : the file, for errors
    columns : by name, upper or lower case: (n,) numbers for x, y, z in metres and intensity; label
        as text or numbers; instance and ring as whole numbers; time in seconds, or in nanoseconds
        where it is of an integer type (VeloView: microseconds)
    label_names : what the format calls numbers of classes; of a column ObjTag, CARLA's tags

    Raises
    ------
    ScanError
        x, y or z is missing, or a value is not a number (named by row and column). NaN and infinity
        are kept in coordinates and intensity.
    """
    check_names(path, columns)
    in_lower_case = {name.lower(): np.asarray(column) for name, column in columns.items()}
    source = {}
    for name, aliases in _NAMES.items():
        known = [alias for alias in aliases if alias in in_lower_case]
        if known:
            source[name] = known[0]
    by_name = {name: in_lower_case[alias] for name, alias in source.items()}
    numbers: dict[str, FloatArray] = {}
    for name, column in by_name.items():
        is_label = name == "label"
        if column.ndim != 1 or (not is_label and column.dtype.kind in _NO_NUMBERS):
            kind = f"{column.dtype} values of shape {column.shape}"
            raise ScanError(
                f"{path}: column {name}: expected one real number per row, got {kind}"
            )
        if not is_label:
            numbers[name] = _numbers(path, name, column)
    lengths = {len(column) for column in by_name.values()}
    if len(lengths) > 1:
        raise ScanError(
            f"{path}: expected columns of equal length, got lengths {sorted(lengths)}"
        )

    points = np.column_stack([numbers[axis] for axis in "xyz"])
    rings = _ring_numbers(numbers.get("ring"))
    if rings is not None and source["ring"] == "line" and not _are_rings(points, rings):
        rings = None
    times_s = numbers.get("time")
    if times_s is not None and by_name["time"].dtype.kind in "iu":
        times_s = times_s * (1e-6 if "laser_id" in in_lower_case else 1e-9)
    if not label_names and source.get("label") == "objtag":
        label_names = CLASSES["carla"]
    return Scan(
        points=points,
        intensity=numbers.get("intensity"),
        labels=_label_text(path, by_name["label"]) if "label" in by_name else None,
        instances=_instance_numbers(numbers.get("instance")),
        rings=rings,
        times_s=times_s,
        label_names=label_names or {},
        notes=_notes(source.get("ring"), rings),
    )


def packed_columns(
    fields: Iterable[tuple[str, str, int]],
    content: bytes,
    shape: tuple[int, ...],
    strides: tuple[int, ...],
) -> dict[str, NDArray[Any]]:
    """The numbers of points in memory by name, row by row.

    Parameters
    ----------
    fields : name, NumPy's type and offset of each number; those without a name are left out
    shape, strides : of the points, in bytes
    """
    columns = {}
    for name, dtype, offset in fields:
        if name:
            columns[name] = np.ndarray(shape, dtype, content, offset, strides).ravel()
    return columns


def check_names(path: Path, names: Iterable[str], remedy: str = "") -> None:
    """Raise `ScanError` if x, y or z, in upper or lower case, is not among the names of a file's columns."""
    known = list(names)
    in_lower_case = {name.lower() for name in known}
    missing = [axis for axis in "xyz" if in_lower_case.isdisjoint(_NAMES[axis])]
    if missing:
        found = cause_of(", ".join(known)) if known else "none"
        raise ScanError(f"{path}: missing columns {', '.join(missing)}; got {found}{remedy}")


def cause_of(error: object) -> str:
    """Message of a library's error in one line; its type if it has no message."""
    text = " ".join(str(error).split()) or type(error).__name__
    return text if len(text) <= _LONGEST_CAUSE else f"{text[:_LONGEST_CAUSE]} ..."


def with_label_file(scan: Scan, ref: ScanRef) -> Scan:
    """The scan with the labels of the `.label` file next to it, if any: class and instance, 0 for none.

    Raises
    ------
    ScanError
        The numbers of labels and points differ.
    """
    path = ref.labels
    if not path.exists():
        return scan
    classes, instances = read_label_file(path, len(scan.points))
    if scan.instances is not None and not instances.any():
        instances = scan.instances
    return replace(scan, labels=_label_text(path, classes), instances=instances, label_names={})


def read_label_file(path: Path, n_points: int) -> tuple[IntArray, IntArray]:
    """Class and instance of each point, (n,) int32: low and high 16 bits of uint32, as in SemanticKITTI.

    Raises
    ------
    ScanError
        The numbers of labels and points differ.
    """
    n_bytes = path.stat().st_size
    if n_bytes != 4 * n_points:
        raise ScanError(
            f"{path}: expected {4 * n_points} bytes (one uint32 for each of the {n_points} points "
            f"of the scan file), got {n_bytes}"
        )
    numbers = np.fromfile(path, dtype="<u4")
    return (numbers & 0xFFFF).astype(np.int32), (numbers >> 16).astype(np.int32)


def with_label_names(scan: Scan, names: Mapping[int, str]) -> Scan:
    """The scan with names for the labels that are numbers: these, or else those of the format, or the number itself."""
    text = {str(number): name for number, name in {**scan.label_names, **names}.items()}
    if scan.labels is None or not text:
        return scan
    classes, class_ids = np.unique(scan.labels, return_inverse=True)
    return replace(
        scan,
        labels=np.array([text.get(name, name) for name in classes.tolist()])[class_ids],
    )


def _are_rings(points: FloatArray, numbers: IntArray) -> bool:
    """True if the points of a number have one elevation; those of Livox' patterns that do not repeat have all."""
    elevation_deg = slopes_deg(points)
    is_return = np.isfinite(elevation_deg) & points.any(axis=1)
    spreads_deg = []
    for number in np.unique(numbers[is_return]):
        low, high = np.percentile(elevation_deg[is_return & (numbers == number)], [16, 84])
        spreads_deg.append((high - low) / 2)
    return bool(spreads_deg) and float(np.median(spreads_deg)) <= _MAX_RING_SPREAD_DEG


def _notes(ring_column: str | None, rings: IntArray | None) -> tuple[str, ...]:
    """Notes of a scan, see `Scan`."""
    if (
        ring_column != "laser_number"
        or rings is None
        or rings.max(initial=-1) < _ARGOVERSE_BEAMS
    ):
        return ()
    return (
        f"laser numbers up to {rings.max()}: two fused sensors of {_ARGOVERSE_BEAMS} beams "
        "(Argoverse, VLP-32C), in the vehicle's frame; for beams and rays, write numbers "
        f"below {_ARGOVERSE_BEAMS} alone, in their frame",
    )


def _numbers(path: Path, name: str, column: NDArray[Any]) -> FloatArray:
    try:
        # what float64 does not hold is infinite or NaN
        with np.errstate(over="ignore", invalid="ignore"):
            return column.astype(np.float64)
    except (TypeError, ValueError, OverflowError):
        rows = enumerate(column.tolist(), start=1)
        row, value = next((row, value) for row, value in rows if not is_number(value))
        hint = ""
        if re.fullmatch(r"[-\d ]+,\d+", str(value)):
            hint = "; is it a decimal comma? write decimal points"
        raise ScanError(
            f"{path}: row {row}, column {name}: expected a number, got "
            f"{cause_of(repr(value))}{hint}"
        ) from None


def is_number(value: Any) -> bool:
    """True for a number or the text of one."""
    try:
        float(value)
    except (TypeError, ValueError, OverflowError):
        return False
    return True


def _instance_numbers(numbers: FloatArray | None) -> IntArray | None:
    """Numbers of objects from 1; 0 for none, which files also write as a negative number or leave out."""
    if numbers is None:
        return None
    is_object = numbers > 0  # not where it is NaN
    objects, ids = np.unique(numbers[is_object], return_inverse=True)
    if not _are_whole(objects, 2**31):
        objects = np.arange(1.0, len(objects) + 1)
    instances = np.zeros(len(numbers), dtype=np.int32)
    instances[is_object] = objects[ids].astype(np.int32)
    return instances


def _ring_numbers(numbers: FloatArray | None) -> IntArray | None:
    """Numbers of beams; None if the column holds other than integers."""
    if numbers is None:
        return None
    numbers = np.nan_to_num(numbers, nan=-1.0)
    return numbers.astype(np.int32) if _are_whole(numbers, 2**31) else None


def _are_whole(numbers: FloatArray, limit: int) -> bool:
    """True if all numbers are integers whose magnitude is below a limit."""
    is_whole = numbers == np.round(numbers)
    return bool(np.all(is_whole & (np.abs(numbers) < limit)))


def _label_text(path: Path, column: NDArray[Any]) -> NDArray[np.str_]:
    """Labels as text; all take the room of the longest, so that there is a limit to that."""
    if column.dtype.kind == "O":
        longest = max((len(str(label)) for label in column.tolist()), default=0)
        if longest > LONGEST_LABEL:
            raise ScanError(
                f"{path}: expected labels of at most {LONGEST_LABEL} characters, got one of {longest}",
            )
    if column.dtype.kind == "f" and _are_whole(column, 2**53):
        column = column.astype(np.int64)
    return column.astype(np.str_)
