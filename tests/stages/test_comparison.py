import sys
from pathlib import Path

import numpy as np
import pytest
from scipy import stats

from fidpipe.stages.statistics.comparison import (
    blocks_of,
    far_beyond_noise,
    holm,
    judge,
    kinds_of_change,
    mean_test,
    paired_difference,
)

sys.path.append(str(Path(__file__).parents[2] / "benchmarks"))
import false_alarms


def test_a_difference_common_to_all_pairs_is_found_however_much_they_vary(rng):
    before = rng.uniform(0, 1, 30)
    found = paired_difference(before, before + 0.05 + rng.normal(0, 0.01, 30))
    assert found.difference == pytest.approx(0.05, abs=0.01)
    assert 0.04 < found.low < found.difference < found.high < 0.06
    assert judge(found, True, found.p) == "better"
    assert judge(found, False, found.p) == "worse"


def test_the_interval_of_many_even_pairs_agrees_with_the_percentiles_of_resampled_means(rng):
    before, after = rng.normal(0, 1, 200), rng.normal(0.3, 1, 200)
    change = after - before
    means = np.sort([rng.choice(change, 200).mean() for _ in range(5000)])
    found = paired_difference(before, after)
    assert found.low == pytest.approx(means[125], abs=0.02)
    assert found.high == pytest.approx(means[4875], abs=0.02)


def test_the_interval_and_p_are_those_of_a_t_test_with_half_the_degrees_where_there_is_no_skew():
    change = np.array([-3.0, -2.0, -1.0, 0.0, 1.0, 2.0, 3.0]) + 2.0
    p, low, high = mean_test(change)
    error = change.std(ddof=1) / 7**0.5
    assert p == pytest.approx(2 * stats.t.sf(2 / error, 3))
    assert (low, high) == pytest.approx(stats.t.interval(0.95, 3, 2, error))


def test_no_difference_between_random_pairs_is_undecided(rng):
    found = paired_difference(rng.normal(0, 1, 30), rng.normal(0, 1, 30))
    assert found.low < 0 < found.high
    assert judge(found, True, found.p) == "undecided"


def test_equal_values_are_the_same_and_equal_steps_say_nothing_of_chance():
    same = paired_difference(np.array([0.1, 0.7]), np.array([0.1, 0.7]))
    assert (same.low, same.high, judge(same, False, same.p)) == (0.0, 0.0, "same")
    step = paired_difference(np.arange(8.0), np.arange(8.0) - 0.5)
    assert (step.low, judge(step, False, step.p)) == (None, "undecided")
    assert "all pairs change alike" in step.why


def test_copies_of_a_scan_count_once(rng):
    before, after = rng.normal(0, 1, 6), rng.normal(3, 1, 6)
    once = paired_difference(before, after)
    copied = paired_difference(
        np.repeat(before, 8),
        np.repeat(after, 8),
        blocks_of([*"a" * 8, *"b" * 8, *"c" * 8, *"d" * 8, *"e" * 8, *"f" * 8], [None] * 48),
    )
    assert (copied.n_pairs, copied.n_blocks) == (48, 6)
    assert (copied.low, copied.high, copied.p) == pytest.approx((once.low, once.high, once.p))
    alone = paired_difference(np.full(8, 1.0), np.full(8, 1.5), blocks_of(["a"] * 8, [None] * 8))
    assert (alone.n_blocks, alone.p, judge(alone, True, alone.p)) == (1, None, "undecided")
    assert alone.why == "8 pairs count as 1, which is too few for a 95 % interval, 6 are wanted"


def test_scans_within_ten_seconds_are_one_block_and_untimed_ones_stand_alone():
    assert blocks_of([*"abcdef"], [0.0, 9.9, 10.0, None, 30.0, 19.9]).tolist() == [0, 0, 2, 3, 4, 2]


def test_p_values_are_those_of_holm_by_hand():
    assert holm([0.01, None, 0.04, 0.03]) == [0.03, None, 0.06, 0.06]
    assert holm([0.9, 0.8]) == [1.0, 1.0]
    assert holm([]) == []


