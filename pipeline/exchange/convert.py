"""A scan as a file of another format: Parquet, PLY or PCD, with all that was read of its points, exactly."""

from __future__ import annotations

import io
import re
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...schemas.errors import DatasetError
from ..datasets.pairs import LABEL_NAMES, read_label_names
from ..datasets.readers import frames_of, holds_frames, read_scan, stem_of
from ..datasets.readers.frame_address import address_of
from ..datasets.readers.scan import Scan
from ..storage.files import write_whole

Columns = dict[str, NDArray[Any]]
_PLY_NAMES = {"f4": "float", "f8": "double", "i4": "int", "u1": "uchar"}


def convert(
    source: Path, out: Path, to: str = "parquet", columns: tuple[str, ...] | None = None, *, replace: bool = False
) -> list[Path]:
    """Write a scan into a file, or each frame of a recording into a folder; return the files.

    Numbers keep their value to the last bit: in PLY and PCD a coordinate is a float where that holds all of it, else a
    double. Labels that are words are numbers there, which `labels.toml` next to the file names.

    Parameters
    ----------
    source : a scan, a frame, or a recording of which no frame is named
    out : a file, whose suffix determines the format; or, without a suffix, a folder
    to : format of the files in a folder
    columns : names of the columns of a raw file, if not the usual ones

    Raises
    ------
    FidpipeError
        The scan cannot be read, the format is not written, a file already exists and `replace` is False, or other
        names are in `labels.toml`.
    """
    suffix = f".{(out.suffix or to).lower().lstrip('.')}"
    if suffix not in _WRITERS:
        raise DatasetError(f"cannot write {suffix} files; expected one of {', '.join(_WRITERS)}")
    is_recording = holds_frames(source) and address_of(source).frame is None
    sources = frames_of(source) if is_recording else [source]
    if out.suffix and len(sources) > 1:
        raise DatasetError(f"{source}: {len(sources)} frames found, {out} is one file; name a frame, or a folder")
    files = [out] if out.suffix else [out / f"{stem_of(frame)}{suffix}" for frame in sources]
    if not replace and (present := [file for file in files if file.exists()]):
        raise DatasetError(f"{present[0]}: already exists; use --replace to overwrite it")
    folder = address_of(source).file.resolve().parent
    names = read_label_names(folder) or read_label_names(folder.parent)
    for frame, file in zip(sources, files, strict=True):
        if file.resolve() == address_of(frame).file.resolve():
            raise DatasetError(f"{file}: is the scan being read; choose another name")
        write, holds_words = _WRITERS[suffix]
        written, named = _columns(read_scan(frame, columns, names), names, holds_words)
        if named:
            _name_labels(file.parent, named)
        write_whole(file, write(written), advice="")
    return files


def _columns(scan: Scan, names: dict[int, str], holds_words: bool) -> tuple[Columns, dict[int, str]]:
    """Known columns of the points, by the names that `scan_from_columns` reads; and names of label numbers."""
    columns: Columns = {name: _narrow(scan.points[:, axis]) for axis, name in enumerate("xyz")}
    numbers = {"intensity": scan.intensity, "time": scan.times_s, "incidence": scan.incidence}
    columns |= {name: _narrow(column) for name, column in numbers.items() if column is not None}
    wholes = {"ring": scan.rings, "instance": scan.instances}
    columns |= {name: column for name, column in wholes.items() if column is not None}
    if scan.labels is None:
        return columns, {}
    if holds_words:
        return columns | {"label": scan.labels}, {}
    classes, class_ids = np.unique(scan.labels, return_inverse=True)
    known = {name: number for number, name in {**scan.label_names, **names}.items()}
    numbered = {name: int(name) for name in classes.tolist() if re.fullmatch(r"\d{1,9}", name)}
    numbered |= {name: known[name] for name in classes.tolist() if name in known}
    free = iter(sorted(set(range(1, len(classes) + len(numbered) + 1)) - set(numbered.values())))
    of_class = [numbered[name] if name in numbered else next(free) for name in classes.tolist()]
    named = {number: name for number, name in zip(of_class, classes.tolist(), strict=True) if str(number) != name}
    return columns | {"label": np.array(of_class, dtype=np.int32)[class_ids]}, named


def _narrow(column: NDArray[np.float64]) -> NDArray[Any]:
    """The column as float32 where that changes no value, else as it is."""
    with np.errstate(over="ignore"):
        narrow = column.astype(np.float32)
    return narrow if np.array_equal(narrow, column, equal_nan=True) else column


def _name_labels(folder: Path, names: dict[int, str]) -> None:
    known, path = read_label_names(folder), folder / LABEL_NAMES
    for number, name in names.items():
        if known.setdefault(number, name) != name:
            raise DatasetError(
                f"{path}: {number} is {known[number]!r}, the scan has {name!r}; name another folder, or "
                "write .parquet, which holds words"
            )
    import tomli_w

    ordered = {str(number): known[number] for number in sorted(known)}
    write_whole(path, tomli_w.dumps(ordered).encode(), advice="")


def _parquet(columns: Columns) -> bytes:
    import pyarrow as pa
    import pyarrow.parquet as pq

    content = io.BytesIO()
    pq.write_table(pa.table(columns), content)
    return content.getvalue()


def ply_content(rows: NDArray[Any], comments: Iterable[str] = ()) -> bytes:
    """A PLY file with a vertex per row of a structured array; by our own hand, since trimesh rounds to float32."""
    properties = [f"property {_PLY_NAMES[rows[name].dtype.str[1:]]} {name}" for name in rows.dtype.names or ()]
    head = ["ply", "format binary_little_endian 1.0", *(f"comment {text}" for text in comments)]
    return "\n".join([*head, f"element vertex {len(rows)}", *properties, "end_header\n"]).encode() + rows.tobytes()


def _ply(columns: Columns) -> bytes:
    layout = [(name, column.dtype.newbyteorder("<")) for name, column in columns.items()]
    return ply_content(np.rec.fromarrays([*columns.values()], dtype=layout))


def _pcd(columns: Columns) -> bytes:
    from pypcd4 import Encoding, PointCloud

    content = io.BytesIO()
    types = [column.dtype.type for column in columns.values()]
    PointCloud.from_points(list(columns.values()), list(columns), types).save(content, Encoding.BINARY)
    return content.getvalue()


#: By suffix: what gives the content of a file, and whether it holds words.
_WRITERS: dict[str, tuple[Callable[[Columns], bytes], bool]] = {
    ".parquet": (_parquet, True),
    ".ply": (_ply, False),
    ".pcd": (_pcd, False),
}
