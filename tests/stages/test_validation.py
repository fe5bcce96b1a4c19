import numpy as np
import pytest

from fidpipe.stages.statistics.validation import area_validation_metric, double_validation_metric


def test_bias_and_area_by_hand():
    # 0, 0, 4 (mean 4/3) against 2, 2, 3 (mean 7/3): without the bias of 1 left are 1, 1, 2 against 0, 0, 4
    found = double_validation_metric(np.array([0.0, 4, 0]), np.array([2.0, 3, 2]))
    assert found.bias == pytest.approx(1)
    assert found.area == pytest.approx((1 + 1 + 2) / 3)
    assert area_validation_metric(np.array([0.0, 4, 0]), np.array([2.0, 3, 2])) == pytest.approx((2 + 2 + 1) / 3)


def test_the_bias_is_the_signed_area_and_the_area_that_of_the_shapes(rng):
    real, sim = rng.normal(0, 1, 40), rng.normal(0, 2, 60)
    found, shifted = (double_validation_metric(real, own) for own in (sim, sim - 5))
    assert shifted.bias == pytest.approx(found.bias - 5)
    assert shifted.area == pytest.approx(found.area)
    assert area_validation_metric(real, sim - 50) == pytest.approx(50 - found.bias)  # nowhere do they cross
    scaled = double_validation_metric(3 * real, 3 * sim)
    assert (scaled.bias, scaled.area) == pytest.approx((3 * found.bias, 3 * found.area))
    back = double_validation_metric(sim, real)
    assert (back.bias, back.area) == pytest.approx((-found.bias, found.area))


def test_the_same_values_are_no_distance_apart_and_nulls_are_left_out(rng):
    values = rng.normal(0, 1, 30)
    same = double_validation_metric(values, rng.permutation(np.append(values, np.nan)))
    assert (same.bias, same.area) == pytest.approx((0, 0), abs=1e-15)
    exact = double_validation_metric(values, values)
    assert (exact.bias, exact.area, exact.n_real, exact.n_sim) == (0, 0, 30, 30)
    nothing = double_validation_metric(values, np.full(3, np.nan))
    assert (nothing.bias, nothing.area, nothing.n_sim) == (None, None, 0)
    assert area_validation_metric(values[:0], values) is None


def test_the_area_of_one_distribution_shrinks_with_the_square_root_of_the_sizes():
    rng = np.random.default_rng(0)
    few, many = (
        np.mean([double_validation_metric(*rng.normal(0, 1, (2, n))).area for _ in range(400)]) for n in (10, 160)
    )
    assert few > 0.2
    assert few / many == pytest.approx(4, rel=0.15)
