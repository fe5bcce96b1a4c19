"""Point Cloud Library `.pcd`: ascii, binary, binary_compressed; read by pypcd4."""

from __future__ import annotations

from pathlib import Path

from ....schemas.errors import ScanError
from .scan import Scan, refused_unless, scan_from_columns


def read(path: Path) -> Scan:
    """The scan in a `.pcd` file.

    Raises
    ------
    ScanError
        The file is not whole, or has no fields x, y, z.
    """
    from pypcd4 import PointCloud

    with refused_unless(path, "a whole PCD file", Exception):  # pypcd4 has no error class of its own
        cloud = PointCloud.from_path(path)
    rows = cloud.pc_data
    if len(rows) != cloud.metadata.points:
        raise ScanError(
            f"{path}: {len(rows)} points found, the header says {cloud.metadata.points}; the file is truncated"
        )
    return scan_from_columns(path, {name: rows[name] for name in cloud.fields})
