"""What LiDAR odometry gets from the scans of both sides: two trajectories, and how far they differ."""

from __future__ import annotations

from collections.abc import Iterable
from importlib.util import find_spec

import numpy as np
from scipy.spatial.transform import Rotation

from ..schemas.errors import StageError
from .arrays import FloatArray
from .tasks import Gap


def trajectory(scans: Iterable[FloatArray]) -> FloatArray:
    """Poses of the sensor in the frame of the first scan, by KISS-ICP, (n, 4, 4).

    Its settings are the defaults, without deskewing. Source: Vizzo et al., KISS-ICP, RA-L 2023.

    Parameters
    ----------
    scans : (m, 3) points of each, metres, in the order of time

    Raises
    ------
    StageError
        kiss-icp is not installed.
    """
    if find_spec("kiss_icp") is None:
        raise StageError(
            'odometry needs kiss-icp; install it with: pip install "fidpipe[odometry]"'
        )
    from kiss_icp.config import load_config
    from kiss_icp.kiss_icp import KissICP

    config = load_config(None)
    config.data.deskew = False
    config.registration.max_num_threads = 1
    odometry = KissICP(config)
    poses = []
    for points in scans:
        odometry.register_frame(points, np.zeros(len(points)))
        poses.append(odometry.last_pose)
    return np.array(poses)


def compare_trajectories(
    real: FloatArray, sim: FloatArray, known: FloatArray | None = None
) -> list[Gap]:
    """Differences of two trajectories of one drive.

    - drift_m: distance of the last poses. `real` and `sim` are the distances from the last known
      pose
    - step_m, turn_deg: with the motions R and S of the sides from each scan to the next, medians
      of the length and of the angle of R^-1 S. `real` and `sim` are the medians for R and S

    Parameters
    ----------
    real, sim : (n, 4, 4) poses, n of at least 2
    known : (n, 4, 4) poses that were measured otherwise, in any frame
    """
    real_drift_m = None
    sim_drift_m = None
    if known is not None:
        known = np.linalg.inv(known[0]) @ known
        real_drift_m = _apart_m(known, real)
        sim_drift_m = _apart_m(known, sim)
    real_steps = np.linalg.inv(real[:-1]) @ real[1:]
    sim_steps = np.linalg.inv(sim[:-1]) @ sim[1:]
    apart = np.linalg.inv(real_steps) @ sim_steps
    gaps = [Gap("odometry", "drift_m", real_drift_m, sim_drift_m, _apart_m(real, sim), "m")]
    for measure, median, unit in (
        ("step_m", _median_length_m, "m"),
        ("turn_deg", _median_angle_deg, "degrees"),
    ):
        values = (median(real_steps), median(sim_steps), median(apart))
        gaps.append(Gap("odometry", measure, *values, unit))
    return gaps


def _apart_m(poses: FloatArray, others: FloatArray) -> float:
    """Distance of the last poses of two trajectories."""
    return float(np.linalg.norm(others[-1, :3, 3] - poses[-1, :3, 3]))


def _median_length_m(motions: FloatArray) -> float:
    return float(np.median(np.linalg.norm(motions[:, :3, 3], axis=1)))


def _median_angle_deg(motions: FloatArray) -> float:
    angles = Rotation.from_matrix(motions[:, :3, :3]).magnitude()
    return float(np.degrees(np.median(angles)))
