"""Posed scans made a surface and scanned again: what is met, where, and of what the map is made."""

import numpy as np
import pytest

from fidpipe.schemas.sensor_models import SENSORS, SensorModel
from fidpipe.stages.generate.ray_casting import fire
from fidpipe.stages.generate.rescan import EMPTY_MAP, SurfelModel, extend_map, recorded_directions
from scenes import box, seeded

EXACT = SensorModel("exact", (), (), 0.4, 0.5, 100.0, 0.0, 0.0, 0.0, 60.0)


def plane(normal, distance_m, half_m=9.0, step_m=0.15):
    """Evenly spread points of a plane at a distance along its normal."""
    n = np.asarray(normal, dtype=float) / np.linalg.norm(normal)
    u = np.cross(n, [0.0, 0.0, 1.0] if abs(n[2]) < 0.9 else [1.0, 0.0, 0.0])
    u /= np.linalg.norm(u)
    a, b = (grid.ravel() for grid in np.meshgrid(*2 * [np.arange(-half_m, half_m, step_m)]))
    return distance_m * n + a[:, None] * u + b[:, None] * np.cross(n, u), n


def scan(points, directions, sensor=EXACT):
    return SurfelModel(extend_map(EMPTY_MAP, points)).scan(directions, sensor, seeded())


@pytest.mark.parametrize("normal", [(1, 0, 0), (1, 2, 0.3), (0.9, 0.3, -0.4)])
def test_a_plane_scanned_again_is_that_plane_within_a_millimetre(normal):
    points, n = plane(normal, 6.0)
    directions = fire(SENSORS["hdl64"], step_deg=0.8).directions()
    aimed = directions[directions @ n > 0.75]
    again = scan(points, aimed).points
    assert len(again) == len(aimed) > 300
    np.testing.assert_allclose(again @ n, 6.0, atol=1e-3)


def test_a_rough_plane_scanned_again_lies_in_its_middle_and_not_before_it():
    points, n = plane((1, 0, 0), 8.0, step_m=0.06)
    rough = points + seeded().normal(0, 0.03, (len(points), 1)) * n
    directions = fire(SENSORS["hdl64"], step_deg=0.8).directions()
    again = scan(rough, directions[directions @ n > 0.9]).points
    assert (again @ n).mean() == pytest.approx(8.0, abs=0.005)
    assert (again @ n).std() < 0.03


def test_rays_meet_the_nearer_of_two_walls_and_see_the_other_beside_it():
    near, _ = plane((1, 0, 0), 5.0, half_m=1.0)
    far, _ = plane((1, 0, 0), 12.0)
    again = scan(
        np.vstack([near, far]), np.array([[1.0, 0, 0], [1, 0.02, 0.1], [1, 0.5, 0]]) / [[1.0], [1.005], [1.118]]
    )
    assert again.points[:, 0] == pytest.approx([5.0, 5.0, 12.0], abs=0.06)


def test_a_ray_that_meets_nothing_gives_no_point():
    points, _ = plane((1, 0, 0), 5.0)
    assert len(scan(points, np.array([[-1.0, 0, 0], [0, 0, 1]])).points) == 0
    assert len(SurfelModel(EMPTY_MAP).scan(np.eye(3), EXACT, seeded()).points) == 0


def test_noise_and_losses_are_those_of_the_sensor():
    points, n = plane((1, 0, 0), 6.0, step_m=0.09)
    directions = fire(SENSORS["hdl64"], step_deg=0.2).directions()
    directions = directions[directions @ n > 0.8]
    sensor = SensorModel("rough", (), (), 0.2, 0.5, 100.0, 0.05, 0.004, 0.3, 60.0)
    again = scan(points, directions, sensor).points
    assert len(again) / len(directions) == pytest.approx(0.7, abs=0.01)
    range_m = np.linalg.norm(again, axis=1)
    off_m = range_m - 6.0 / (again @ n / range_m)
    assert off_m.std() == pytest.approx(0.05, rel=0.05)
    np.testing.assert_allclose(range_m / 0.004, np.round(range_m / 0.004), atol=1e-6)
    assert len(scan(points, directions, SensorModel("near", (), (), 0.2, 0.5, 5.0, 0.0, 0.0, 0.0, 60.0)).points) == 0


def test_the_order_of_the_points_of_a_scan_changes_the_twin_by_rounding_alone():
    points = np.vstack([plane((1, 0, 0), 6.0)[0], box([4, 3, 0], [1, 1, 1], 900)])
    directions = fire(SENSORS["hdl64"], step_deg=1.0).directions()
    a, b = (scan(order, directions).points for order in (points, points[seeded().permutation(len(points))]))
    np.testing.assert_allclose(a, b, atol=1e-6)


def test_the_map_grows_with_the_surface_and_not_with_the_scans():
    points, _ = plane((0, 0, -1), 1.7, half_m=12.0, step_m=0.05)
    voxels = EMPTY_MAP
    sizes = []
    for seed in range(4):
        voxels = extend_map(voxels, points + seeded(seed).uniform(-0.02, 0.02, (len(points), 3)) * [1, 1, 0])
        sizes.append(len(voxels.points))
    assert sizes[-1] < 1.05 * sizes[0]
    assert voxels.n_points.sum() == 4 * len(points)
    np.testing.assert_allclose(voxels.points[:, 2], -1.7)


def test_voxels_are_wider_farther_away():
    near, far = (plane((1, 0, 0), distance_m, half_m=3.0, step_m=0.05)[0] for distance_m in (6.0, 50.0))
    sizes = [len(extend_map(EMPTY_MAP, points).points) for points in (near, far)]
    assert sizes[0] / sizes[1] == pytest.approx(16, rel=0.2)


def test_foliage_stays_foliage():
    wall, tree = plane((1, 0, 0), 9.0)[0], box([5, 0, 0], [0.6, 0.6, 0.6], 2000)
    points = np.vstack([wall, tree])
    voxels = extend_map(EMPTY_MAP, points, np.arange(len(points)) >= len(wall))
    again = SurfelModel(voxels).scan(np.array([[1.0, 0, 0], [0.8, 0.6, 0]]), EXACT, seeded())
    assert again.is_foliage.tolist() == [True, False]
    assert again.points[:, 0] == pytest.approx([4.7, 9.0], abs=0.1)


def test_recorded_beams_are_those_of_the_scan_and_where_it_saw_nothing_those_of_the_others():
    everything = fire(SENSORS["hdl64"], step_deg=0.2).directions()
    azimuth = np.arctan2(everything[:, 1], everything[:, 0])
    is_seen = np.abs(azimuth) < 2.0  # nothing is met behind the sensor
    own = 20.0 * everything[is_seen]
    others = 30.0 * np.vstack([everything + seeded(i).normal(0, 0.004, everything.shape) for i in range(4)])
    directions = recorded_directions(own, others)
    np.testing.assert_allclose(directions[: len(own)], everything[is_seen])
    np.testing.assert_allclose(np.linalg.norm(directions, axis=1), 1.0)
    added = directions[len(own) :]
    assert (np.abs(np.arctan2(added[:, 1], added[:, 0])) > 2.0).mean() > 0.95  # some look over the uppermost ring
    assert len(directions) == pytest.approx(len(everything), rel=0.1)
