"""Flaws and perturbations: each does what its name says, by the amount that is given, and nothing else."""

import numpy as np
import pytest
from scipy.spatial import cKDTree

from fidpipe.stages.generate.flaws import FLAWS, Perturbation, is_foliage, perturb
from fidpipe.stages.generate.second_measurement import fill_gaps, remeasure
from fidpipe.stages.surfels import fit_planes
from scenes import box, road, seeded
from wrong_beams import misalign_beams

NOTHING = {name: 1.0 if name == "density" else 0.0 for name in FLAWS}
SOME = {"holes": 5, "mirrored": 1, "yaw": 3.0, "blur": 0.4, "offset": 0.2, "noise": 0.1}


def ring_scan(seed=0):
    """32 rings of a flat road 1.7 m below the sensor and of a wall across it, 30 m ahead."""
    elevation, azimuth = np.meshgrid(
        np.radians(np.linspace(-20, 5, 32)), np.radians(np.arange(0, 360, 0.4))
    )
    u = np.stack(
        [
            np.cos(elevation) * np.cos(azimuth),
            np.cos(elevation) * np.sin(azimuth),
            np.sin(elevation),
        ],
        axis=-1,
    ).reshape(-1, 3)
    with np.errstate(divide="ignore"):
        to_road = np.where(u[:, 2] < 0, -1.7 / u[:, 2], np.inf)
        to_wall = np.where(u[:, 0] > 0, 30.0 / u[:, 0], np.inf)
    range_m = np.minimum(to_road, to_wall)
    return (u * range_m[:, None])[range_m < 60]


def crown(n=2000, centre=(8.0, 3.0, 2.0)):
    return np.asarray(centre) + seeded(1).normal(0, 0.8, (n, 3))


@pytest.fixture(scope="module")
def cloud():
    return np.vstack([ring_scan(), crown()])


@pytest.mark.parametrize("name", FLAWS)
def test_an_amount_of_nothing_changes_nothing(name, cloud):
    np.testing.assert_allclose(FLAWS[name](cloud, NOTHING[name], seeded()), cloud, atol=1e-9)


@pytest.mark.parametrize("name", FLAWS)
def test_the_same_seed_gives_the_same_points_and_the_argument_stays_as_it_was(name, cloud):
    before = cloud.copy()
    a = FLAWS[name](cloud, SOME.get(name, 0.5), seeded())
    b = FLAWS[name](cloud, SOME.get(name, 0.5), seeded())
    np.testing.assert_array_equal(a, b)
    np.testing.assert_array_equal(cloud, before)
    assert len(a) != len(cloud) or np.abs(a - cloud).max() > 1e-3


@pytest.mark.parametrize("name", FLAWS)
def test_no_points_stay_no_points_and_three_can_have_every_flaw(name):
    assert FLAWS[name](np.empty((0, 3)), SOME.get(name, 0.5), seeded()).shape == (0, 3)
    altered = FLAWS[name](np.eye(3) * 30.0, SOME.get(name, 0.5), seeded())
    assert altered.shape[1] == 3
    assert np.isfinite(altered).all()


def test_far_dropout_loses_its_share_beyond_the_range_and_nothing_nearer(cloud):
    left = FLAWS["far-dropout"](cloud, 0.6, seeded())
    range_m, left_m = np.linalg.norm(cloud, axis=1), np.linalg.norm(left, axis=1)
    assert (left_m <= 25).sum() == (range_m <= 25).sum()
    assert (left_m > 25).sum() / (range_m > 25).sum() == pytest.approx(0.4, abs=0.03)
    near = FLAWS["far-dropout"](cloud, 1.0, seeded())
    assert np.linalg.norm(near, axis=1).max() <= 25


def test_a_hole_is_a_ball_about_a_point_of_the_scan(cloud):
    left = FLAWS["holes"](cloud, 1, seeded())
    lost = cloud[cKDTree(left).query(cloud)[0] > 0]
    centre = cloud[seeded().integers(len(cloud), size=1)][0]
    assert len(lost) == (np.linalg.norm(cloud - centre, axis=1) <= 1.5).sum() > 0
    assert len(FLAWS["holes"](cloud, 12, seeded())) < len(left)


def test_foliage_is_distinguished_from_a_road_and_a_wall_by_its_scattering(cloud):
    found = is_foliage(cloud)
    assert found[-2000:].mean() > 0.95
    assert found[:-2000].mean() < 0.03


def test_lost_foliage_goes_in_clumps_and_nothing_else_goes(cloud):
    left = FLAWS["foliage"](cloud, 0.3, seeded())
    leaves = cloud[is_foliage(cloud)]
    assert len(left) == len(cloud) - round(0.3 * len(leaves))
    is_lost = cKDTree(left).query(leaves)[0] > 0
    neighbour = cKDTree(leaves).query(leaves[is_lost], k=2)[1][:, 1]
    assert is_lost.sum() == len(cloud) - len(left)
    assert is_lost[neighbour].mean() > 0.7  # of a dropout it would be 0.3


