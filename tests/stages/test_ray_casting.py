"""Sensor models, ray casting and posed scans scanned again, on surfaces whose answer is worked out by hand."""

from __future__ import annotations

import sys

import numpy as np
import pytest

from fidpipe.schemas.errors import FidpipeError
from fidpipe.schemas.sensor_models import SENSORS, SensorModel
from fidpipe.stages.generate.ray_casting import (
    cast_rays,
    fire,
    measure_ranges,
    return_probability,
)
from fidpipe.stages.generate.rescan import EMPTY_MAP, extend_map, recorded_directions, rescan
from scenes import box, seeded

VLP32C = SENSORS["vlp32c"]

# Elevation / azimuth offset by laser id, as DESIGN section 5 has them.
TABLE = """
 0 -25.000/-1.4   8  -7.254/-1.4  16 -4.667/-1.4  24 -3.000/-1.4
 1  -1.000/+4.2   9  +0.333/+4.2  17 +1.667/+4.2  25 +7.000/+1.4
 2  -1.667/-1.4  10  -0.333/-1.4  18 +1.000/-1.4  26 +4.667/-1.4
 3 -15.639/+1.4  11  -6.148/+1.4  19 -3.667/+4.2  27 -2.333/+4.2
 4 -11.310/-1.4  12  -5.333/-4.2  20 -3.333/-4.2  28 -2.000/-4.2
 5   0.000/+1.4  13  +1.333/+1.4  21 +3.333/+1.4  29 +15.00/+1.4
 6  -0.667/-4.2  14  +0.667/-4.2  22 +2.333/-1.4  30 +10.333/-1.4
 7  -8.843/+1.4  15  -4.000/+1.4  23 -2.667/+1.4  31 -1.333/+1.4
"""


def wall(x: float):
    """An upright wall 40 m wide and high, x metres ahead: two triangles."""
    corners = np.array([[x, -20.0, -20.0], [x, 20.0, -20.0], [x, 20.0, 20.0], [x, -20.0, 20.0]])
    return corners[[[0, 1, 2], [0, 2, 3]]]


def azimuth_of(directions):
    return np.arctan2(directions[:, 1], directions[:, 0])


def test_the_lasers_of_the_vlp32c_are_those_of_its_table():
    words = TABLE.split()
    by_id = dict(zip(map(int, words[::2]), words[1::2], strict=True))
    wanted = [tuple(map(float, by_id[laser].split("/"))) for laser in range(32)]
    assert list(zip(VLP32C.elevation_deg, VLP32C.azimuth_offset_deg, strict=True)) == wanted


def test_a_revolution_has_1808_firings_of_32_lasers():
    assert VLP32C.azimuth_step_deg == pytest.approx(0.1990656)
    assert len(fire(VLP32C)) == 1808 * 32 == 57_856


def test_a_laser_looks_at_the_azimuth_of_its_firing_plus_its_offset():
    azimuth_deg = np.degrees(azimuth_of(fire(VLP32C, start_deg=90.0))).reshape(-1, 32)
    elevation_deg = np.degrees(np.arcsin(fire(VLP32C)[:, 2])).reshape(-1, 32)
    assert azimuth_deg[0, 0] == pytest.approx(90.0 - 1.4)
    assert azimuth_deg[0, 1] == pytest.approx(90.0 + 4.2)
    # clockwise seen from above
    assert azimuth_deg[10, 1] == pytest.approx(90.0 + 4.2 - 10 * 0.1990656)
    assert elevation_deg[7, 3] == pytest.approx(-15.639)


def test_x_is_forward_y_left_and_z_up():
    left = fire(VLP32C, start_deg=90.0 - 1.4)[5]  # laser 5 looks level
    assert left == pytest.approx([0.0, 1.0, 0.0], abs=1e-12)
    assert fire(VLP32C)[29, 2] == pytest.approx(np.sin(np.radians(15.0)))


@pytest.mark.parametrize("name", SENSORS)
def test_every_sensor_has_an_offset_for_each_beam_and_unit_directions(name):
    sensor = SENSORS[name]
    assert len(sensor.azimuth_offset_deg) == sensor.n_beams
    assert np.linalg.norm(fire(sensor, step_deg=10.0), axis=1) == pytest.approx(1.0)


def test_a_wall_at_ten_metres_is_hit_at_its_range():
    directions = fire(VLP32C, start_deg=30.0)
    hits = cast_rays(wall(10.0), directions)
    ahead = directions[hits.ray_ids, 0]
    assert set(hits.ray_ids % 32) == set(range(32))
    assert hits.range_m == pytest.approx(10.0 / ahead, rel=1e-5)
    assert hits.cos_incidence == pytest.approx(ahead, rel=1e-5)


