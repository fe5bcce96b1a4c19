"""Posed recordings: the scans of one drive, and where the sensor was when each was taken.

Three layouts: the manifest `pairs.csv` with a column T_world_sensor; poses in TUM format; KITTI's
poses of the camera with its calibration. Opens poses, calibration and manifest, no scan.
"""

from __future__ import annotations

import re
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from ...schemas.errors import DatasetError
from ...stages.arrays import FloatArray
from ..datasets.pairing import read_numbers, read_times
from ..datasets.pairs import (
    MANIFEST,
    Dataset,
    ScanPair,
    check_rigid,
    read_label_names,
    read_manifest,
    scans_in,
)
from ..datasets.readers.scan_ref import ScanRef

FEWEST_FRAMES = 3
_SCAN_FOLDERS = ("velodyne", "real", ".")
_POSE_FILES = ("poses.tum", "poses.txt")
_CALIBRATION = "calib.txt"
_TIMES = "times.txt"
_TRANSFORM = re.compile(r"^\s*Tr(?:_velo_to_cam)?\s*:(.*)", re.MULTILINE)
_QUATERNION_TOLERANCE = 1e-2
_TUM_NUMBERS, _KITTI_NUMBERS = 8, 12


def read_recording(
    folder: Path,
    poses: Path | None = None,
    calibration: Path | None = None,
) -> Dataset:
    """Posed real scans in the order in which they were taken, as pairs without a simulated side.

    Scans lie in `velodyne/`, `real/` or the folder itself and are taken in the order of their
    names, one pose each.

    Parameters
    ----------
    folder : of the recording
    poses : file of poses, eight numbers a line (TUM: time tx ty tz qx qy qz qw, of the sensor) or
        twelve (KITTI: [R | t] row by row, of the camera); by default the manifest, poses.tum,
        poses.txt, or ../../poses/NAME.txt
    calibration : KITTI's, whose line Tr maps the sensor's frame into the camera's; by default
        calib.txt in the folder

    Raises
    ------
    DatasetError
        The folder does not exist, poses are missing, are not one per scan or are not rigid motions,
        or there are fewer than three frames.
    """
    if not folder.is_dir():
        raise DatasetError(
            f"recording {folder}: no such folder; expected one with scans and poses"
        )
    manifest = folder / MANIFEST
    if poses is None and manifest.exists():
        frames = _frames_of_manifest(manifest)
    else:
        frames = _frames_of_poses(folder, poses or _find_poses(folder), calibration)
    if len(frames) < FEWEST_FRAMES:
        raise DatasetError(
            f"recording {folder}: expected at least {FEWEST_FRAMES} frames, got {len(frames)}: "
            "each is re-scanned in a model of the others"
        )
    scans = [frame.scans["real"] for frame in frames]
    stem, n_alike = Counter(scan.stem for scan in scans).most_common(1)[0]
    if n_alike > 1:
        raise DatasetError(
            f"recording {folder}: expected unique names; {n_alike} scans are called {stem}",
        )
    label_names = read_label_names(folder) or read_label_names(scans[0].file.parent)
    return Dataset(folder, tuple(frames), label_names)


def _frames_of_manifest(manifest: Path) -> list[ScanPair]:
    frames = []
    for pair in read_manifest(manifest, [], needs_sim=False):
        if pair.T_world_sensor is None:
            raise DatasetError(
                f"{manifest}: pair {pair.pair_id} has no T_world_sensor; expected 12 numbers ([R "
                "| t] row by row), or a file of poses (--poses)"
            )
        if pair.real is None or pair.real.format.holds_frames:
            raise DatasetError(
                f"{manifest}: pair {pair.pair_id}: expected a file with one real scan ({pair.fault or pair.real})"
            )
        frames.append(replace(pair, sim=None))
    return frames


def _find_poses(folder: Path) -> Path:
    of_kitti = folder.parent.parent / "poses" / f"{folder.name}.txt"
    for path in (*(folder / name for name in _POSE_FILES), of_kitti):
        if path.is_file():
            return path
    raise DatasetError(
        f"recording {folder}: no poses found; expected {', '.join(_POSE_FILES)}, a {MANIFEST} "
        "with T_world_sensor, or a file named by --poses"
    )


