"""Objects of all pairs by range and by class, by hand."""

import numpy as np
import pandas as pd
import pytest

from fidpipe.pipeline.results.overview import object_groups

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
    return objects.assign(n_points=10, covered_0p3m=0.6, r_gap=0.0)


@pytest.fixture
def by_hand():
    """Two pairs: cars near and matched, trees far; one tree missing, one invented."""
    place = [5.0, 25.0, 5.0, 45.0], ["car", "tree", "car", "tree"], [True, True, True, False]
    real = *place, [0.1, 0.9, 0.3, np.nan], [0.2, 0.5, np.nan, np.nan]
    sim = [5.0, 25.0, 6.0, 60.0], *place[1:]
    return list(object_groups(both_sides(real, sim)))


def groups_by(groups, what):
    return {group.name: group for group in groups if group.by == what}


def test_unmatched_objects_are_counted_by_range_of_their_own_side(by_hand):
    bands = groups_by(by_hand, "range")
    near, far, farthest = [bands[name] for name in ("0 to 10 m", "30 to 50 m", "over 50 m")]
    assert (near.n_real, near.n_not_found, near.n_real_points) == (2, 0, 20)
    assert near.missing_share == near.invented_share == pytest.approx(0.4)
    assert (far.n_real, far.n_not_found, far.n_sim) == (1, 1, 0)
    assert (farthest.n_extra, farthest.missing_share) == (1, None)


def test_a_class_is_that_of_the_real_object_and_nulls_are_left_out(by_hand):
    classes = groups_by(by_hand, "class")
    car = classes["car"]
    tree = classes["tree"]
    assert (car.n_real, car.n_not_found) == (2, 0)
    assert (car.scores["cdc"], car.scores["r_lambda"]) == (0.2, 0.2)
    assert (tree.n_real, tree.n_not_found, tree.n_sim, tree.n_extra) == (2, 1, 2, 1)


def test_scans_without_labels_have_no_classes():
    one = [5.0], [""], [True], [0.1], [0.2]
    assert groups_by(object_groups(both_sides(one, one)), "class") == {}


def test_nothing_at_all_gives_nulls_and_no_error():
    nothing = [], [], []
    groups = list(object_groups(both_sides(nothing, nothing)))
    assert {group.n_real for group in groups} == {0}
    assert {group.scores["cdc"] for group in groups} == {None}