def test_a_ray_that_meets_nothing_has_no_row():
    ahead = [1.0, 0.0, 0.1]
    behind = [-1.0, 0.0, 0.0]
    up = [0.0, 0.0, 1.0]
    assert cast_rays(wall(10.0), np.array([behind, ahead, up])).ray_ids.tolist() == [1]


def test_the_nearer_of_two_walls_hides_the_other():
    near = [[5.0, -1, -1], [5, 1, -1], [5, 0, 2]]
    far = [[9.0, -9, -9], [9, 9, -9], [9, 0, 20]]
    hits = cast_rays(np.array([far, near]), np.array([[1.0, 0, 0]]))
    assert hits.face_ids.tolist() == [1]
    assert hits.range_m == pytest.approx([5.0])


def test_ranges_are_multiples_of_the_quantum_with_three_centimetres_of_noise():
    reported = measure_ranges(VLP32C, np.full(20_000, 12.3), np.random.default_rng(0))
    assert np.abs(reported / 0.004 - np.round(reported / 0.004)).max() < 1e-6
    assert reported.mean() == pytest.approx(12.3, abs=0.001)
    assert reported.std() == pytest.approx(0.03, rel=0.03)


def test_dropout_grows_with_range():
    range_m = np.arange(1.0, 200.0)
    kept = return_probability(
        VLP32C, range_m, np.ones_like(range_m), np.full_like(range_m, 0.3)
    )
    assert (np.diff(kept) <= 0).all()
    assert kept[9] > 0.95 > 0.5 > kept[99] > 0.01


def test_dark_and_grazed_surfaces_answer_less():
    at = np.full(3, 40.0)
    white, dark, grazed = return_probability(
        VLP32C, at, np.array([1.0, 1.0, 0.1]), np.array([0.8, 0.1, 0.8])
    )
    assert white > grazed > 0
    assert white > dark > 0


def test_a_white_wall_that_faces_the_sensor_answers_63_percent_at_the_signal_range():
    kept = return_probability(VLP32C, np.array([VLP32C.signal_range_m]), np.ones(1), np.ones(1))
    assert kept == pytest.approx((1 - VLP32C.lost_share) * (1 - np.exp(-1)))


def test_without_embreex_the_error_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "embreex", None)
    with pytest.raises(FidpipeError, match=r'pip install "fidpipe\[synth\]"'):
        cast_rays(wall(10.0), np.eye(3))


EXACT = SensorModel("exact", (), (), 0.4, 0.5, 100.0, 0.0, 0.0, 0.0, 60.0)


def plane(normal, distance_m, half_m=9.0, step_m=0.15):
    """Evenly spread points of a plane at a distance along its normal."""
    n = np.asarray(normal, dtype=float) / np.linalg.norm(normal)
    u = np.cross(n, [0.0, 0.0, 1.0] if abs(n[2]) < 0.9 else [1.0, 0.0, 0.0])
    u /= np.linalg.norm(u)
    steps = np.arange(-half_m, half_m, step_m)
    a, b = np.meshgrid(steps, steps)
    return distance_m * n + a.reshape(-1, 1) * u + b.reshape(-1, 1) * np.cross(n, u), n


def extended(voxels, points):
    return extend_map(voxels, points, np.ones(len(points)))


def scan(points, directions, sensor=EXACT):
    return rescan(extended(EMPTY_MAP, points), directions, sensor, seeded())[0]


@pytest.mark.parametrize("normal", [(1, 0, 0), (1, 2, 0.3), (0.9, 0.3, -0.4)])
def test_a_plane_scanned_again_is_that_plane_within_a_millimetre(normal):
    points, n = plane(normal, 6.0)
    directions = fire(SENSORS["hdl64"], step_deg=0.8)
    aimed = directions[directions @ n > 0.75]
    again = scan(points, aimed)
    assert len(again) == len(aimed) > 300
    np.testing.assert_allclose(again @ n, 6.0, atol=1e-3)


def test_a_rough_plane_scanned_again_lies_in_its_middle_and_not_before_it():
    points, n = plane((1, 0, 0), 8.0, step_m=0.06)
    rough = points + seeded().normal(0, 0.03, (len(points), 1)) * n
    directions = fire(SENSORS["hdl64"], step_deg=0.8)
    again = scan(rough, directions[directions @ n > 0.9])
    assert (again @ n).mean() == pytest.approx(8.0, abs=0.005)
    assert (again @ n).std() < 0.03


def test_rays_meet_the_nearer_of_two_walls_and_see_the_other_beside_it():
    near, _ = plane((1, 0, 0), 5.0, half_m=1.0)
    far, _ = plane((1, 0, 0), 12.0)
    again = scan(
        np.vstack([near, far]),
        np.array([[1.0, 0, 0], [1, 0.02, 0.1], [1, 0.5, 0]]) / [[1.0], [1.005], [1.118]],
    )
    assert again[:, 0] == pytest.approx([5.0, 5.0, 12.0], abs=0.06)


