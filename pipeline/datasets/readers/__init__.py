"""One file a format, each with one `read(path) -> Scan`. A new format is a file here and a row in `FORMATS`."""

from __future__ import annotations

import importlib
from pathlib import Path

from ....schemas.errors import ScanError
from .scan import Scan, with_label_file

#: Suffix to the module that reads it. A longer suffix is tried before a shorter one that it ends with.
FORMATS = {
    ".pcd.bin": "float32",
    ".bin": "float32",
    ".npy": "npy",
    ".pcd": "pcd",
    ".ply": "ply",
    ".csv": "csv",
    ".parquet": "parquet",
}


def suffix_of(path: Path) -> str | None:
    """The known suffix of a file name, or None."""
    name = path.name.lower()
    return next((suffix for suffix in sorted(FORMATS, key=len, reverse=True) if name.endswith(suffix)), None)


def stem_of(path: Path) -> str:
    """The file name less its known suffix: the name of the pair."""
    return path.name[: -len(suffix_of(path) or "") or None]


def read_scan(path: Path, columns: tuple[str, ...] | None = None, label_names: dict[int, str] | None = None) -> Scan:
    """The points of a scan file, with intensity and labels where it has them.

    Parameters
    ----------
    path : the file; its suffix tells the format
    columns : names of the float32 columns of a .bin file, if not the usual ones
    label_names : class names for the numbers of a .label file

    Raises
    ------
    ScanError
        The file is missing, empty, truncated or not what its suffix says.
    """
    suffix = suffix_of(path)
    if suffix is None:
        raise ScanError(f"{path}: unknown format; known are {', '.join(FORMATS)}")
    try:
        if path.stat().st_size == 0:
            raise ScanError(f"{path}: the file is empty, points are wanted")
        reader = importlib.import_module(f".{FORMATS[suffix]}", __name__)
        scan: Scan = reader.read(path, columns) if FORMATS[suffix] == "float32" else reader.read(path)
    except OSError as error:
        raise ScanError(f"{path}: cannot be read ({error.strerror or error})") from error
    if not len(scan.points):
        raise ScanError(f"{path}: no points in the file, at least one is wanted")
    return with_label_file(scan, path, stem_of(path), label_names or {})
