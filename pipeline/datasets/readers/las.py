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
#: In LASzip's own record (laszip.hpp): kind of compressor, points in a chunk, items; bytes of an item, and its layers.
_PACKING, _ITEMS_AT = (("<H", 0), ("<I", 12)), 34
_IN_ONE_PIECE, _LAYERED, _VARIABLE = 1, 3, 2**32 - 1
_ITEM_BYTES, _N_LAYERS = {6: 20, 7: 8, 8: 6, 9: 29, 10: 30, 11: 6, 12: 8, 13: 29}, {10: 9, 11: 1, 12: 2, 13: 1}
_VERSIONS_IN_LAYERS = (3, 4)

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
                _check_packing(path, header)
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


def _check_packing(path: Path, header: Any) -> None:
    """Refuses points that are packed otherwise than the header says, and chunks or layers longer than the file.

    lazrs takes memory for them as the file says, and where it gets none it ends the process.
    """
    point_bytes = header.point_format.size
    (packing,) = header.vlrs.get("LasZipVlr")
    (kind,), (chunk_points,) = (struct.unpack_from(form, packing.record_data, at) for form, at in _PACKING)
    (n_items,) = struct.unpack_from("<H", packing.record_data, _ITEMS_AT - 2)
    items = list(struct.iter_unpack("<HHH", packing.record_data[_ITEMS_AT:][: 6 * n_items]))
    if (item_bytes := sum(size for _, size, _ in items)) != point_bytes:
        raise ScanError(f"{path}: points of {point_bytes} bytes are packed as of {item_bytes}; the file is damaged")
    for item, size, version in items:
        if size != _ITEM_BYTES.get(item, size) or (version in _VERSIONS_IN_LAYERS) != (kind == _LAYERED):
            raise ScanError(
                f"{path}: {size} bytes of kind {item} version {version} found in points packed by kind {kind}; the "
                "file is damaged"
            )
    if kind != _IN_ONE_PIECE:
        n_layers = sum(_N_LAYERS.get(item, size) for item, size, _ in items) if kind == _LAYERED else 0
        _check_chunks(path, header, packing.record_data, chunk_points, n_layers)


def _check_chunks(path: Path, header: Any, packing: bytes, chunk_points: int, n_layers: int) -> None:
    """Refuses a table of more or fewer chunks than the file can hold, and layers that end behind it."""
    import lazrs

    n_bytes, start = path.stat().st_size, header.offset_to_point_data
    with BoundedFile(path) as file:
        file.seek(start)
        (table,) = struct.unpack("<q", file.read(8))
        if table <= start:  # as lazrs has it: whoever wrote it could not go back
            file.seek(-8, 2)
            (table,) = struct.unpack("<q", file.read(8))
        file.seek(max(table, start))
        _, n_chunks = struct.unpack("<II", file.read(8))
        n_points, n_read = header.point_count if chunk_points else 0, -(-header.point_count // max(chunk_points, 1))
        if chunk_points == _VARIABLE:
            n_read = n_chunks
            if n_chunks <= n_bytes:
                file.seek(start)
                n_points = sum(n for n, _ in lazrs.read_chunk_table(file, lazrs.LazVlr(packing)))
        if max(n_chunks, n_read) > n_bytes or n_points < header.point_count:
            raise ScanError(
                f"{path}: {max(n_chunks, n_read)} chunks of {n_points} points found, in {n_bytes} bytes; the header "
                f"says {header.point_count} points; the file is damaged"
            )
        start += 8
        for _ in range(n_read if n_layers else 0):
            file.seek(start + header.point_format.size + 4)
            sizes = np.frombuffer(file.read(4 * n_layers), "<u4")
            start = file.tell() + int(sizes.sum(dtype=np.uint64))
            if start > n_bytes:
                raise ScanError(f"{path}: a chunk that ends at byte {start} found, in {n_bytes}; the file is damaged")
