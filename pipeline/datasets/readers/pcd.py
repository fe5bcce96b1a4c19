"""Point Cloud Library `.pcd`: ascii, binary, binary_compressed; read by pypcd4."""

from __future__ import annotations

from io import BytesIO
from pathlib import Path
from typing import BinaryIO

import numpy as np

from ....schemas.errors import ScanError
from .scan import Scan, check_promise, check_unpacked, scan_from_columns

_HEADER_LINES, _MOST_COLUMNS = 10, 1000
_FIELD_LINES = ("FIELDS", "SIZE", "TYPE", "COUNT")


def read(path: Path) -> Scan:
    """The scan in a `.pcd` file.

    Raises
    ------
    ScanError
        The file is not whole, or has no fields x, y, z.
    """
    from pypcd4 import PointCloud

    with path.open("rb") as file:
        lines = _without_empty_fields(_header_lines(file))
        start = file.tell()
        _check_head(path, lines, file.read(8))
        file.seek(start)
        header = "".join(f"{line}\n" for line in lines)
        cloud = PointCloud.from_fileobj(BytesIO(header.encode() + file.read()))
    rows = np.atleast_1d(cloud.pc_data)
    if len(rows) != cloud.metadata.points:
        raise ScanError(
            f"{path}: {len(rows)} points found, the header says {cloud.metadata.points}; the file is truncated",
        )
    return scan_from_columns(path, {name: rows[name] for name in cloud.fields})


def _header_lines(file: BinaryIO) -> list[str]:
    """The lines of the header without comments, as pypcd4 reads them; the data follow in the file."""
    lines: list[str] = []
    for line in iter(file.readline, b""):
        text = line.decode().strip()
        if text and not text.startswith("#"):
            lines.append(text)
        if text.startswith("DATA") or len(lines) == _HEADER_LINES:
            break
    return lines


def _without_empty_fields(lines: list[str]) -> list[str]:
    """The header without fields of COUNT 0, which take no bytes and which pypcd4 rejects; Ouster's driver pads so."""
    words = {line.split()[0]: line.split()[1:] for line in lines}
    counts = words.get("COUNT", [])
    if "0" not in counts or any(len(words.get(name, [])) != len(counts) for name in _FIELD_LINES):
        return lines
    kept = []
    for line in lines:
        name, *values = line.split()
        if name in _FIELD_LINES:
            values = [value for value, count in zip(values, counts, strict=True) if count != "0"]
        kept.append(" ".join([name, *values]))
    return kept


def _check_head(path: Path, lines: list[str], sizes: bytes) -> None:
    """Reject a header that declares more than the file can hold or unpack to: pypcd4 trusts it.

    Parameters
    ----------
    sizes : first bytes of the data; of compressed data the sizes packed and unpacked
    """
    from pypcd4.pypcd4 import MetaData

    n_packed, n_unpacked = np.frombuffer(sizes.ljust(8, b"\0"), "<u4").tolist()
    head = MetaData.parse_header(lines)
    if sum(head.count) > _MOST_COLUMNS:
        raise ScanError(
            f"{path}: {sum(head.count)} numbers a point found, at most {_MOST_COLUMNS} are read",
        )
    point_bytes = sum(count * size for count, size in zip(head.count, head.size, strict=True))
    if head.data == "ascii":
        check_promise(path, head.points, 2 * sum(head.count))  # a digit and a blank
    elif head.data == "binary":
        check_promise(path, head.points, point_bytes)
    elif n_unpacked != head.points * point_bytes or n_packed > path.stat().st_size:
        raise ScanError(
            f"{path}: expected {head.points} points of {point_bytes} bytes, got {n_unpacked} "
            f"bytes packed in {n_packed}",
        )
    else:
        check_unpacked(path, n_unpacked)