def test_a_ray_that_meets_nothing_gives_no_point():
    points, _ = plane((1, 0, 0), 5.0)
    assert len(scan(points, np.array([[-1.0, 0, 0], [0, 0, 1]]))) == 0
    assert len(rescan(EMPTY_MAP, np.eye(3), EXACT, seeded())[0]) == 0


def test_noise_and_losses_are_those_of_the_sensor():
    points, n = plane((1, 0, 0), 6.0, step_m=0.09)
    directions = fire(SENSORS["hdl64"], step_deg=0.2)
    directions = directions[directions @ n > 0.8]
    sensor = SensorModel("rough", (), (), 0.2, 0.5, 100.0, 0.05, 0.004, 0.3, 60.0)
    again = scan(points, directions, sensor)
    assert len(again) / len(directions) == pytest.approx(0.7, abs=0.01)
    range_m = np.linalg.norm(again, axis=1)
    off_m = range_m - 6.0 / (again @ n / range_m)
    assert off_m.std() == pytest.approx(0.05, rel=0.05)
    np.testing.assert_allclose(range_m / 0.004, np.round(range_m / 0.004), atol=1e-6)
    assert (
        len(
            scan(
                points,
                directions,
                SensorModel("near", (), (), 0.2, 0.5, 5.0, 0.0, 0.0, 0.0, 60.0),
            )
        )
        == 0
    )


def test_the_order_of_the_points_of_a_scan_changes_the_twin_by_rounding_alone():
    points = np.vstack([plane((1, 0, 0), 6.0)[0], box([4, 3, 0], [1, 1, 1], 900)])
    directions = fire(SENSORS["hdl64"], step_deg=1.0)
    a = scan(points, directions)
    b = scan(points[seeded().permutation(len(points))], directions)
    np.testing.assert_allclose(a, b, atol=1e-6)


def test_the_map_grows_with_the_surface_and_not_with_the_scans():
    points, _ = plane((0, 0, -1), 1.7, half_m=12.0, step_m=0.05)
    voxels = EMPTY_MAP
    sizes = []
    for seed in range(4):
        voxels = extended(
            voxels, points + seeded(seed).uniform(-0.02, 0.02, (len(points), 3)) * [1, 1, 0]
        )
        sizes.append(len(voxels))
    assert sizes[-1] < 1.05 * sizes[0]
    assert voxels[:, 4].sum() == 4 * len(points)
    np.testing.assert_allclose(voxels[:, 2], -1.7)


def test_voxels_are_wider_farther_away():
    near = plane((1, 0, 0), 6.0, half_m=3.0, step_m=0.05)[0]
    far = plane((1, 0, 0), 50.0, half_m=3.0, step_m=0.05)[0]
    sizes = [len(extended(EMPTY_MAP, points)) for points in (near, far)]
    assert sizes[0] / sizes[1] == pytest.approx(16, rel=0.2)


def test_a_ray_has_the_intensity_of_the_surface_that_it_hits():
    wall = plane((1, 0, 0), 9.0)[0]
    tree = box([5, 0, 0], [0.6, 0.6, 0.6], 2000)
    intensity = np.repeat([10.0, 40.0], [len(wall), len(tree)])
    voxels = extend_map(EMPTY_MAP, np.vstack([wall, tree]), intensity)
    again, seen = rescan(voxels, np.array([[1.0, 0, 0], [0.8, 0.6, 0]]), EXACT, seeded())
    assert seen == pytest.approx([40.0, 10.0])
    assert again[:, 0] == pytest.approx([4.7, 9.0], abs=0.1)


def test_recorded_beams_are_those_of_the_scan_and_where_it_saw_nothing_those_of_the_others():
    everything = fire(SENSORS["hdl64"], step_deg=0.2)
    azimuth = np.arctan2(everything[:, 1], everything[:, 0])
    is_seen = np.abs(azimuth) < 2.0  # nothing is met behind the sensor
    own = 20.0 * everything[is_seen]
    others = 30.0 * np.vstack(
        [everything + seeded(i).normal(0, 0.004, everything.shape) for i in range(4)]
    )
    directions = recorded_directions(own, others)
    np.testing.assert_allclose(directions[: len(own)], everything[is_seen])
    np.testing.assert_allclose(np.linalg.norm(directions, axis=1), 1.0)
    added = directions[len(own) :]
    assert (
        np.abs(np.arctan2(added[:, 1], added[:, 0])) > 2.0
    ).mean() > 0.95  # some look over the uppermost ring
    assert len(directions) == pytest.approx(len(everything), rel=0.1)
