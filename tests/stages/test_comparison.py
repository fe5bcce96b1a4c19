import numpy as np
import pytest

from fidpipe.stages.statistics.comparison import judge, kinds_of_change, paired_difference


def test_a_difference_common_to_all_pairs_is_found_however_much_they_vary(rng):
    before = rng.uniform(0, 1, 30)
    found = paired_difference(before, before + 0.05 + rng.normal(0, 0.01, 30))
    assert found.difference == pytest.approx(0.05, abs=0.01)
    assert 0.04 < found.low < found.difference < found.high < 0.06
    assert judge(found, higher_is_better=True) == "better"
    assert judge(found, higher_is_better=False) == "worse"


def test_the_interval_agrees_with_the_percentiles_of_resampled_means(rng):
    before, after = rng.normal(0, 1, 40), rng.normal(0.3, 1, 40)
    change = after - before
    means = np.sort([rng.choice(change, 40).mean() for _ in range(5000)])
    found = paired_difference(before, after)
    assert found.low == pytest.approx(means[125], abs=0.05)
    assert found.high == pytest.approx(means[4875], abs=0.05)


def test_the_same_call_gives_the_same_interval(rng):
    before, after = rng.normal(size=(2, 10))
    assert paired_difference(before, after) == paired_difference(before, after)


def test_no_difference_between_random_pairs_is_undecided(rng):
    found = paired_difference(rng.normal(0, 1, 30), rng.normal(0, 1, 30))
    assert found.low < 0 < found.high
    assert judge(found, higher_is_better=True) == "undecided"


def test_equal_values_are_the_same_and_equal_steps_of_six_pairs_are_sure():
    same = paired_difference(np.array([0.1, 0.7]), np.array([0.1, 0.7]))
    assert (same.low, same.high, judge(same, False)) == (0.0, 0.0, "same")
    step = paired_difference(np.arange(6.0), np.arange(6.0) - 0.5)
    assert (step.low, step.high, judge(step, False)) == (-0.5, -0.5, "better")


@pytest.mark.parametrize("n", [1, 2, 3, 4, 5])
def test_fewer_than_six_pairs_decide_nothing_however_much_they_agree(n, rng):
    before = rng.uniform(0, 1, n)
    for step in (np.full(n, 0.5), rng.uniform(0.5, 0.6, n)):
        found = paired_difference(before, before + step)
        assert found.difference == pytest.approx(step.mean())
        assert (found.low, found.high, judge(found, True)) == (None, None, "undecided")
        assert "too few for a 95 % interval, 6 are wanted" in found.why


def test_without_any_difference_few_pairs_are_never_better_or_worse(rng):
    for n in (2, 4):
        verdicts = {judge(paired_difference(*rng.normal(0, 1, (2, n))), True) for _ in range(50)}
        assert verdicts == {"undecided"}


def test_six_pairs_that_all_change_the_same_way_are_decided(rng):
    before = rng.uniform(0, 1, 6)
    assert judge(paired_difference(before, before - rng.uniform(0.1, 0.2, 6)), False) == "better"


def test_pairs_without_a_value_are_left_out_and_too_few_have_no_interval():
    found = paired_difference(np.array([1.0, np.nan, 3.0]), np.array([1.5, 2.0, np.nan]))
    assert (found.n_pairs, found.difference, found.low) == (1, 0.5, None)
    assert judge(found, True) == "undecided"
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
