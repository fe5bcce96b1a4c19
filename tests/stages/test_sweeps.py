"""What perturbation sweeps say, on means written by hand."""

import pytest

from fidpipe.stages.sensing.perturbations import Perturbation
from fidpipe.stages.statistics.sweeps import Means, judge_claims, react


def rigid(slope):
    """Means of two rotations; the second moves centroids by `slope` metres per degree, the first by 0.4."""
    levels = [Perturbation("rigid", 0.5), Perturbation("rigid", 1.0)]
    scores = [
        (None, "match_rate", (1.0, 1.0)),
        (None, "eigenspectrum_distance_mean", (0.0, 1e-7)),
        (None, "centroid_distance_m_mean", (0.2, slope)),
        ("car", "r_lambda", (0.001, 0.002)),
    ]
    rows = [
        {**vars(level), "object": name, "metric": metric, "n": 1, "mean": value, "std": None}
        for name, metric, values in scores
        for level, value in zip(levels, values, strict=True)
    ]
    return judge_claims(Means(rows), levels)


def test_claims_are_judged_by_the_numbers():
    def summary(rates, curve):
        levels = [Perturbation("dropout", amount) for amount in (0.1, 0.2)]
        found = [(None, "match_rate", rates), ("car", "r_lambda", curve)]
        rows = [
            {**vars(level), "object": of, "metric": metric, "n": 1, "mean": value, "std": None}
            for of, metric, values in found
            for level, value in zip(levels, values, strict=True)
        ]
        return levels, Means(rows)

    levels, good = summary((0.9, 0.8), (0.1, 0.2))
    assert [claim.holds for claim in judge_claims(good, levels)] == [True, True]
    levels, bad = summary((0.8, 0.9), (0.2, 0.1))
    claims = judge_claims(bad, levels)
    assert [claim.holds for claim in claims] == [False, False]
    assert claims[0].here == "0 of 1, not car"
    levels, flat = summary((0.8, 0.8), (0.2, 0.2))
    assert [claim.holds for claim in judge_claims(flat, levels)] == [False, False]
    levels, gap = summary((0.9, None), (None, 0.2))
    claims = judge_claims(gap, levels)
    assert [claim.holds for claim in claims] == [None, None]
    assert [claim.here for claim in claims] == ["no value for dropout 0.1 of car", "no value for dropout 0.2"]


@pytest.mark.parametrize(("slope", "holds"), [(0.4, True), (0.5, False)])
def test_the_centroid_distance_is_linear_in_the_angle(slope, holds):
    claims = {claim.claim: claim for claim in rigid(slope)}
    assert claims["d_cent is linear in the angle"].holds is holds
    assert claims["d_cent is linear in the angle"].here.startswith("0.4000 m per degree")
    assert claims["rigid motion keeps the spectra"].here == "1.0e-07"
    assert claims["rigid motion leaves r_lambda of objects at 0"].here == "2.0e-03"
    assert len(claims) == 4


def test_a_metric_reacts_most_to_the_level_at_which_it_is_farthest_from_equal_objects():
    levels = [Perturbation("noise", 0.1), Perturbation("dropout", 0.2), Perturbation("dropout", 0.4)]
    rows = [
        {**vars(level), "object": name, "metric": "f_score", "n": 1, "mean": value, "std": None}
        for name, shift in (("car", -0.1), ("tree", 0.1))
        for level, value in zip(levels, (0.8 + shift, 0.1, 0.5 + shift), strict=True)
    ]
    reactions = {reaction.metric: reaction for reaction in react(Means(rows), levels)}
    assert reactions["f_score"].values == pytest.approx((0.8, 0.5))
    assert reactions["f_score"].most == levels[2]
    assert reactions["r_lambda"].values == (None, None)
    assert reactions["r_lambda"].most is None


def class_claims(r_gap_of_wall, r_lambdas):
    """Claims on four classes at 20 and 40 % dropout; r_lambdas at 40 %: vegetation, car, tree, wall."""
    levels = [Perturbation("dropout", 0.2), Perturbation("dropout", 0.4)]
    curves = {
        (name, metric): (value / 2, value)
        for metric, values in (("r_lambda", r_lambdas), ("r_gap", (0.02, 0.03, 0.01, r_gap_of_wall)))
        for name, value in zip(("vegetation", "car", "tree", "wall"), values, strict=True)
    }
    rows = [
        {**vars(level), "object": name, "metric": metric, "n": 1, "mean": value, "std": None}
        for (name, metric), values in curves.items()
        for level, value in zip(levels, values, strict=True)
    ]
    return {claim.claim: claim for claim in judge_claims(Means(rows), levels)}


def test_what_the_paper_says_of_its_classes_under_dropout_holds_and_fails_by_the_numbers():
    as_the_paper = class_claims(0.003, (0.35, 0.40, 0.30, 0.2))
    assert len(as_the_paper) == 2 + 4 + 1 + 2
    assert {claim.holds for claim in as_the_paper.values()} == {True}
    other = class_claims(0.0059, (0.25, 0.495, 0.30, 0.26))
    failing = {name for name, claim in other.items() if not claim.holds}
    assert failing == {
        "dropout: the wall is most robust by r_lambda",
        "dropout: car and vegetation are most sensitive by r_lambda",
        "dropout: r_gap of the wall stays small",
        "r_lambda of the car at 40% dropout, within a tenth",
        "r_lambda of the vegetation at 40% dropout, within a tenth",
    }
    assert other["dropout: r_gap of the wall stays small"].here == "up to 0.0059"


@pytest.mark.parametrize(("tree", "holds"), [(0.01, True), (0.3, False)])
def test_the_tree_is_flat_under_noise_only_where_it_moves_least(tree, holds):
    levels = [Perturbation("noise", 0.01), Perturbation("noise", 0.1), Perturbation("dropout", 0.4)]
    rows = [
        {**vars(level), "object": name, "metric": "r_lambda", "n": 1, "mean": value, "std": None}
        for name, move in (("vegetation", 0.1), ("car", 0.2), ("tree", tree), ("wall", 0.1))
        for level, value in zip(levels, (0.1, 0.1 + move, 0.5), strict=True)
    ]
    claims = {claim.claim: claim for claim in judge_claims(Means(rows), levels)}
    assert claims["noise: r_lambda of the tree is near-flat (moves least)"].holds is holds
