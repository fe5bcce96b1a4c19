"""Findings over the objects of all pairs, by hand."""

import numpy as np
import pandas as pd
import pytest

from fidpipe.pipeline.results.object_findings import (
    density_ratio,
    rank_correlation,
    summarise_objects,
)
from fidpipe.schemas.results import GroupMean, RankCorrelation
from fidpipe.stages.statistics.findings import BAND_EDGES_M

FATES = {"real": "not_found", "sim": "extra"}


def both_sides(real, sim):
    """Objects of ten points each; of each side range_m, label, is_matched, and perhaps cdc and r_lambda."""
    frames = []
    for side, (range_m, label, is_matched, *scores) in (("real", real), ("sim", sim)):
        cdc, r_lambda = scores or (np.nan, np.nan)
        frame = pd.DataFrame({"range_m": range_m, "label": label, "is_matched": is_matched})
        frames.append(frame.assign(side=side, cdc=cdc, r_lambda=r_lambda))
    objects = pd.concat(frames).astype({"range_m": float, "is_matched": bool})
    objects["fate"] = objects["side"].map(FATES).mask(objects["is_matched"], "matched")
    objects["band"] = np.digitize(objects["range_m"], BAND_EDGES_M) - 1
    return objects.assign(n_real=10, n_sim=10, r_gap=0.0)


@pytest.fixture
def by_hand():
    """Two pairs: cars near and matched, trees far; one tree missing, one invented."""
    place = [5.0, 25.0, 5.0, 45.0], ["car", "tree", "car", "tree"], [True, True, True, False]
    real = *place, [0.1, 0.9, 0.3, np.nan], [0.2, 0.5, np.nan, np.nan]
    sim = [5.0, 25.0, 6.0, 60.0], *place[1:]
    return summarise_objects(both_sides(real, sim), 2)


def test_unmatched_objects_are_counted_by_range_of_their_own_side(by_hand):
    bands = {band.from_m: band for band in by_hand.range_m.bands}
    assert (bands[0.0].n_real, bands[0.0].n_not_found, bands[0.0].not_found_share) == (2, 0, 0.0)
    assert (bands[30.0].n_real, bands[30.0].not_found_share, bands[30.0].n_sim) == (1, 1.0, 0)
    assert (bands[50.0].n_extra, bands[50.0].not_found_share) == (1, None)
    assert by_hand.range_m.median_matched == 5.0
    assert by_hand.range_m.median_unmatched == 52.5


def test_a_class_is_that_of_the_real_object_and_nulls_are_left_out(by_hand):
    classes = {row.label: row for row in by_hand.classes}
    car = classes["car"]
    assert (car.n_matched, car.scores["cdc"].mean) == (2, 0.2)
    assert car.scores["r_lambda"] == GroupMean(mean=0.2, std=None, n=1)
    assert (classes["tree"].not_found_share, classes["tree"].extra_share) == (0.5, 0.5)


def test_scans_without_labels_have_no_classes():
    one = [5.0], [""], [True], [0.1], [0.2]
    found = summarise_objects(both_sides(one, one), 1)
    assert found.classes == ()


def test_nothing_at_all_gives_nulls_and_no_error():
    nothing = [], [], []
    found = summarise_objects(both_sides(nothing, nothing), 1)
    assert found.distributions.cdc.mean is None
    assert found.rank_correlation == RankCorrelation(n=0, spearman=None, kendall=None)
    assert found.density_ratio.min is None


def test_a_rank_correlation_sees_order_only():
    a = np.array([1.0, 2.0, 3.0, 100.0, np.nan])
    assert vars(rank_correlation(a, -(a**3))) == {
        "n": 4,
        "spearman": pytest.approx(-1),
        "kendall": pytest.approx(-1),
    }
    assert rank_correlation(a, np.ones(5)).kendall is None


def test_density_ratios_are_simulated_over_real():
    found = density_ratio(np.array([0.1, 1.0, 5.0]))
    assert (found.min, found.median, found.max) == (0.1, 1.0, 5.0)
    assert found.share_below_quarter == found.share_above_four == pytest.approx(1 / 3)
