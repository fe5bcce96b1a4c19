"""Odometry: trajectories worked out by hand, and KISS-ICP on a street that is driven along."""

import sys

import numpy as np
import pytest

from fidpipe.schemas.errors import StageError
from fidpipe.stages.odometry import compare_trajectories, trajectory
from scenes import rigid, street


def drive(steps_m, turn_deg=0.0):
    """Poses of a sensor that drives ahead; the turn is at the last scan."""
    poses = np.tile(np.eye(4), (len(steps_m) + 1, 1, 1))
    poses[1:, 0, 3] = np.cumsum(steps_m)
    poses[-1, :3, :3] = rigid(turn_deg, [0, 0, 0])[:, :3]
    return poses


def gaps(*trajectories):
    return {
        gap.measure: (gap.real, gap.sim, gap.gap) for gap in compare_trajectories(*trajectories)
    }


def test_equal_trajectories_have_no_gap():
    assert [gap for *_, gap in gaps(drive([1, 1]), drive([1, 1])).values()] == [0, 0, 0]


def test_the_drift_is_at_the_last_scan_and_steps_are_medians():
    found = gaps(drive([1.0, 1.0, 1.0]), drive([1.1, 1.1, 1.3]))
    assert found["drift_m"] == (None, None, pytest.approx(0.5))
    assert found["step_m"] == (pytest.approx(1.0), pytest.approx(1.1), pytest.approx(0.1))
    assert found["turn_deg"] == (0, 0, 0)
    turned = gaps(drive([1.0]), drive([1.0], turn_deg=3.0))
    assert turned["turn_deg"] == (0, pytest.approx(3.0), pytest.approx(3.0))


def test_known_poses_in_any_frame_give_the_drift_of_each_side():
    known = np.vstack([rigid(40, [5, -3, 1]), [0, 0, 0, 1]]) @ drive([1.0, 1.0])
    real, sim, gap = gaps(drive([1.0, 1.1]), drive([1.0, 0.8]), known)["drift_m"]
    assert (real, sim, gap) == (pytest.approx(0.1), pytest.approx(0.2), pytest.approx(0.3))


def test_kiss_icp_finds_the_way_along_a_street():
    pytest.importorskip("kiss_icp")
    scene = street(n=2000)
    scans = [scene - [0.3 * i, 0, 0] for i in range(4)]
    poses = trajectory(scans)
    assert poses[:, 0, 3] == pytest.approx([0, 0.3, 0.6, 0.9], abs=0.02)
    assert np.array_equal(poses, trajectory(scans))


def test_without_kiss_icp_the_extra_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "kiss_icp", None)
    with pytest.raises(StageError, match=r"fidpipe\[odometry\]"):
        trajectory([])
