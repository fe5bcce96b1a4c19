"""Statistics of runs: comparison, spread, summary, findings and neighbouring scans."""

from itertools import product

import false_alarms
import numpy as np
import pytest
from scipy import stats

from fidpipe.pipeline.datasets.readers import read_scan
from fidpipe.stages.statistics.comparison import (
    adjusted_p_values,
    block_means,
    blocks_of,
    holm,
    mean_interval,
    paired_difference,
)
from fidpipe.stages.statistics.neighbours import SAME_PLACE, map_place, neighbours, overlap
from fidpipe.stages.statistics.spread import spread
from fidpipe.stages.statistics.validation import double_validation_metric
from fidpipe.stages.summary import with_unmatched_as_worst
from scenes import box, moved, rigid


def p_of(*changes, least=0.0, step=0.0):
    rows = np.array(changes)
    return adjusted_p_values(rows, np.full(len(rows), least), np.full(len(rows), step)).tolist()


def test_nine_changes_of_one_sign_have_the_p_value_of_one_flip_in_256():
    assert p_of([1.0] * 9) == [1 / 256]
    assert p_of([-3.0, -1.0, -2.0, -1.0, -4.0, -1.0, -5.0, -9.0, -2.0]) == [1 / 256]


def test_p_values_are_shares_of_all_joint_flips_that_reach_as_far(rng):
    changes = rng.normal(0.6, 1, (2, 9))
    highest = []
    for signs in product([-1, 1], repeat=9):
        flipped = changes * signs
        highest.append(max(abs(row.sum()) / (row**2).sum() ** 0.5 for row in flipped))
    own = [abs(row.sum()) / (row**2).sum() ** 0.5 for row in changes]
    expected = [np.mean(np.array(highest) >= value - 1e-9) for value in own]
    assert p_of(*changes) == pytest.approx(expected)


def test_six_blocks_have_the_p_value_of_the_t_test(rng):
    change = rng.normal(1, 1, 6)
    assert p_of(change) == pytest.approx([stats.ttest_1samp(change, 0).pvalue], rel=0.15)


def test_many_blocks_are_drawn_and_never_have_a_p_value_of_0():
    assert p_of([0.1] * 30) == [1 / 20_001]


def test_a_displacement_far_beyond_the_noise_is_decided_by_three_pairs_and_a_mere_trend_is_not():
    assert p_of([-0.119, -0.122, -0.116])[0] < 0.05 / 6
    assert p_of([0.1, 0.05, 0.2]) == [1.0]


def test_changes_up_to_the_least_one_that_matters_are_none():
    small = [0.004, 0.005, 0.006, 0.004, 0.005, 0.006, 0.004, 0.005, 0.005]
    assert p_of(small) == [1 / 256]
    assert np.isnan(p_of(small, least=0.005)).all(), "no signs make it larger"
    assert p_of([0.02, -0.02, 0.02, -0.02, 0.02, -0.02, 0.02, -0.01, 0.0], least=0.005) == [1.0]
    assert p_of(np.array(small) + 0.1, least=0.005) == [1 / 256]


def test_few_equal_steps_of_a_count_may_be_chance_and_large_ones_are_not():
    assert p_of([1.0, 1.0, 1.0], step=1.0) == [1.0]
    assert p_of([9.0, 9.0, 9.0], step=1.0)[0] < 0.05


def test_constant_and_absent_scores_have_no_p_value_and_take_no_share():
    changing = [1.0, 2.0, 1.0, 2.0, 3.0, 1.0, 2.0, 1.0, 2.0]
    found = p_of(changing, [0.0] * 9, [np.nan] * 9, [1e-12] * 9)
    assert found[0] == 1 / 256
    assert np.isnan(found[1:]).all()


def test_a_score_that_some_pairs_lack_is_tested_on_the_others():
    nan = float("nan")
    assert p_of([1.0] * 8 + [nan] * 2) == [1 / 128]


