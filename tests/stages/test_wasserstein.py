import itertools
import math

import numpy as np
import ot
import pytest
from scipy.spatial.distance import cdist
from scipy.stats import wasserstein_distance

from fidpipe.stages.baselines.emd import aligned_distance, earth_movers
from fidpipe.stages.baselines.sliced_wasserstein import sliced_wasserstein


def test_earth_movers_by_hand():
    # crossing over costs 3 and 1, staying 1 and 1 (in the second coordinate)
    a, b = np.array([[0.0, 0, 0], [2, 0, 0]]), np.array([[2.0, 1, 0], [0, 1, 0]])
    assert earth_movers(a, b) == 1


def test_earth_movers_agrees_with_all_permutations(rng):
    a, b = rng.normal(0, 1, (7, 3)), rng.normal(1, 2, (7, 3))
    totals = (sum(map(math.dist, a, b[list(order)])) for order in itertools.permutations(range(7)))
    assert earth_movers(a, b) == pytest.approx(min(totals) / 7)


def test_earth_movers_of_a_large_displaced_set_agrees_with_dense_transport(rng):
    a = rng.uniform(0, 3, (700, 3))
    b = rng.uniform(0, 3, (700, 3)) * [1, 0.5, 1] + [4, 0, 0]
    weights = np.full(700, 1 / 700)
    assert earth_movers(a, b) == pytest.approx(ot.emd2(weights, weights, cdist(a, b)), abs=1e-9)


def test_the_aligned_distance_is_row_by_row():
    assert aligned_distance(np.zeros((2, 3)), np.array([[3.0, 4, 0], [0, 0, 1]])) == 3


def test_sliced_wasserstein_of_a_shift_is_half_of_it():
    # the mean of |cos| of the angle between a fixed vector and a random direction in space is 1/2
    points = np.random.default_rng(0).normal(0, 1, (30, 3))
    assert sliced_wasserstein(points, points + [0, 0, 4], 4000) == pytest.approx(2, rel=0.03)


def test_sliced_wasserstein_of_unequal_sizes_agrees_with_scipy_direction_by_direction(rng):
    real, sim = rng.normal(0, 1, (40, 3)), rng.normal(0.5, 2, (65, 3))
    directions = np.random.default_rng(0).standard_normal((25, 3))
    by_scipy = [wasserstein_distance(real @ u, sim @ u) / np.linalg.norm(u) for u in directions]
    assert sliced_wasserstein(real, sim, 25) == pytest.approx(np.mean(by_scipy))


def test_sliced_wasserstein_is_at_most_the_earth_movers_distance(rng):
    a, b = rng.normal(0, 1, (50, 3)), rng.normal(1, 2, (50, 3))
    assert 0 < sliced_wasserstein(a, b, 200) < earth_movers(a, b)
    assert sliced_wasserstein(a, a, 200) == 0
