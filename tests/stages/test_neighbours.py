import numpy as np
import pytest

from fidpipe.pipeline.datasets.readers import read_scan
from fidpipe.stages.statistics.neighbours import SAME_PLACE, map_place, neighbours, overlap
from scenes import box, moved, rigid


def town(seed):
    """Twelve boxes at random places within 45 m."""
    rng = np.random.default_rng(seed)
    sizes = rng.uniform([2, 2, 2], [12, 4, 5], (12, 3))
    return np.vstack([box([*rng.uniform(-45, 45, 2), 1], size, 400, seed + i) for i, size in enumerate(sizes)])


def test_a_place_is_recognised_after_some_metres_and_another_is_not():
    here = map_place(town(0))
    assert overlap(here, here) == pytest.approx(1.0, abs=1e-4)
    assert overlap(here, map_place(moved(town(0), rigid(2, [7, -3, 0])))) > SAME_PLACE
    assert max(overlap(here, map_place(town(100 * seed))) for seed in range(1, 5)) < SAME_PLACE


def test_an_empty_scan_is_nowhere():
    assert overlap(map_place(np.empty((0, 3))), map_place(town(0))) == 0.0


def test_only_scans_within_the_window_are_compared():
    assert neighbours([town(0), town(100), town(0)]) == [(0, 2)]
    assert neighbours([town(0), town(100), town(0)], window=1) == []


def object_points(path):
    points = read_scan(path).points
    points = points[np.isfinite(points).all(axis=1) & (np.hypot(points[:, 0], points[:, 1]) > 2.5)]
    return points[points[:, 2] > -1.3]


def test_ten_neighbouring_frames_are_one_place_and_other_recordings_are_not(real_data):
    frames = [map_place(object_points(path)) for path in sorted((real_data / "kitti_sequence").glob("*.bin"))]
    others = [next((real_data / folder).glob("*.bin")) for folder in ("nuscenes", "rellis", "carla")]
    assert min(overlap(frames[0], other) for other in frames) > SAME_PLACE + 0.1
    assert max(overlap(frames[0], map_place(object_points(path))) for path in others) < SAME_PLACE - 0.1
