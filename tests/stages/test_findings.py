import numpy as np
import pytest

from fidpipe.schemas.results import GroupMean, RankCorrelation, WithinPairs
from fidpipe.stages.statistics.findings import (
    Objects,
    density_ratio,
    distribution,
    rank_correlation,
    scans_apart,
    summarise_objects,
)


def side(pair, range_m, label, is_matched, cdc=np.nan, r_lambda=np.nan):
    """Objects of a side, of ten points each."""
    n = len(pair)
    scores = (np.array(np.broadcast_to(own, n), dtype=float) for own in (cdc, r_lambda, 0.0))
    place = np.array(range_m, dtype=float), np.array(label, dtype=str), np.array(is_matched, dtype=bool)
    return Objects(np.array(pair, dtype=np.int32), *place, *np.full((2, n), 10), *scores)


@pytest.fixture
def by_hand():
    """Two pairs: cars near and matched, trees far; one tree missing, one invented."""
    of_real = [5.0, 25.0, 5.0, 45.0], ["car", "tree", "car", "tree"], [True, True, True, False]
    real = side([0, 0, 1, 1], *of_real, [0.1, 0.9, 0.3, np.nan], [0.2, 0.5, np.nan, np.nan])
    sim = side([0, 0, 1, 1], [5.0, 25.0, 6.0, 60.0], ["car", "tree", "car", "tree"], [True, True, True, False])
    return summarise_objects(real, sim, ["a", "b"], [0.0, 61.0])


def test_unmatched_objects_are_counted_by_range_of_their_own_side(by_hand):
    bands = {band.from_m: band for band in by_hand.range_m.bands}
    assert (bands[0.0].n_real, bands[0.0].n_missing, bands[0.0].missing_share) == (2, 0, 0.0)
    assert (bands[30.0].n_real, bands[30.0].missing_share, bands[30.0].n_sim) == (1, 1.0, 0)
    assert (bands[50.0].n_hallucinated, bands[50.0].missing_share) == (1, None)
    assert by_hand.range_m.median_matched == 5.0
    assert by_hand.range_m.median_unmatched == 52.5


def test_a_class_is_that_of_the_real_object_and_nulls_are_left_out(by_hand):
    classes = {row.label: row for row in by_hand.classes}
    car = classes["car"]
    assert (car.n_matched, car.scores["cdc"].mean) == (2, 0.2)
    assert car.scores["r_lambda"] == GroupMean(mean=0.2, std=None, n=1)
    assert (classes["tree"].missing_share, classes["tree"].hallucinated_share) == (0.5, 0.5)


def test_scans_without_labels_have_no_classes():
    one = side([0], [5.0], [""], [True], 0.1, 0.2)
    found = summarise_objects(one, one, ["a"], [None])
    assert found.classes == ()


def test_the_spread_of_a_pair_is_that_of_its_objects(by_hand):
    assert by_hand.within_pairs == WithinPairs(n_pairs=1, n_r_lambda_wider=0)


def test_nothing_at_all_gives_nulls_and_no_error():
    nothing = side([], [], [], [])
    found = summarise_objects(nothing, nothing, ["a"], [None])
    assert found.distributions.cdc.mean is None
    assert found.rank_correlation == RankCorrelation(n=0, spearman=None, kendall=None)
    assert found.density_ratio.min is None


def test_a_distribution_by_hand():
    found = distribution(np.array([0.0, 0.01, 0.02, 1.0, np.nan]))
    assert (found.n, found.min, found.max) == (4, 0.0, 1.0)
    assert found.peak_density == pytest.approx(0.75 / 0.05)
    assert found.cv == pytest.approx(np.std([0, 0.01, 0.02, 1], ddof=1) / 0.2575)


def test_a_rank_correlation_sees_order_only():
    a = np.array([1.0, 2.0, 3.0, 100.0, np.nan])
    assert vars(rank_correlation(a, -(a**3))) == {"n": 4, "spearman": pytest.approx(-1), "kendall": pytest.approx(-1)}
    assert rank_correlation(a, np.ones(5)).kendall is None


def test_density_ratios_are_simulated_over_real():
    found = density_ratio(np.array([100, 10, 10]), np.array([10, 10, 50]))
    assert (found.min, found.median, found.max) == (0.1, 1.0, 5.0)
    assert found.share_below_quarter == found.share_above_four == pytest.approx(1 / 3)


def test_scans_apart_are_more_than_a_minute_apart_and_spread_over_time():
    times = [10.0 * i for i in range(100)]
    chosen = scans_apart(times)
    assert len(chosen) == 4
    assert np.diff([times[i] for i in chosen]).min() > 60
    assert chosen[0] == 0 and times[chosen[-1]] > 900


def test_exactly_a_minute_is_not_more_than_one():
    assert scans_apart([0.0, 60.0]) == [0]


def test_without_timestamps_pairs_are_evenly_spaced_and_it_is_said():
    n = 9
    scores = np.linspace(0.1, 0.9, n)
    one = side(range(n), [5.0] * n, [""] * n, [True] * n, scores, scores)
    found = summarise_objects(one, one, list("abcdefghi"), [None] * n).scans
    assert found.apart is False
    assert [scan.pair for scan in found.scans] == ["a", "d", "f", "i"]