def test_a_difference_that_seeds_alone_make_is_undecided(rng):
    before = rng.uniform(0, 1, 12)
    found = paired_difference(before, before + rng.uniform(0.1, 0.12, 12))
    assert judge(found, True, found.p) == judge(found, True, found.p, 0.05) == "better"
    assert judge(found, True, found.p, 0.2) == "undecided"


def test_a_break_on_five_pairs_is_far_beyond_noise_and_noise_is_not(rng):
    before = rng.normal(0.54, 0.1, 5)
    broken, same = (paired_difference(before, before + step + rng.normal(0, 0.1, 5)) for step in (1.0, 0.0))
    assert far_beyond_noise([broken, same], [None, None]) == [True, False]
    assert far_beyond_noise([broken, same], [1.5, None]) == [False, False]


@pytest.mark.parametrize("case", false_alarms.CASES, ids=[name for name, _, _ in false_alarms.CASES])
def test_without_any_difference_ten_scores_raise_a_false_alarm_in_at_most_one_of_twenty_cases(case):
    _, make, n = case
    repeats = 200
    false, far, fails_a_gate = false_alarms.rates(make, n, repeats)
    most = 0.05 + 2.33 * (0.05 * 0.95 / repeats) ** 0.5  # the nominal rate and its binomial error, one-sided 1 %
    assert false <= most
    assert far <= most
    assert fails_a_gate <= most


@pytest.mark.parametrize(("n", "one", "two"), [(6, 0.0, 0.01), (10, 0.05, 0.6), (50, 0.95, 0.99)])
def test_what_does_differ_is_decided_the_more_often_the_more_pairs_there_are(n, one, two):
    by_one, by_two = (false_alarms.power(false_alarms.normal, n, step, 100) for step in (1.0, 2.0))
    assert by_one >= one
    assert by_two >= two


@pytest.mark.parametrize("n", [1, 2, 3, 4, 5])
def test_fewer_than_six_pairs_decide_nothing_however_much_they_agree(n, rng):
    before = rng.uniform(0, 1, n)
    for step in (np.full(n, 0.5), rng.uniform(0.5, 0.6, n)):
        found = paired_difference(before, before + step)
        assert found.difference == pytest.approx(step.mean())
        assert (found.low, found.high, judge(found, True, found.p)) == (None, None, "undecided")
        assert "too few for a 95 % interval, 6 are wanted" in found.why


def test_without_any_difference_few_pairs_are_never_better_or_worse(rng):
    for n in (2, 4):
        found = [paired_difference(*rng.normal(0, 1, (2, n))) for _ in range(50)]
        verdicts = {judge(one, True, one.p) for one in found}
        assert verdicts == {"undecided"}


def test_six_pairs_that_all_change_the_same_way_are_decided(rng):
    before = rng.uniform(0, 1, 6)
    found = paired_difference(before, before - rng.uniform(0.1, 0.2, 6))
    assert judge(found, False, found.p) == "better"


def test_pairs_without_a_value_are_left_out_and_too_few_have_no_interval():
    found = paired_difference(np.array([1.0, np.nan, 3.0]), np.array([1.5, 2.0, np.nan]))
    assert (found.n_pairs, found.difference, found.low) == (1, 0.5, None)
    assert judge(found, True, found.p) == "undecided"
    nothing = paired_difference(np.array([np.nan]), np.array([1.0]))
    assert (nothing.n_pairs, nothing.difference, nothing.why) == (0, None, "no pair has both values")


def test_what_has_become_of_an_object_by_hand():
    nan = np.nan
    rows = [
        (False, False, nan, nan, nan, nan, "missing in both"),
        (True, False, 0.1, nan, 0.1, nan, "vanished"),
        (False, True, nan, 0.1, nan, 0.1, "appeared"),
        (True, True, 0.5, 0.4, 0.3, 0.3, "better"),
        (True, True, 0.5, 0.5, 0.3, 0.4, "worse"),
        (True, True, 0.5, 0.4, 0.3, 0.4, "mixed"),
        (True, True, 0.5, 0.46, 0.3, 0.34, "alike"),
        (True, True, 0.5, 0.4, nan, 0.9, "better"),
    ]
    before, after, *scores = (np.array(column) for column in list(zip(*rows, strict=True))[:6])
    found = kinds_of_change(before, after, (scores[0], scores[1]), (scores[2], scores[3]))
    assert found.tolist() == [row[-1] for row in rows]