def test_blur_leaves_a_plane_and_rounds_the_corner_of_two():
    floor = np.stack(
        np.meshgrid(np.arange(0, 4, 0.05), np.arange(0, 4, 0.05), [0.0]), axis=-1
    ).reshape(-1, 3)
    wall = floor[:, [2, 1, 0]]
    corner = np.unique(np.vstack([floor, wall]), axis=0)
    blurred = FLAWS["blur"](corner, 0.4, seeded())
    np.testing.assert_allclose(FLAWS["blur"](floor, 0.4, seeded()), floor, atol=1e-12)
    at_edge = np.hypot(corner[:, 0], corner[:, 2]) < 1e-9
    inner = at_edge & (np.abs(corner[:, 1] - 2) < 1)
    assert (np.hypot(blurred[inner, 0], blurred[inner, 2]) > 0.05).all()
    far = (np.hypot(corner[:, 0], corner[:, 2]) > 0.6) & (np.abs(corner[:, 1] - 2) < 1)
    np.testing.assert_allclose(blurred[far], corner[far], atol=1e-9)


def test_blur_takes_roughness_and_the_thickness_of_what_is_thin():
    rough = road(4000, half_width=6.0)
    assert FLAWS["blur"](rough, 0.8, seeded())[:, 2].std() < 0.5 * rough[:, 2].std()
    board = box([9, 0, 0], [0.2, 4, 2], 4000)
    assert FLAWS["blur"](board, 0.8, seeded())[:, 0].std() < 0.3 * board[:, 0].std()


def test_wrong_beams_look_elsewhere_and_meet_the_same_surfaces():
    scan = ring_scan()
    altered = misalign_beams(scan, 0.3, seeded())
    turned_deg = np.degrees(
        np.arctan2(altered[:, 2], np.hypot(*altered[:, :2].T))
        - np.arctan2(scan[:, 2], np.hypot(*scan[:, :2].T))
    )
    assert np.abs(turned_deg).mean() == pytest.approx(0.3 * np.sqrt(2 / np.pi), rel=0.4)
    np.testing.assert_allclose(
        np.arctan2(altered[:, 1], altered[:, 0]), np.arctan2(scan[:, 1], scan[:, 0]), atol=1e-9
    )
    is_road = (np.abs(scan[:, 2] + 1.7) < 1e-9) & (np.linalg.norm(scan, axis=1) < 12)
    np.testing.assert_allclose(altered[is_road, 2], -1.7, atol=1e-6)
    is_wall = (np.abs(scan[:, 0] - 30) < 1e-9) & (np.abs(scan[:, 1]) < 10) & (scan[:, 2] > -1)
    assert np.median(np.abs(altered[is_wall, 0] - 30)) < 1e-6
    # One error per beam: points of one elevation turn by the same angle.
    ring = np.abs(np.degrees(np.arcsin(scan[:, 2] / np.linalg.norm(scan, axis=1))) + 20) < 0.01
    assert np.ptp(turned_deg[ring]) < 1e-9


def test_local_planes_agree_with_one_place_after_the_other(rng):
    points, places = rng.normal(size=(300, 3)), rng.normal(size=(20, 3))
    planes = fit_planes(points, places, 30, 0.9)
    for i, place in enumerate(places):
        apart = np.linalg.norm(points - place, axis=1)
        near = [j for j in np.argsort(apart)[:30] if apart[j] <= 0.9]
        assert planes.n_neighbours[i] == len(near)
        if len(near) >= 4:
            weight = np.exp(-((2 * apart[near] / 0.9) ** 2))
            mean = (weight[:, None] * points[near]).sum(axis=0) / weight.sum()
            covariance = (
                sum(
                    w * np.outer(p - mean, p - mean)
                    for w, p in zip(weight, points[near], strict=True)
                )
                / weight.sum()
            )
            variance, axes = np.linalg.eigh(covariance)
            np.testing.assert_allclose(planes.mean[i], mean, atol=1e-9)
            np.testing.assert_allclose(planes.variance[i], variance, atol=1e-9)
            assert abs(planes.normal[i] @ axes[:, 0]) == pytest.approx(1)


def test_a_place_without_neighbours_is_its_own_mean():
    planes = fit_planes(np.zeros((5, 3)), np.array([[9.0, 0, 0]]), 5, 1.0)
    assert planes.n_neighbours.tolist() == [0]
    np.testing.assert_allclose(planes.mean, [[9.0, 0, 0]])


@pytest.fixture
def cube(rng):
    return rng.uniform([-5, -5, 0], [5, 5, 3], (4000, 3))


def test_noise_has_the_wanted_deviation_on_each_coordinate(cube):
    apart = perturb(cube, Perturbation("noise", 0.1), seeded()) - cube
    np.testing.assert_allclose(apart.std(axis=0), 0.1, rtol=0.05)
    np.testing.assert_allclose(apart.mean(axis=0), 0, atol=0.01)


