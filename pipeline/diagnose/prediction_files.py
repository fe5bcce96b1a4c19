"""Files with the predictions of a user's model: a class for each point, or boxes."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from ...schemas.errors import DatasetError
from ...stages.arrays import IntArray
from ...stages.predictions import Boxes


def read_point_labels(path: Path, n_points: int) -> IntArray:
    """Classes of the points of a scan file, (n,): the low 16 bits of uint32, as in SemanticKITTI."""
    n_bytes = path.stat().st_size
    if n_bytes != 4 * n_points:
        raise DatasetError(
            f"{path}: expected {4 * n_points} bytes (one uint32 for each of the {n_points} points "
            f"of the scan file), got {n_bytes}"
        )
    return (np.fromfile(path, dtype="<u4") & 0xFFFF).astype(np.int32)


def read_kitti_boxes(path: Path) -> Boxes:
    """Boxes of a label file of KITTI, without those of the type DontCare.

    A line is: type, truncation, occlusion, alpha, four numbers of the image, height, width, length,
    x, y, z of the middle of the floor (camera's axes: right, down, forward), rotation about y, and
    perhaps a score. The camera is taken to be at the sensor, looking along x.
    """
    names: list[str] = []
    rows: list[list[float]] = []
    for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), start=1):
        words = line.split()
        if not words or words[0] == "DontCare":
            continue
        try:
            h, w, length, x, y, z, turn = map(float, words[8:15])
        except ValueError as error:
            raise DatasetError(
                f"{path}, line {number}: expected a line of a KITTI label file (type and at least "
                f"14 numbers), got {len(words)} words"
            ) from error
        names.append(words[0])
        rows.append([z, -x, h / 2 - y, length, w, h, -turn - np.pi / 2])
    return _boxes(names, rows)


def read_nuscenes_boxes(path: Path) -> Boxes:
    """Boxes of one sample as in the results of nuScenes: a list, or the one list in `results`.

    A box has detection_name, translation (x, y, z of its centre), size (width, length, height) and
    rotation (quaternion w, x, y, z), in the axes of the real sensor.
    """
    names: list[str] = []
    rows: list[list[float]] = []
    try:
        boxes = json.loads(path.read_text(encoding="utf-8"))
        if isinstance(boxes, dict):
            (boxes,) = boxes["results"].values()
        for box in boxes:
            width, length, height = map(float, box["size"])
            w, x, y, z = map(float, box["rotation"])
            yaw = np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
            names.append(box["detection_name"])
            rows.append([*map(float, box["translation"]), length, width, height, yaw])
        return _boxes(names, rows)
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise DatasetError(
            f"{path}: expected boxes of one sample as in the results of nuScenes (detection_name, "
            f"translation, size, rotation), got {type(error).__name__}: {error}"
        ) from error


def _boxes(names: list[str], rows: list[list[float]]) -> Boxes:
    """Boxes of rows x, y, z, length, width, height, yaw."""
    values = np.array(rows, dtype=np.float64).reshape(-1, 7)
    return Boxes(np.array(names, dtype=np.str_), values[:, :3], values[:, 3:6], values[:, 6])
