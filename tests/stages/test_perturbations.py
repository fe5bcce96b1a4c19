"""Known alterations of points: what changes, by how much, and what does not."""

import numpy as np
import pytest
from scipy.spatial import cKDTree
from scipy.spatial.distance import pdist

from fidpipe.stages.generate.perturbations import KINDS, Perturbation, fill_gaps, perturb, remeasure
from scenes import seeded


@pytest.fixture
def cloud(rng):
    return rng.uniform([-5, -5, 0], [5, 5, 3], (4000, 3))


def test_noise_has_the_wanted_deviation_on_each_coordinate(cloud):
    apart = perturb(cloud, Perturbation("noise", 0.1), seeded()) - cloud
    np.testing.assert_allclose(apart.std(axis=0), 0.1, rtol=0.05)
    np.testing.assert_allclose(apart.mean(axis=0), 0, atol=0.01)


def test_dropout_loses_the_wanted_share_and_keeps_the_order_of_the_rest(cloud):
    left = perturb(cloud, Perturbation("dropout", 0.4), seeded())
    assert len(left) == pytest.approx(2400, abs=4 * np.sqrt(4000 * 0.4 * 0.6))
    rows = cKDTree(cloud).query(left)[1]
    np.testing.assert_array_equal(cloud[rows], left)
    assert (np.diff(rows) > 0).all()


def test_a_rotation_turns_about_the_vertical_through_the_sensor():
    east = np.array([[10.0, 0, 2], [0, 0, 5]])
    turned = perturb(east, Perturbation("rigid", 90.0), seeded())
    np.testing.assert_allclose(turned, [[0, 10, 2], [0, 0, 5]], atol=1e-12)


def test_a_translation_is_horizontal_of_the_wanted_length_and_in_a_seeded_direction(cloud):
    shifts = [perturb(cloud, Perturbation("rigid", 0.0, 0.05), seeded(seed)) - cloud for seed in (1, 2)]
    for shift in shifts:
        np.testing.assert_allclose(shift, np.broadcast_to(shift[0], shift.shape), atol=1e-12)
        assert shift[0, 2] == 0
        assert np.linalg.norm(shift[0]) == pytest.approx(0.05)
    assert np.abs(shifts[0] - shifts[1]).max() > 1e-3


def test_a_rigid_motion_keeps_all_distances(cloud):
    moved = perturb(cloud[:200], Perturbation("rigid", 2.0, 0.05), seeded())
    np.testing.assert_allclose(pdist(moved), pdist(cloud[:200]), rtol=1e-12)


def test_hallucination_adds_the_wanted_share_in_clusters_near_the_points(cloud):
    more = perturb(cloud, Perturbation("hallucination", 0.05), seeded())
    np.testing.assert_array_equal(more[:4000], cloud)
    added = more[4000:].reshape(10, 20, 3)
    assert (np.abs(added.std(axis=1) - 0.15) < 0.1).all()
    to_cloud, _ = cKDTree(cloud).query(added.mean(axis=1))
    assert (to_cloud < 0.5 + 4 * 0.15).all()


def test_a_density_of_zero_empties_regions_that_hold_three_tenths_of_the_points(cloud):
    left = perturb(cloud, Perturbation("density", 0.0), seeded())
    assert len(left) == 2800
    lost = cloud[cKDTree(left).query(cloud)[0] > 0]
    # The lost points are neighbours of one another, unlike those of a dropout.
    nearest = cKDTree(cloud).query(lost, k=2)[1][:, 1]
    assert np.isin(nearest, np.flatnonzero(cKDTree(left).query(cloud)[0] > 0)).mean() > 0.8


def test_a_higher_density_adds_points_on_the_surface(rng):
    wall = np.column_stack([rng.uniform(0, 8, 1000), np.full(1000, 3.0), rng.uniform(0, 3, 1000)])
    denser = perturb(wall, Perturbation("density", 4.0), seeded())
    np.testing.assert_array_equal(denser[:1000], wall)
    assert len(denser) == 1000 + 3 * 300
    np.testing.assert_allclose(denser[1000:, 1], 3.0)
    assert cKDTree(wall).query(denser[1000:])[0].max() < 0.5


@pytest.mark.parametrize("kind", KINDS)
def test_the_same_seed_gives_the_same_points_the_argument_stays_and_no_points_stay_none(kind, cloud):
    before = cloud.copy()
    a, b = (perturb(cloud, Perturbation(kind, 0.4, 0.1 if kind == "rigid" else 0.0), seeded()) for _ in range(2))
    np.testing.assert_array_equal(a, b)
    np.testing.assert_array_equal(cloud, before)
    assert perturb(np.empty((0, 3)), Perturbation(kind, 0.4), seeded()).shape == (0, 3)


@pytest.mark.parametrize(
    "nothing",
    [
        Perturbation("noise", 0.0),
        Perturbation("dropout", 0.0),
        Perturbation("rigid", 0.0),
        Perturbation("hallucination", 0.0),
        Perturbation("density", 1.0),
    ],
    ids=lambda nothing: nothing.kind,
)
def test_an_amount_of_nothing_changes_nothing(nothing, cloud):
    np.testing.assert_array_equal(perturb(cloud, nothing, seeded()), cloud)


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
    half, third = np.sqrt(0.5), 1 / np.sqrt(5)
    np.testing.assert_allclose(filled[0], [10.5 * half, 10.5 * half, 0])
    np.testing.assert_allclose(filled[1], (2 + 10 / 3) * third * np.array([2, 1, 0]))
    np.testing.assert_allclose(filled[2], (2 + 20 / 3) * third * np.array([1, 2, 0]))
    assert rows.tolist() == [2, 1, 2]


def test_a_second_measurement_moves_points_along_their_rays_alone(cloud):
    away = cloud + [20, 0, 0]
    again, rows = remeasure(away, 0.03, 0.0, seeded())
    ranges = [np.linalg.norm(points, axis=1) for points in (away, again)]
    np.testing.assert_array_equal(rows, np.arange(len(cloud)))
    np.testing.assert_allclose(again / ranges[1][:, None], away / ranges[0][:, None], atol=1e-12)
    assert (ranges[1] - ranges[0]).std() == pytest.approx(0.03, rel=0.05)


def test_a_second_measurement_loses_the_wanted_share_and_says_which_points_stay(cloud):
    away = cloud + [20, 0, 0]
    again, rows = remeasure(away, 0.0, 0.1, seeded())
    assert len(rows) == pytest.approx(3600, abs=4 * np.sqrt(4000 * 0.1 * 0.9))
    np.testing.assert_array_equal(again, away[rows])
    assert set(remeasure(away, 0.0, 0.3, seeded())[1]) < set(rows)
