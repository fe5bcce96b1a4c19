"""Stanford `.ply`, ascii and binary; read by trimesh."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from .scan import Scan, scan_from_columns


def read(path: Path) -> Scan:
    """The vertices of a `.ply` file; its faces are not read.

    Raises
    ------
    ScanError
        The file is not whole, or has no vertices with x, y, z.
    """
    from trimesh.exchange.ply import load_ply

    with path.open("rb") as file:
        vertex = load_ply(file, skip_materials=True)["metadata"]["_ply_raw"]["vertex"]
    rows = vertex["data"]
    columns = {
        name: np.asarray(rows[name]).reshape(vertex["length"]) for name in vertex["properties"]
    }
    if any(column.dtype == object for column in columns.values()):
        raise ValueError("a row is too short")
    return scan_from_columns(path, columns)
