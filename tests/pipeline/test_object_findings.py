"""Findings over the objects of all pairs, by hand."""

import numpy as np
import pandas as pd
import pytest

from fidpipe.pipeline.results.overview import (
    density_ratio,
    rank_correlation,
    summarise_objects,
)
from fidpipe.schemas.results import RankCorrelation
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
    return objects.assign(n_real=10, n_sim=10, n_points=10, covered_0p3m=0.6, r_gap=0.0)


@pytest.fixture
def by_hand():
    """Two pairs: cars near and matched, trees far; one tree missing, one invented."""
    place = [5.0, 25.0, 5.0, 45.0], ["car", "tree", "car", "tree"], [True, True, True, False]
    real = *place, [0.1, 0.9, 0.3, np.nan], [0.2, 0.5, np.nan, np.nan]
    sim = [5.0, 25.0, 6.0, 60.0], *place[1:]
    return summarise_objects(both_sides(real, sim), {"a": 0, "b": 0})


def groups_by(findings, what):
    return {group.name: group for group in findings.groups if group.by == what}


def test_unmatched_objects_are_counted_by_range_of_their_own_side(by_hand):
    bands = groups_by(by_hand, "range")
    near, far, farthest = [bands[name] for name in ("0 to 10 m", "30 to 50 m", "over 50 m")]
    assert (near.n_real, near.n_not_found, near.n_real_points) == (2, 0, 20)
    assert near.missing_share == near.invented_share == pytest.approx(0.4)
    assert (far.n_real, far.n_not_found, far.n_sim) == (1, 1, 0)
    assert (farthest.n_extra, farthest.missing_share) == (1, None)
    assert by_hand.median_matched_m == 5.0
    assert by_hand.median_unmatched_m == 52.5
    assert by_hand.n_places == 1


def test_a_class_is_that_of_the_real_object_and_nulls_are_left_out(by_hand):
    classes = groups_by(by_hand, "class")
    car, tree = classes["car"], classes["tree"]
    assert (car.n_real, car.n_not_found, car.scores["cdc"].mean) == (2, 0, 0.2)
    of_car = car.scores["r_lambda"]
    assert (of_car.mean, of_car.std, of_car.n) == (0.2, None, 1)
    assert (tree.n_real, tree.n_not_found, tree.n_sim, tree.n_extra) == (2, 1, 2, 1)


def test_scans_without_labels_have_no_classes():
    one = [5.0], [""], [True], [0.1], [0.2]
    found = summarise_objects(both_sides(one, one), {"a": 0})
    assert groups_by(found, "class") == {}


def test_nothing_at_all_gives_nulls_and_no_error():
    nothing = [], [], []
    found = summarise_objects(both_sides(nothing, nothing), {})
    assert found.distributions["cdc"].mean is None
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
