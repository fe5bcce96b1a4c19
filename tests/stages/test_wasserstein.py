import numpy as np
import pytest
from scipy.optimize import linear_sum_assignment, linprog
from scipy.spatial.distance import cdist

from fidpipe.stages.baselines.emd import aligned_distance, earth_movers
from fidpipe.stages.baselines.sliced_wasserstein import sliced_wasserstein
from scenes import moved, rigid


def transport(a, b):
    """The definition itself: the least cost of all flows that empty every point of a and fill every point of b."""
    n, m = len(a), len(b)
    leaves, reaches = np.kron(np.eye(n), np.ones(m)), np.kron(np.ones(n), np.eye(m))
    shares = np.concatenate([np.full(n, 1 / n), np.full(m, 1 / m)])
    return linprog(cdist(a, b).ravel(), A_eq=np.vstack([leaves, reaches]), b_eq=shares).fun


def test_earth_movers_by_hand():
    # crossing over costs 3 and 1, staying 1 and 1 (in the second coordinate)
    a, b = np.array([[0.0, 0, 0], [2, 0, 0]]), np.array([[2.0, 1, 0], [0, 1, 0]])
    assert earth_movers(a, b) == 1


def test_earth_movers_of_a_wall_that_lost_its_last_post_by_hand():
    # posts at 0, 1, 2, 3 m hold 1/4 each, at 0, 1, 2 m 1/3: 3/12 go from 3 to 2, 2/12 from 2 to 1, 1/12 from 1 to 0
    posts = np.array([[0.0, 5, 1], [1, 5, 1], [2, 5, 1], [3, 5, 1]])
    assert earth_movers(posts, posts[:3]) == pytest.approx(6 / 12, abs=1e-15)
    assert earth_movers(posts[:3], posts) == pytest.approx(6 / 12, abs=1e-15)


@pytest.mark.parametrize(("n", "m"), [(1, 1), (1, 5), (3, 7), (8, 6), (12, 12), (13, 29)])
def test_earth_movers_agrees_with_a_linear_programme(rng, n, m):
    a, b = rng.normal(0, 1, (n, 3)), rng.normal(1, 2, (m, 3))
    assert earth_movers(a, b) == pytest.approx(transport(a, b), abs=1e-9)


@pytest.mark.parametrize("n", [2, 50, 700])
def test_earth_movers_of_equal_sizes_agrees_with_the_best_assignment(rng, n):
    a = rng.uniform(0, 3, (n, 3))
    b = rng.uniform(0, 3, (n, 3)) * [1, 0.5, 1] + [4, 0, 0]
    distances = cdist(a, b)
    assert earth_movers(a, b) == pytest.approx(distances[linear_sum_assignment(distances)].mean(), abs=1e-9)


def test_earth_movers_of_a_set_with_itself_is_nothing_whatever_the_order_and_however_often_each_point_stands(rng):
    a = rng.normal(0, 1, (90, 3))
    assert earth_movers(a, a) == 0
    assert earth_movers(a, a[::-1].copy()) == 0
    assert earth_movers(a, np.vstack([a, a, a])) == 0
    assert earth_movers(np.ones((4, 3)), np.ones((7, 3))) == 0


def test_earth_movers_of_a_shift_is_its_length_and_of_a_common_motion_the_same(rng):
    a, b = rng.normal(0, 1, (60, 3)), rng.normal(1, 2, (41, 3))
    assert earth_movers(a, a + [2, 3, 6]) == pytest.approx(7, abs=1e-9)
    turn = rigid(40, [500_000.0, 4_000_000.0, 3.0])
    assert earth_movers(moved(a, turn), moved(b, turn)) == pytest.approx(earth_movers(a, b), abs=1e-8)
    assert earth_movers(b, a) == pytest.approx(earth_movers(a, b), abs=1e-12)


def test_the_aligned_distance_is_row_by_row():
    assert aligned_distance(np.zeros((2, 3)), np.array([[3.0, 4, 0], [0, 0, 1]])) == 3


def test_sliced_wasserstein_of_a_shift_is_half_of_it():
    # the mean of |cos| of the angle between a fixed vector and a random direction in space is 1/2
    points = np.random.default_rng(0).normal(0, 1, (30, 3))
    assert sliced_wasserstein(points, points + [0, 0, 4], 4000) == pytest.approx(2, rel=0.03)