@pytest.mark.parametrize("n", [3, 5, 6, 8, 10])
@pytest.mark.parametrize(
    "kind", [name for name in false_alarms.DISTRIBUTIONS if "of mean 0" not in name]
)
def test_equal_simulators_raise_a_false_alarm_in_at_most_one_of_twenty_cases(kind, n):
    repeats = 150
    rate = false_alarms.rates(*false_alarms.DISTRIBUTIONS[kind], n, repeats)[0]
    # and its binomial error, one-sided 1 %
    assert rate <= 0.05 + 2.33 * (0.05 * 0.95 / repeats) ** 0.5


@pytest.mark.parametrize(("n", "one", "two"), [(6, 0.0, 0.2), (10, 0.1, 0.8), (20, 0.6, 1.0)])
def test_changes_are_decided_the_more_often_the_more_pairs_there_are(n, one, two):
    _, _, by_one, by_two = false_alarms.rates(*false_alarms.DISTRIBUTIONS["normal"], n, 60)
    assert by_one >= one
    assert by_two >= two


def test_a_mean_over_blocks_leaves_out_what_is_null():
    nan = float("nan")
    values = np.array([[1.0, 3.0, 5.0, nan], [nan, 2.0, 4.0, nan]])
    means = block_means(values, np.array([7, 7, 2, 3], dtype=np.int32))
    assert np.array_equal(means, [[5.0, nan, 2.0], [4.0, nan, 2.0]], equal_nan=True)


def test_the_interval_of_a_mean_is_that_of_student():
    change = np.array([-3.0, -2.0, -1.0, 0.0, 1.0, 2.0, 3.0]) + 2.0
    error = change.std(ddof=1) / 7**0.5
    assert mean_interval(change)[1:] == pytest.approx(
        stats.t.interval(0.95, len(change) - 1, change.mean(), error)
    )


def test_differences_are_means_over_the_pairs_that_have_both_values():
    found = paired_difference(
        np.array([1.0, np.nan, 3.0]), np.array([1.5, 2.0, np.nan]), np.arange(3)
    )
    assert (found.n_pairs, found.difference, found.low) == (1, 0.5, None)
    nothing = paired_difference(np.array([np.nan]), np.array([1.0]), np.arange(1))
    assert (nothing.n_pairs, nothing.difference) == (0, None)


def test_rounding_is_no_difference():
    same = paired_difference(np.array([0.1, 0.7]), np.array([0.1 + 6e-15, 0.7]), np.arange(2))
    assert (same.low, same.high) == (0.0, 0.0)


def test_copies_of_a_scan_count_once(rng):
    before, after = rng.normal(0, 1, 6), rng.normal(3, 1, 6)
    once = paired_difference(before, after, np.arange(len(before)))
    blocks = blocks_of(np.repeat([*"abcdef"], 8).tolist(), [None] * 48)
    copied = paired_difference(np.repeat(before, 8), np.repeat(after, 8), blocks)
    assert (copied.n_pairs, copied.n_blocks) == (48, 6)
    assert (copied.low, copied.high) == pytest.approx((once.low, once.high))


def test_scans_within_ten_seconds_are_one_block_and_untimed_ones_stand_alone():
    assert blocks_of([*"abcdef"], [0.0, 9.9, 10.0, None, 30.0, 19.9]).tolist() == [
        0,
        0,
        2,
        3,
        4,
        2,
    ]


def test_neighbours_form_chains():
    assert blocks_of([*"abcde"], [None] * 5, [(0, 1), (1, 2)]).tolist() == [0, 0, 0, 3, 4]
    assert len(set(blocks_of([*"abcde"], [None] * 5, [(3, 4), (0, 1), (1, 3)]).tolist())) == 2


def test_adjusted_p_values_are_at_most_1():
    assert holm([0.9, 0.8]) == [1.0, 1.0]
    assert holm([]) == []


def test_a_score_without_noise_tells_any_difference():
    found = spread(np.array([[0.5, 0.5, 0.5], [0.7, 0.7, 0.7]]))
    assert found.mean == pytest.approx(0.6)
    assert (found.std_seeds, found.least_pair, found.least_dataset) == pytest.approx(
        (0, 0, 0), abs=1e-12
    )
    assert found.std_pairs == pytest.approx(np.std([0.5, 0.7], ddof=1))


