import math

import numpy as np
import pytest

from fidpipe.stages.baselines.chamfer import chamfer
from fidpipe.stages.baselines.dcd import density_aware_chamfer
from fidpipe.stages.baselines.f_score import f_score
from fidpipe.stages.baselines.hausdorff import hausdorff

REAL = np.array([[0.0, 0, 0], [1, 0, 0], [0, 2, 0]])
SIM = np.array([[0.0, 0, 1], [1, 0, 3]])
# nearest: real -> sim 1, sqrt 2, sqrt 5 (all to the first); sim -> real 1, 3


@pytest.fixture
def clouds(rng):
    return rng.normal(0, 1, (40, 3)), rng.normal(0.2, 1, (70, 3))


def test_chamfer_by_hand():
    distance = chamfer(REAL, SIM)
    assert distance.mean_m == pytest.approx((1 + math.sqrt(2) + math.sqrt(5)) / 3 + (1 + 3) / 2)
    assert distance.squared_m2 == pytest.approx((1 + 2 + 5) / 3 + (1 + 9) / 2)
    assert distance.one_way_sum_m == pytest.approx(1 + math.sqrt(2) + math.sqrt(5))


def test_hausdorff_by_hand_is_the_worst_point_of_either_side():
    assert hausdorff(REAL, SIM) == 3
    assert hausdorff(SIM, REAL) == 3


def test_f_score_by_hand():
    # within 1.2 m: one of three real points, one of two simulated ones
    assert f_score(REAL, SIM, 1.2) == pytest.approx(2 * (1 / 3) * (1 / 2) / (1 / 3 + 1 / 2))
    assert f_score(REAL, SIM, 0.9) == 0
    assert f_score(REAL, SIM, 10) == 1


def test_a_point_at_the_very_distance_is_not_found():
    assert f_score(REAL[:1], SIM[:1], 1.0) == 0


def test_dcd_of_equal_sizes_by_hand():
    # diagonal of the real box 1, so alpha is per square metre; both simulated points are nearest to the first real one
    real, sim = np.array([[0.0, 0, 0], [1, 0, 0]]), np.array([[-0.1, 0, 0], [0, 0.2, 0]])
    from_real = (1 - math.exp(-10 * 0.01) + 1 - math.exp(-10 * 1.04)) / 2  # to the first and to the second one
    from_sim = (1 - 0.5 * math.exp(-10 * 0.01) + 1 - 0.5 * math.exp(-10 * 0.04)) / 2
    distance = density_aware_chamfer(real, sim, 10)
    assert distance.dcd == pytest.approx((from_real + from_sim) / 2)
    assert distance.n_cut == 0


def test_dcd_of_unequal_sizes_cuts_the_weights_at_one_and_counts_them():
    # three real points for one simulated one: from the real side each weight is (3 / 1) / 3 = 1, from the simulated
    # side (1 / 3) / 1; with a second simulated point far off, its first neighbour weighs (3 / 2) / 3, the other none
    real = np.array([[0.0, 0, 0], [1, 0, 0], [0.5, 0, 0]])
    distance = density_aware_chamfer(real, np.array([[0.5, 0, 0]]), 1.0)
    from_real = np.mean([1 - math.exp(-0.25), 1 - math.exp(-0.25), 0])
    assert (distance.dcd, distance.n_cut) == (pytest.approx((from_real + 1 - 1 / 3) / 2), 0)
    # two of three real points at one simulated point, the third alone at the other: weights 3/4, 3/4 and 3/2, cut
    distance = density_aware_chamfer(real, np.array([[0.25, 0, 0], [1, 0, 0]]), 1.0)
    from_real = np.mean([1 - 0.75 * math.exp(-0.0625), 1 - 0.75 * math.exp(-0.0625), 0])
    from_sim = np.mean([1 - 2 / 3 * math.exp(-0.0625), 1 - 2 / 3])
    assert (distance.dcd, distance.n_cut) == (pytest.approx((from_real + from_sim) / 2), 1)


def test_dcd_does_not_depend_on_the_unit_of_length(clouds):
    real, sim = clouds
    assert density_aware_chamfer(9 * real, 9 * sim, 1000).dcd == pytest.approx(
        density_aware_chamfer(real, sim, 1000).dcd
    )


def test_dcd_of_a_single_real_place_cannot_be_computed():
    assert density_aware_chamfer(np.zeros((4, 3)), SIM, 1000) is None


def test_a_set_is_at_distance_zero_from_itself(clouds):
    real = clouds[0]
    assert vars(chamfer(real, real)) == {"mean_m": 0, "squared_m2": 0, "one_way_sum_m": 0}
    assert (hausdorff(real, real), f_score(real, real, 1e-9), density_aware_chamfer(real, real, 1000).dcd) == (0, 1, 0)
