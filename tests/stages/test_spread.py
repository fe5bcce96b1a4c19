import numpy as np
import pytest

from fidpipe.stages.statistics.spread import spread


def test_a_score_without_noise_tells_any_difference():
    found = spread(np.array([[0.5, 0.5, 0.5], [0.7, 0.7, 0.7]]))
    assert found.mean == pytest.approx(0.6)
    assert (found.std_seeds, found.least_pair, found.least_dataset) == pytest.approx((0, 0, 0), abs=1e-12)
    assert found.std_pairs == pytest.approx(np.std([0.5, 0.7], ddof=1))


def test_deviations_within_pairs_are_pooled_by_hand():
    # within: sqrt(2) and sqrt(8); their root mean square sqrt(5); means 2 and 10
    found = spread(np.array([[1.0, 3.0], [8.0, 12.0]]))
    assert found.std_seeds == pytest.approx(5**0.5)
    assert found.std_pairs == pytest.approx(32**0.5)
    assert found.least_dataset == pytest.approx(found.least_pair / 2**0.5)


def test_nulls_are_left_out():
    found = spread(np.array([[1.0, np.nan, 3.0], [np.nan, np.nan, np.nan], [4.0, np.nan, np.nan]]))
    assert (found.mean, found.std_seeds) == (pytest.approx(3), pytest.approx(2**0.5))
    nothing = spread(np.full((2, 3), np.nan))
    assert set(vars(nothing).values()) == {None}


@pytest.mark.parametrize(("n_pairs", "n_seeds"), [(1, 2), (1, 5), (3, 2), (5, 5)])
def test_the_repeatability_limit_covers_19_of_20_differences_however_few_the_repeats(n_pairs, n_seeds):
    rng = np.random.default_rng(1)
    n = 2000
    found = [spread(rng.normal(0, 0.2, (n_pairs, n_seeds))) for _ in range(n)]
    one, means = (np.abs(np.diff(rng.normal(0, 0.2 / k**0.5, (n, 2)))).ravel() for k in (1, n_pairs))
    error = 3 * (0.05 * 0.95 / n) ** 0.5
    assert np.mean(one < [own.least_pair for own in found]) == pytest.approx(0.95, abs=error)
    assert np.mean(means < [own.least_dataset for own in found]) == pytest.approx(0.95, abs=error)
    known = 1.959963984540054 * 2**0.5
    covered_before = np.mean(one < [known * own.std_seeds for own in found])
    assert covered_before < 0.95 - error
    assert (covered_before < 0.75) == (n_pairs * (n_seeds - 1) == 1)