def _frames_of_poses(folder: Path, poses: Path, calibration: Path | None) -> list[ScanPair]:
    scans: list[ScanRef] = []
    for name in _SCAN_FOLDERS:
        if not scans and (folder / name).is_dir():
            scans = scans_in(folder / name)
    if not scans:
        raise DatasetError(
            f"recording {folder}: no scans found; expected files in velodyne/, real/ or the folder",
        )
    rows = read_numbers(poses, (_TUM_NUMBERS, _KITTI_NUMBERS))
    if len(rows) != len(scans):
        raise DatasetError(
            f"{poses}: expected one pose per scan in the order of their names, got {len(rows)} "
            f"poses for {len(scans)} scans ({scans[0].file.name} to {scans[-1].file.name})"
        )
    times: list[float | None] = [None] * len(scans)
    if rows.shape[1] == _TUM_NUMBERS:
        motions = _tum_motions(poses, rows[:, 1:])
        times = rows[:, 0].tolist()
    else:
        motions = _kitti_motions(poses, rows, calibration or folder / _CALIBRATION)
        if (folder / _TIMES).is_file():
            times = read_times(folder / _TIMES, len(scans)).tolist()
    frames = []
    for scan, motion, time_s in zip(scans, motions, times, strict=True):
        T_world_sensor = tuple(motion.ravel().tolist())
        frames.append(ScanPair(scan.stem, scan, None, time_s, T_world_sensor=T_world_sensor))
    return frames


def _tum_motions(poses: Path, rows: FloatArray) -> FloatArray:
    """(n, 3, 4) float64, of tx ty tz qx qy qz qw."""
    from scipy.spatial.transform import Rotation

    length = np.linalg.norm(rows[:, 3:], axis=1)
    is_right = (np.abs(length - 1) <= _QUATERNION_TOLERANCE) & np.isfinite(rows).all(axis=1)
    if not is_right.all():
        first = int(np.argmin(is_right))
        raise DatasetError(
            f"{poses}, pose {first + 1}: not a rigid motion (expected a quaternion of length "
            f"1, got {length[first]:.3g}); lines are time tx ty tz qx qy qz qw"
        )
    R = Rotation.from_quat(rows[:, 3:]).as_matrix()
    return np.concatenate([R, rows[:, :3, None]], axis=2)


def _kitti_motions(poses: Path, rows: FloatArray, calibration: Path) -> FloatArray:
    """(n, 3, 4) float64, T_world_sensor = Tr^-1 T_world_camera Tr; the world is then the sensor's first frame."""
    T_world_camera = []
    for line, row in enumerate(rows, start=1):
        T_world_camera.append(square(check_rigid(f"{poses}, pose {line}: the pose", row)))
    T_camera_sensor = square(_read_calibration(calibration, poses))
    motions: FloatArray = (
        np.linalg.inv(T_camera_sensor) @ np.array(T_world_camera) @ T_camera_sensor
    )
    return motions[:, :3]


def _read_calibration(path: Path, poses: Path) -> FloatArray:
    """(3, 4) float64, the line `Tr` of KITTI's calibration."""
    try:
        line = _TRANSFORM.search(path.read_text(encoding="utf-8"))
        if line is None:
            raise ValueError("it has none")
        numbers = np.array(line[1].split(), dtype=np.float64)
    except (OSError, ValueError) as error:
        raise DatasetError(
            f"{path}: expected a line Tr: with 12 numbers, from the sensor's frame to the camera's ({error}); "
            f"{poses.name} holds KITTI's poses of the camera, which need it (--calib)"
        ) from error
    return check_rigid(f"{path}: Tr", numbers)


def square(motion: ArrayLike) -> FloatArray:
    """(4, 4) float64, of 12 numbers, [R | t] row by row."""
    return np.vstack([np.reshape(motion, (3, 4)), [0.0, 0.0, 0.0, 1.0]])
