"""The statistics of `benchmarks/power.py`: by hand, from tables, and by simulation."""

import numpy as np
import pytest

from power_analysis import effect_size, paired_t, pairs_needed, power


def test_t_by_hand_and_where_nothing_varies():
    assert paired_t(np.array([1.0, 2.0, np.nan, 6.0])) == pytest.approx(3 / (7**0.5 / 3**0.5))
    assert paired_t(np.array([-0.5, -0.5])) == -np.inf
    assert paired_t(np.zeros(4)) == 0
    assert paired_t(np.array([1.0, np.nan])) is None
    assert effect_size(np.array([1.0, 2.0])) is None
    assert effect_size(np.zeros(4)) == 0
    assert effect_size(np.full(4, 2.0)) == np.inf


@pytest.mark.parametrize("effect", [0.6, 1.0, -2.0])
def test_power_and_pairs_are_those_of_simulated_experiments(effect):
    rng = np.random.default_rng(2)
    n = 20_000
    n_pairs = pairs_needed(effect)
    assert power(effect, n_pairs) >= 0.8 > power(effect, n_pairs - 1)
    for size in (n_pairs, n_pairs - 1):
        change = rng.normal(effect, 1, (n, size))
        t = change.mean(axis=1) / change.std(axis=1, ddof=1) * size**0.5
        seen = np.mean(t**2 > paired_limit(size) ** 2)
        assert power(effect, size) == pytest.approx(
            seen, abs=4 * (seen * (1 - seen) / n) ** 0.5
        )


def paired_limit(n_pairs):
    """Student's t at 5 %, two-sided, from tables."""
    return {4: 3.182, 5: 2.776, 9: 2.306, 10: 2.262, 23: 2.074, 24: 2.069}[n_pairs]


@pytest.mark.parametrize(
    ("effect", "wanted"),
    [(0.0, None), (1e-9, None), (0.2, 199), (0.5, 34), (0.8, 15), (1e9, 2)],
)
def test_pairs_needed_as_in_tables(effect, wanted):
    assert pairs_needed(effect) == pairs_needed(-effect) == wanted


def test_an_infinite_effect_wants_two_pairs_and_one_pair_has_no_power():
    assert pairs_needed(np.inf) == 2
    with pytest.raises(ValueError, match="power of 1 pairs: expected at least 2"):
        power(1.0, 1)