def test_dropout_loses_the_wanted_share_and_keeps_the_order_of_the_rest(cube):
    left = perturb(cube, Perturbation("dropout", 0.4), seeded())
    assert len(left) == pytest.approx(2400, abs=4 * np.sqrt(4000 * 0.4 * 0.6))
    rows = cKDTree(cube).query(left)[1]
    np.testing.assert_array_equal(cube[rows], left)
    assert (np.diff(rows) > 0).all()


def test_a_rotation_turns_about_the_vertical_through_the_sensor():
    east = np.array([[10.0, 0, 2], [0, 0, 5]])
    turned = perturb(east, Perturbation("rigid", 90.0), seeded())
    np.testing.assert_allclose(turned, [[0, 10, 2], [0, 0, 5]], atol=1e-12)


def test_a_translation_is_horizontal_of_the_wanted_length_and_in_a_seeded_direction(cube):
    shifts = [
        perturb(cube, Perturbation("rigid", 0.0, 0.05), seeded(seed)) - cube for seed in (1, 2)
    ]
    for shift in shifts:
        np.testing.assert_allclose(shift, np.broadcast_to(shift[0], shift.shape), atol=1e-12)
        assert shift[0, 2] == 0
        assert np.linalg.norm(shift[0]) == pytest.approx(0.05)
    assert np.abs(shifts[0] - shifts[1]).max() > 1e-3


def test_hallucination_adds_the_wanted_share_in_clusters_near_the_points(cube):
    more = perturb(cube, Perturbation("hallucination", 0.05), seeded())
    np.testing.assert_array_equal(more[:4000], cube)
    added = more[4000:].reshape(10, 20, 3)
    assert (np.abs(added.std(axis=1) - 0.15) < 0.1).all()
    to_cloud, _ = cKDTree(cube).query(added.mean(axis=1))
    assert (to_cloud < 0.5 + 4 * 0.15).all()


def test_a_density_of_zero_empties_regions_that_hold_three_tenths_of_the_points(cube):
    left = perturb(cube, Perturbation("density", 0.0), seeded())
    assert len(left) == 2800
    lost = cube[cKDTree(left).query(cube)[0] > 0]
    # The lost points are neighbours of one another, unlike those of a dropout.
    nearest = cKDTree(cube).query(lost, k=2)[1][:, 1]
    assert np.isin(nearest, np.flatnonzero(cKDTree(left).query(cube)[0] > 0)).mean() > 0.8


def test_a_higher_density_adds_points_on_the_surface(rng):
    wall = np.column_stack(
        [rng.uniform(0, 8, 1000), np.full(1000, 3.0), rng.uniform(0, 3, 1000)]
    )
    denser = perturb(wall, Perturbation("density", 4.0), seeded())
    np.testing.assert_array_equal(denser[:1000], wall)
    assert len(denser) == 1000 + 3 * 300
    np.testing.assert_allclose(denser[1000:, 1], 3.0)
    assert cKDTree(wall).query(denser[1000:])[0].max() < 0.5


def test_the_null_row_loses_one_point_and_keeps_the_others_in_another_order(rng):
    points = rng.normal(size=(50, 3))
    left = perturb(points, Perturbation("null", 1.0), rng)
    kept = {tuple(point) for point in left}
    assert len(left) == len(kept) == 49
    assert kept < {tuple(point) for point in points}
    assert not np.array_equal(left, points[:49])


def test_lost_pulses_return_between_their_neighbours_evenly_in_direction_and_range():
    ends = np.array([[9.0, 0, 0], [2, 0, 0], [0, 12, 0]])  # 90 degrees and 3 m apart
    filled, rows = fill_gaps(ends, np.array([[0, 2], [1, 2]]), np.array([1, 2]))
    half = np.sqrt(0.5)
    third = 1 / np.sqrt(5)
    np.testing.assert_allclose(filled[0], [10.5 * half, 10.5 * half, 0])
    np.testing.assert_allclose(filled[1], (2 + 10 / 3) * third * np.array([2, 1, 0]))
    np.testing.assert_allclose(filled[2], (2 + 20 / 3) * third * np.array([1, 2, 0]))
    assert rows.tolist() == [2, 1, 2]


def test_a_second_measurement_moves_points_along_their_rays_alone(cube):
    away = cube + [20, 0, 0]
    again, rows = remeasure(away, 0.03, 0.0, seeded())
    ranges = [np.linalg.norm(points, axis=1) for points in (away, again)]
    np.testing.assert_array_equal(rows, np.arange(len(cube)))
    np.testing.assert_allclose(
        again / ranges[1][:, None], away / ranges[0][:, None], atol=1e-12
    )
    assert (ranges[1] - ranges[0]).std() == pytest.approx(0.03, rel=0.05)


def test_a_second_measurement_loses_the_wanted_share_and_says_which_points_stay(cube):
    away = cube + [20, 0, 0]
    again, rows = remeasure(away, 0.0, 0.1, seeded())
    assert len(rows) == pytest.approx(3600, abs=4 * np.sqrt(4000 * 0.1 * 0.9))
    np.testing.assert_array_equal(again, away[rows])
    assert set(remeasure(away, 0.0, 0.3, seeded())[1]) < set(rows)
