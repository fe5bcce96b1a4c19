"""Point Cloud Library `.pcd`: ascii, binary, binary_compressed; read by pypcd4."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ....schemas.errors import ScanError
from .scan import Scan, check_promise, check_unpacked, scan_from_columns

_HEADER_LINES, _MOST_COLUMNS = 10, 1000


def read(path: Path) -> Scan:
    """The scan in a `.pcd` file.

    Raises
    ------
    ScanError
        The file is not whole, or has no fields x, y, z.
    """
    from pypcd4 import PointCloud

    _check_head(path)
    with path.open("rb") as file:
        cloud = PointCloud.from_fileobj(file)
    rows = np.atleast_1d(cloud.pc_data)
    if len(rows) != cloud.metadata.points:
        raise ScanError(
            f"{path}: {len(rows)} points found, the header says {cloud.metadata.points}; the file is truncated"
        )
    return scan_from_columns(path, {name: rows[name] for name in cloud.fields})


def _check_head(path: Path) -> None:
    """Reject a header that declares more than the file can hold or unpack to: pypcd4 trusts it."""
    from pypcd4.pypcd4 import MetaData

    lines: list[str] = []
    with path.open("rb") as file:
        for line in file:  # as pypcd4 reads them
            text = line.decode().strip()
            lines += [text] * bool(text and not text.startswith("#"))
            if text.startswith("DATA") or len(lines) == _HEADER_LINES:
                break
        n_packed, n_unpacked = np.frombuffer(file.read(8).ljust(8, b"\0"), "<u4").tolist()
    head = MetaData.parse_header(lines)
    if sum(head.count) > _MOST_COLUMNS:
        raise ScanError(f"{path}: {sum(head.count)} numbers a point found, at most {_MOST_COLUMNS} are read")
    point_bytes = sum(count * size for count, size in zip(head.count, head.size, strict=True))
    if head.data == "ascii":
        check_promise(path, head.points, 2 * sum(head.count))  # a digit and a blank
    elif head.data == "binary":
        check_promise(path, head.points, point_bytes)
    elif n_unpacked != head.points * point_bytes or n_packed > path.stat().st_size:
        raise ScanError(
            f"{path}: expected {head.points} points of {point_bytes} bytes, got {n_unpacked} bytes packed in {n_packed}"
        )
    else:
        check_unpacked(path, n_unpacked)
