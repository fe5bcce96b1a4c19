"""LAS and LAZ point clouds, versions 1.0 to 1.4; read by laspy."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

import numpy as np

from ....schemas.errors import ScanError
from ...storage.bounds import BoundedFile, check_promise, check_unpacked
from .scan import Scan, refused_unless, scan_from_columns

_N_RECORDS_AT, _RECORD_HEAD_BYTES = 100, 54  # LAS Specification 1.4 R15, tables 3 and 7
#: In LASzip's own record (laszip.hpp): kind of compressor, points in a chunk, items; and the layers of an item.
_PACKING, _ITEMS_AT = (("<H", 0), ("<I", 12)), 34
_LAYERED, _VARIABLE, _N_LAYERS = 3, 2**32 - 1, {10: 9, 11: 1, 12: 2, 13: 1}

#: ASPRS, LAS Specification 1.4 R15, tables 9 and 17.
_CLASSES = {
    **{1: "unclassified", 2: "ground", 3: "low vegetation", 4: "medium vegetation", 5: "high vegetation"},
    **{6: "building", 7: "low noise", 9: "water", 10: "rail", 11: "road surface", 13: "wire guard"},
    **{14: "wire conductor", 15: "transmission tower", 16: "wire connector", 17: "bridge deck", 18: "high noise"},
    **{19: "overhead structure", 20: "ignored ground", 21: "snow", 22: "temporal exclusion"},
}


def read(path: Path) -> Scan:
    """The points of a `.las` or `.laz` file, coordinates scaled and offset in float64: nothing is rounded or moved.

    The classes are labels, unless all are 0 (never classified).

    Raises
    ------
    ScanError
        The file is not whole.
    """
    import laspy

    with refused_unless(path, "a whole LAS file"):
        _check_records(path)
        backend = laspy.LazBackend.Lazrs
        with laspy.open(BoundedFile(path), laz_backend=backend, read_evlrs=False) as file:
            header = file.header
            if header.are_points_compressed:
                check_unpacked(path, header.point_count * header.point_format.size)
                _check_chunks(path, header)
            else:
                check_promise(path, header.point_count, header.point_format.size)
            rows = file.read_points(-1)
        n_points = len(rows)
        columns = {name: np.asarray(rows[name]) for name in ("x", "y", "z", "intensity")}
        if "gps_time" in rows.point_format.dimension_names:
            columns["gps_time"] = np.asarray(rows["gps_time"])
        if np.any(classes := np.asarray(rows["classification"])):
            columns["label"] = classes
    if n_points != header.point_count:
        raise ScanError(f"{path}: {n_points} points found, the header says {header.point_count}; it is truncated")
    return scan_from_columns(path, columns, _CLASSES)


def _check_records(path: Path) -> None:
    """Refuses a header with more variable length records than the file has room for: laspy reads as many as it says."""
    with path.open("rb") as file:
        file.seek(_N_RECORDS_AT)
        (n_records,) = struct.unpack("<I", file.read(4))
    if n_records * _RECORD_HEAD_BYTES > (n_bytes := path.stat().st_size):
        raise ScanError(
            f"{path}: the header says {n_records} variable length records, in {n_bytes} bytes; the file is truncated "
            "or wrong"
        )


def _check_chunks(path: Path, header: Any) -> None:
    """Refuses points that are packed otherwise than the header says, and chunks or layers longer than the file.

    lazrs takes memory for them as the file says, and where it gets none it ends the process.
    """
    n_bytes, point_bytes = path.stat().st_size, header.point_format.size
    (packing,) = header.vlrs.get("LasZipVlr")
    (kind,), (chunk_points,) = (struct.unpack_from(form, packing.record_data, at) for form, at in _PACKING)
    (n_items,) = struct.unpack_from("<H", packing.record_data, _ITEMS_AT - 2)
    items = [item[:2] for item in struct.iter_unpack("<HHH", packing.record_data[_ITEMS_AT:][: 6 * n_items])]
    if (item_bytes := sum(size for _, size in items)) != point_bytes:
        raise ScanError(f"{path}: points of {point_bytes} bytes are packed as of {item_bytes}; the file is damaged")
    with path.open("rb") as file:
        file.seek(header.offset_to_point_data)
        (table,) = struct.unpack("<q", file.read(8))
        if table == -1:
            file.seek(-8, 2)
            (table,) = struct.unpack("<q", file.read(8))
        file.seek(table)
        _, n_chunks = struct.unpack("<II", file.read(8))
        start = header.offset_to_point_data + 8
        is_variable = chunk_points == _VARIABLE
        n_read = n_chunks if is_variable else -(-header.point_count // max(chunk_points, 1))
        if max(n_chunks, n_read) > n_bytes:
            raise ScanError(f"{path}: {max(n_chunks, n_read)} chunks found, in {n_bytes} bytes; the file is damaged")
        if kind != _LAYERED:
            return
        n_layers = sum(_N_LAYERS.get(item, size) for item, size in items)
        for _ in range(n_read):
            file.seek(start + point_bytes + 4)
            sizes = np.frombuffer(file.read(4 * n_layers), "<u4")
            start = file.tell() + int(sizes.sum(dtype=np.uint64))
            if start > n_bytes:
                raise ScanError(f"{path}: a chunk that ends at byte {start} found, in {n_bytes}; the file is damaged")