def test_nulls_are_left_out():
    found = spread(
        np.array([[1.0, np.nan, 3.0], [np.nan, np.nan, np.nan], [4.0, np.nan, np.nan]])
    )
    assert (found.mean, found.std_seeds) == (pytest.approx(3), pytest.approx(2**0.5))
    nothing = spread(np.full((2, 3), np.nan))
    assert set(vars(nothing).values()) == {None}


@pytest.mark.parametrize(("n_pairs", "n_seeds"), [(1, 2), (1, 5), (3, 2), (5, 5)])
def test_the_repeatability_limit_covers_19_of_20_differences_however_few_the_repeats(
    n_pairs, n_seeds
):
    rng = np.random.default_rng(1)
    n = 2000
    found = [spread(rng.normal(0, 0.2, (n_pairs, n_seeds))) for _ in range(n)]
    one = np.abs(np.diff(rng.normal(0, 0.2, (n, 2)))).ravel()
    means = np.abs(np.diff(rng.normal(0, 0.2 / n_pairs**0.5, (n, 2)))).ravel()
    error = 3 * (0.05 * 0.95 / n) ** 0.5
    assert np.mean(one < [own.least_pair for own in found]) == pytest.approx(0.95, abs=error)
    assert np.mean(means < [own.least_dataset for own in found]) == pytest.approx(
        0.95, abs=error
    )
    known = 1.959963984540054 * 2**0.5
    covered_before = np.mean(one < [known * own.std_seeds for own in found])
    assert covered_before < 0.95 - error
    assert (covered_before < 0.75) == (n_pairs * (n_seeds - 1) == 1)


def test_a_pair_without_a_match_is_the_worst_and_one_without_objects_has_no_score():
    assert with_unmatched_as_worst(None, 0, 4, 2.0) == 2.0
    assert with_unmatched_as_worst(None, 0, 0, 2.0) is None


def test_the_same_values_are_no_distance_apart_and_nulls_are_left_out(rng):
    values = rng.normal(0, 1, 30)
    same = double_validation_metric(values, rng.permutation(np.append(values, np.nan)))
    assert (same.bias, same.area) == pytest.approx((0, 0), abs=1e-15)
    exact = double_validation_metric(values, values)
    assert (exact.bias, exact.area) == (0, 0)
    nothing = double_validation_metric(values, np.full(3, np.nan))
    assert (nothing.bias, nothing.area) == (None, None)


def town(seed):
    """Twelve boxes at random places within 45 m."""
    rng = np.random.default_rng(seed)
    sizes = rng.uniform([2, 2, 2], [12, 4, 5], (12, 3))
    return np.vstack(
        [
            box([*rng.uniform(-45, 45, 2), 1], size, 400, seed + i)
            for i, size in enumerate(sizes)
        ]
    )


def test_a_place_is_recognised_after_some_metres_and_another_is_not():
    here = map_place(town(0))
    assert overlap(here, here) == pytest.approx(1.0, abs=1e-4)
    assert overlap(here, map_place(moved(town(0), rigid(2, [7, -3, 0])))) > SAME_PLACE
    assert max(overlap(here, map_place(town(100 * seed))) for seed in range(1, 5)) < SAME_PLACE


def test_an_empty_scan_is_nowhere():
    assert overlap(map_place(np.empty((0, 3))), map_place(town(0))) == 0.0


def test_only_scans_within_the_window_are_compared():
    assert neighbours([town(0), town(100), town(0)]) == [(0, 2)]
    assert neighbours([town(0), town(100), town(0)], window=1) == []


def object_points(path):
    points = read_scan(path).points
    points = points[
        np.isfinite(points).all(axis=1) & (np.hypot(points[:, 0], points[:, 1]) > 2.5)
    ]
    return points[points[:, 2] > -1.3]


def test_ten_neighbouring_frames_are_one_place_and_other_recordings_are_not(real_data):
    frames = [
        map_place(object_points(path))
        for path in sorted((real_data / "kitti_sequence").glob("*.bin"))
    ]
    others = [
        next((real_data / folder).glob("*.bin")) for folder in ("nuscenes", "rellis", "carla")
    ]
    assert min(overlap(frames[0], other) for other in frames) > SAME_PLACE + 0.1
    assert (
        max(overlap(frames[0], map_place(object_points(path))) for path in others)
        < SAME_PLACE - 0.1
    )
