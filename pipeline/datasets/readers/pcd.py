"""Point Cloud Library `.pcd`: ascii, binary, binary_compressed; read by pypcd4."""

from __future__ import annotations

from io import BytesIO
from pathlib import Path
from typing import BinaryIO

import numpy as np

from ....schemas.errors import ScanError
from .scan import Scan, scan_from_columns

_HEADER_LINES, _MOST_COLUMNS = 10, 1000


def read(path: Path) -> Scan:
    """The scan in a `.pcd` file.

    Raises
    ------
    ScanError
        The file is not whole, or has no fields x, y, z.
    """
    from pypcd4 import PointCloud

    with path.open("rb") as file:
        header = _header(path, file)
        cloud = PointCloud.from_fileobj(BytesIO(header + file.read()))
    rows = np.atleast_1d(cloud.pc_data)
    if len(rows) != cloud.metadata.points:
        raise ScanError(
            f"{path}: {len(rows)} points found, the header says {cloud.metadata.points}; the file is truncated",
        )
    return scan_from_columns(path, {name: rows[name] for name in cloud.fields})


def _header(path: Path, file: BinaryIO) -> bytes:
    """The header without comments and fields of COUNT 0, which take no bytes; the data follow in the file.

    Ouster's driver pads with such fields, and pypcd4 rejects them.
    """
    lines: dict[str, list[str]] = {}
    for line in iter(file.readline, b""):
        name, *values = line.decode().split() or ["#"]
        if not name.startswith("#"):
            lines[name] = values
        if name == "DATA" or len(lines) == _HEADER_LINES:
            break
    counts = lines.setdefault("COUNT", ["1" for _ in lines.get("FIELDS", [])])
    lines["DATA"] = lines.pop("DATA", [])  # the last line
    n_columns = sum(map(int, counts))
    if n_columns > _MOST_COLUMNS:
        raise ScanError(
            f"{path}: {n_columns} numbers a point found, at most {_MOST_COLUMNS} are read",
        )
    for name in ("FIELDS", "SIZE", "TYPE", "COUNT"):
        values = lines.get(name, [])
        if len(values) == len(counts):
            lines[name] = [value for value, n in zip(values, counts, strict=True) if n != "0"]
    return "".join(f"{name} {' '.join(values)}\n" for name, values in lines.items()).encode()
