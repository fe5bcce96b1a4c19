import numpy as np
import pytest

from fidpipe.stages.summary import mean_and_std, summarise_dataset, summarise_pair, with_unmatched_as_worst


def test_nulls_are_left_out_and_the_deviation_is_that_of_a_sample():
    assert mean_and_std(np.array([1.0, np.nan, 3.0])) == (2.0, pytest.approx(np.sqrt(2)))


def test_one_value_has_no_deviation_and_none_has_no_mean():
    assert mean_and_std(np.array([4.0])) == (4.0, None)
    assert mean_and_std(np.array([np.nan])) == (None, None)


def test_a_pair_by_hand():
    row = summarise_pair(
        {"cdc": np.array([0.2, 0.4]), "r_lambda": np.array([0.0, np.nan])},
        ["identical", "too_small"],
        matched_range_m=np.array([5.0, 7.0]),
        missing_range_m=np.array([20.0]),
        hallucinated_range_m=np.array([30.0, 40.0]),
    )
    assert (row["n_matched"], row["n_missing"], row["n_hallucinated"]) == (2, 1, 2)
    assert (row["n_scored"], row["n_identical"], row["n_too_small"]) == (0, 1, 1)
    assert row["match_rate"] == 0.5
    assert (row["median_range_matched_m"], row["median_range_unmatched_m"]) == (6.0, 30.0)
    assert (row["cdc_mean"], row["r_lambda_mean"], row["r_lambda_std"]) == (pytest.approx(0.3), 0.0, None)


def test_no_matches_are_a_rate_of_zero_and_no_medians():
    row = summarise_pair({}, [], np.array([]), np.array([1.0]), np.array([]))
    assert (row["match_rate"], row["median_range_matched_m"]) == (0.0, None)


def test_the_dataset_is_the_mean_of_the_pairs_means():
    summary = summarise_dataset({"cdc_mean": [0.2, None, 0.4]})
    assert vars(summary["cdc_mean"]) == {"mean": pytest.approx(0.3), "std": pytest.approx(np.sqrt(0.02)), "n_pairs": 2}


def test_losing_the_worst_object_makes_the_plain_mean_better_and_the_one_with_unmatched_worse():
    before, after = with_unmatched_as_worst(0.6, 3, 0, 2.0), with_unmatched_as_worst(0.2, 2, 1, 2.0)
    assert (before, after) == (pytest.approx(0.6), pytest.approx(0.8))


def test_a_pair_without_a_match_is_the_worst_and_one_without_objects_has_no_score():
    assert with_unmatched_as_worst(None, 0, 4, 2.0) == 2.0
    assert with_unmatched_as_worst(None, 0, 0, 2.0) is None
