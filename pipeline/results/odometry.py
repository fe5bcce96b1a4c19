"""Odometry on both sides of a run: an additional task that takes a sequence of scans, not a pair."""

from __future__ import annotations

from dataclasses import asdict

import numpy as np

from ...schemas.columns import Row
from ...schemas.errors import DatasetError, RunError
from ...stages.arrays import FloatArray
from ...stages.odometry import compare_trajectories, trajectory
from ..datasets.pairs import local_folder, read_dataset
from ..jobs.points_job import coordinates
from .finished import FinishedRun

_LONGEST_STEP_S = 0.5


def compare_odometry(run: FinishedRun) -> list[Row]:
    """Measures of odometry over the longest sequence of scans of a run, one row each.

    Raises
    ------
    FidpipeError
        No scans follow one another, or kiss-icp is not installed.
    """
    names = _sequence(run)
    real = _trajectory(run, names, "real")
    sim = _trajectory(run, names, "sim")
    gaps = compare_trajectories(real, sim, _known_poses(run, names))
    return [asdict(gap) | {"n_scans": len(names)} for gap in gaps]


def _trajectory(run: FinishedRun, names: list[str], side: str) -> FloatArray:
    tables = (run.store.read_table("ground", name, side, ["x", "y", "z"]) for name in names)
    return trajectory(map(coordinates, tables))


def _sequence(run: FinishedRun) -> list[str]:
    """The most scored pairs that follow one another within half a second.

    Without times they are in the order of their names, and follow one another at one place.
    """
    names = run.select()
    times_s = run.record.times_s
    if all(name in times_s for name in names):
        names.sort(key=lambda name: times_s[name])
        is_next = np.diff([times_s[name] for name in names]) <= _LONGEST_STEP_S
    else:
        is_next = np.diff(run.places(names)) == 0
    longest = max(np.split(names, np.flatnonzero(~is_next) + 1), key=len)
    if len(longest) < 2:
        raise RunError(
            f"run {run.folder}: expected scans that follow one another (timestamp_s within "
            f"{_LONGEST_STEP_S:g} s, or names in order at one place), found none"
        )
    sequence: list[str] = longest.tolist()
    return sequence


def _known_poses(run: FinishedRun, names: list[str]) -> FloatArray | None:
    """Poses in the dataset, (n, 4, 4); None if it lacks one, or is not here."""
    try:
        dataset = read_dataset(local_folder(run.record.dataset))
    except (DatasetError, OSError):
        return None
    motions = {pair.pair_id: pair.T_world_sensor for pair in dataset.pairs}
    numbers = [motions.get(name) for name in names]
    if None in numbers:
        return None
    poses = np.tile(np.eye(4), (len(names), 1, 1))
    poses[:, :3] = np.reshape(np.array(numbers, dtype=np.float64), (-1, 3, 4))
    return poses
