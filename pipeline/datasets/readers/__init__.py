"""Which suffix is which format. One file per format, each with one `read`; a new format is a file and a row here."""

from __future__ import annotations

import importlib
from pathlib import Path
from typing import NamedTuple

from ....schemas.errors import ScanError
from .scan import Scan, with_label_file

_KITTI = ("x", "y", "z", "intensity")
_NUSCENES = (*_KITTI, "ring")


class Format(NamedTuple):
    """How files of one suffix are read.

    module : the file of this folder whose `read(path) -> Scan` reads them; it is imported when first used
    columns : for raw rows, whose files do not name their columns, the usual ones; `read(path, columns)` then takes
        these, or those of the setting `input.columns`; () where the shape tells them
    """

    module: str
    columns: tuple[str, ...] | None = None


#: A longer suffix is tried before a shorter one that it ends with.
FORMATS = {
    ".pcd.bin": Format("float32", _NUSCENES),
    ".bin": Format("float32", _KITTI),
    ".npy": Format("npy", ()),
    ".pcd": Format("pcd"),
    ".ply": Format("ply"),
    ".csv": Format("csv"),
    ".parquet": Format("parquet"),
}


def suffix_of(path: Path) -> str | None:
    """The known suffix of a file name in lower case, or None."""
    name = path.name.lower()
    return next((suffix for suffix in sorted(FORMATS, key=len, reverse=True) if name.endswith(suffix)), None)


def stem_of(path: Path) -> str:
    """The file name less its known suffix: the name of the pair."""
    return path.name[: -len(suffix_of(path) or "") or None]


def read_scan(path: Path, columns: tuple[str, ...] | None = None, label_names: dict[int, str] | None = None) -> Scan:
    """The points of a scan file, with intensity and labels where it has them.

    Points that are not finite or zero are kept: cleaning drops and counts them.

    Parameters
    ----------
    path : the file; its suffix tells the format
    columns : names of the columns of a raw file (.bin, .pcd.bin), if not the usual ones; ignored for other formats
    label_names : class names for the numbers of a .label file

    Raises
    ------
    ScanError
        The file is missing, empty, truncated or not what its suffix says.
    """
    suffix = suffix_of(path)
    if suffix is None:
        raise ScanError(f"{path}: unknown format; known are {', '.join(FORMATS)}")
    module, usual_columns = FORMATS[suffix]
    try:
        if path.stat().st_size == 0:
            raise ScanError(f"{path}: the file is empty, points are wanted")
        reader = importlib.import_module(f".{module}", __name__)
        scan: Scan = reader.read(path) if usual_columns is None else reader.read(path, columns or usual_columns)
    except OSError as error:
        raise ScanError(f"{path}: cannot be read ({error.strerror or error})") from error
    if not len(scan.points):
        raise ScanError(f"{path}: no points in the file, at least one is wanted")
    return with_label_file(scan, path, stem_of(path), label_names or {})
