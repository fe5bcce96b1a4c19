"""LAS and LAZ point clouds, versions 1.0 to 1.4; read by laspy."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np

from ....schemas.errors import ScanError
from .scan import CLASSES, Scan, scan_from_columns

_N_RECORDS_AT, _RECORD_HEAD_BYTES = 100, 54  # LAS Specification 1.4 R15, tables 3 and 7


def read(path: Path) -> Scan:
    """The points of a `.las` or `.laz` file, coordinates scaled and offset in float64: nothing is rounded or moved.

    The classes are labels, unless all are 0 (never classified).

    Raises
    ------
    ScanError
        The file is not whole.
    """
    import laspy

    _check_records(path)
    n_bytes = path.stat().st_size
    backend = laspy.LazBackend.Lazrs
    with laspy.open(path, laz_backend=backend, read_evlrs=False) as file:
        header = file.header
        end = header.offset_to_point_data + header.point_count * header.point_format.size
        if not header.are_points_compressed and end > n_bytes:
            raise ScanError(
                f"{path}: the header says {header.point_count} points, in {n_bytes} bytes; the "
                "file is truncated or wrong"
            )
        rows = file.read_points(-1)
    columns = {name: np.asarray(rows[name]) for name in ("x", "y", "z", "intensity")}
    if "gps_time" in rows.point_format.dimension_names:
        columns["gps_time"] = np.asarray(rows["gps_time"])
    if np.any(classes := np.asarray(rows["classification"])):
        columns["label"] = classes
    return scan_from_columns(path, columns, CLASSES["las"])


def _check_records(path: Path) -> None:
    """Raise ScanError if the header promises more variable length records than the file has room for."""
    with path.open("rb") as file:
        file.seek(_N_RECORDS_AT)
        (n_records,) = struct.unpack("<I", file.read(4))
    if n_records * _RECORD_HEAD_BYTES > (n_bytes := path.stat().st_size):
        raise ScanError(
            f"{path}: the header says {n_records} variable length records, in {n_bytes} bytes; "
            "the file is truncated or wrong"
        )
