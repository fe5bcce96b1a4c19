"""Point Cloud Library `.pcd`: ascii, binary, binary_compressed; read by pypcd4."""

from __future__ import annotations

from pathlib import Path

from ....schemas.errors import ScanError
from .bounds import BoundedFile, check_promise, check_unpacked
from .scan import Scan, refused_unless, scan_from_columns

_LONGEST_LINE_BYTES, _MOST_COLUMNS = 2**16, 1000


def read(path: Path) -> Scan:
    """The scan in a `.pcd` file.

    Raises
    ------
    ScanError
        The file is not whole, or has no fields x, y, z.
    """
    from pypcd4 import PointCloud

    with refused_unless(path, "a whole PCD file"):
        _check_head(path)
        with BoundedFile(path) as file:
            cloud = PointCloud.from_fileobj(file)
    rows = cloud.pc_data
    if len(rows) != cloud.metadata.points:
        raise ScanError(
            f"{path}: {len(rows)} points found, the header says {cloud.metadata.points}; the file is truncated"
        )
    return scan_from_columns(path, {name: rows[name] for name in cloud.fields})


def _check_head(path: Path) -> None:
    """Refuses a header that speaks of more than the file can hold, or can unpack to: pypcd4 believes it."""
    words: dict[str, list[str]] = {}
    with BoundedFile(path) as file:
        while "DATA" not in words and (line := file.readline(_LONGEST_LINE_BYTES)):
            name, *values = line.decode().split() or ["#"]
            words[name] = values
        n_packed = file.read(4)
    n_points = int(words["POINTS"][0])
    counts = [int(count) for count in words.get("COUNT", ["1"] * len(words["SIZE"]))]
    if min(counts) < 0 or sum(counts) > _MOST_COLUMNS:
        raise ScanError(f"{path}: the header says {counts} numbers a point, at most {_MOST_COLUMNS} are read")
    point_bytes = sum(count * int(size) for count, size in zip(counts, words["SIZE"], strict=True))
    if words["DATA"] == ["ascii"]:
        check_promise(path, n_points, 2 * sum(counts))  # a digit and a blank
    elif words["DATA"] == ["binary"]:
        check_promise(path, n_points, point_bytes)
    else:
        check_promise(path, int.from_bytes(n_packed, "little"), 1)
        check_unpacked(path, n_points * point_bytes)
