import numpy as np
import pytest

from fidpipe.schemas.results import ScoreDistributions, ScoreSummary
from fidpipe.stages.statistics.claim_rules import FAILS, HOLDS, UNKNOWN
from fidpipe.stages.statistics.claims import check_claims
from fidpipe.stages.statistics.findings import MatchedObjects, SideObjects, summarise_objects

SCORES = ("match_rate", "cdc_mean", "r_lambda_mean", "r_gap_mean")


def dataset(seed=0, labels=("tree", "vegetation", "car", "wall"), times=True):
    """Objects as the paper describes them: CDC high and narrow, r_lambda lower and wide, foliage often missing."""
    rng = np.random.default_rng(seed)
    n_pairs, n = 20, 60
    pair = np.repeat(np.arange(n_pairs, dtype=np.int32), n)
    label = np.array([labels[i % len(labels)] for i in range(len(pair))])
    is_foliage = np.isin(label, ["tree", "vegetation"])
    range_m = rng.uniform(3, 50, len(pair))
    is_matched = rng.random(len(pair)) > np.where(is_foliage, 0.6, 0.2) * (range_m / 35)
    side = SideObjects(pair, range_m, label, is_matched)
    of = is_matched.nonzero()[0]
    wall, far = label[of] == "wall", range_m[of] / 50
    cdc = np.clip(rng.normal(0.75, 0.03, len(of)) + 0.04 * is_foliage[of] - 0.04 * wall, 0.41, 2)
    r_lambda = np.clip(0.15 + 0.35 * far + rng.normal(0, 0.15, len(of)) - 0.1 * wall, 0.02, 1)
    n_real = rng.integers(50, 100, len(of)).astype(np.int32)
    n_sim = (n_real * np.exp(rng.uniform(-1.8, 1.8, len(of)))).astype(np.int32)
    both = MatchedObjects(pair[of], range_m[of], label[of], n_real, n_sim, cdc, r_lambda, r_lambda / 10)
    times_s = [100.0 * i if times else None for i in range(n_pairs)]
    findings = summarise_objects(side, side, both, [f"{i:02}" for i in range(n_pairs)], times_s)
    values = zip(SCORES, (0.594, 0.75, 0.37, 0.028), (0.066, 0.02, 0.03, 0.014), strict=True)
    return {name: ScoreSummary(mean=mean, std=std, n_pairs=n_pairs) for name, mean, std in values}, findings


def verdicts(summary, findings):
    return {claim.claim: claim.verdict for claim in check_claims(summary, findings)}


def test_what_looks_like_the_paper_bears_out_its_orders():
    found = verdicts(*dataset())
    assert set(found.values()) <= {HOLDS, FAILS}
    for claim, verdict in found.items():
        if not claim.startswith(("matched objects a pair", "median range of unmatched")):
            assert verdict == HOLDS, claim


def test_a_mean_beyond_the_papers_spread_does_not_hold():
    summary, findings = dataset()
    for mean, verdict in ((0.401, FAILS), (0.399, HOLDS)):
        summary["r_lambda_mean"] = summary["r_lambda_mean"].model_copy(update={"mean": mean})
        assert verdicts(summary, findings)["mean r_lambda over pairs"] == verdict


def test_the_opposite_order_does_not_hold():
    summary, findings = dataset()
    known = findings.distributions
    swapped = ScoreDistributions(cdc=known.r_lambda, r_lambda=known.cdc, r_gap=known.r_gap)
    turned = findings.model_copy(update={"distributions": swapped})
    found = verdicts(summary, turned)
    for claim in (
        "r_lambda varies more than CDC relative to its mean",
        "r_lambda spans a wider range than CDC",
        "the peak of CDC is higher and sharper than that of r_lambda",
        "CDC takes no value below 0.4",
    ):
        assert found[claim] == FAILS, claim


def with_every_class(findings, **values):
    return findings.model_copy(update={"classes": tuple(row.model_copy(update=values) for row in findings.classes)})


def test_a_difference_within_chance_does_not_hold():
    summary, findings = dataset()
    found = with_every_class(findings, r_lambda_near_mean=0.400, r_lambda_far_mean=0.401)
    assert verdicts(summary, found)["near trees keep their structure, distant ones less"] == FAILS


SHARES = "trees and vegetation are missing more often than cars and walls"


def with_missing(findings, tree, car):
    """The findings with (missing, all) real objects of the classes tree and car, and no other class."""
    rows = {row.label: row for row in findings.classes}
    counted = [
        rows[label].model_copy(update={"n_missing": n_missing, "n_real": n_real})
        for label, (n_missing, n_real) in (("tree", tree), ("car", car))
    ]
    return findings.model_copy(update={"classes": tuple(counted)})


@pytest.mark.parametrize(
    ("tree", "car", "verdict"),
    [
        ((1, 1), (0, 1), UNKNOWN),
        ((4, 4), (0, 100), UNKNOWN),
        ((5, 5), (4, 5), FAILS),
        ((5, 5), (3, 5), FAILS),
        ((5, 5), (0, 5), HOLDS),
    ],
)
def test_a_share_of_all_or_none_of_a_few_objects_is_not_taken_for_sure(tree, car, verdict):
    summary, findings = dataset()
    assert verdicts(summary, with_missing(findings, tree, car))[SHARES] == verdict


def test_the_error_of_a_share_worked_out_by_hand():
    # 8 of 12 and 2 of 12: centres 10/16 and 4/16, errors sqrt(10 6 / 16^3) and sqrt(4 12 / 16^3), 0.375 > 2 x 0.162
    summary, findings = dataset()
    assert verdicts(summary, with_missing(findings, (8, 12), (2, 12)))[SHARES] == HOLDS
    # 7 of 12 and 2 of 12: 9/16 and 4/16, 0.3125 < 2 x 0.165
    assert verdicts(summary, with_missing(findings, (7, 12), (2, 12)))[SHARES] == FAILS


@pytest.mark.parametrize(("n", "verdict"), [(2, UNKNOWN), (4, UNKNOWN), (5, HOLDS)])
def test_means_of_a_few_equal_values_are_not_checkable(n, verdict):
    summary, findings = dataset()
    equal = {}
    for name, mean in (("r_lambda_near", 0.1), ("r_lambda_far", 0.2)):
        equal |= {f"{name}_mean": mean, f"{name}_std": 0.0, f"{name}_n": n}
    assert (
        verdicts(summary, with_every_class(findings, **equal))["near trees keep their structure, distant ones less"]
        == verdict
    )


def test_without_labels_and_timestamps_those_claims_are_not_checkable():
    summary, findings = dataset(labels=("",), times=False)
    unknown = [claim for claim in check_claims(summary, findings) if claim.verdict == UNKNOWN]
    assert len(unknown) == 5
    assert {claim.here for claim in unknown} == {"-"}


@pytest.mark.parametrize("name", SCORES)
def test_a_mean_that_is_null_is_not_checkable(name):
    summary, findings = dataset()
    summary[name] = ScoreSummary(mean=None, std=None, n_pairs=0)
    assert UNKNOWN in verdicts(summary, findings).values()


def test_nothing_is_claimed_that_the_paper_only_shows_in_single_pictures():
    claims = check_claims(*dataset())
    assert len(claims) == 25
    assert not any("lowest" in claim.claim or "50 of 50" in claim.paper for claim in claims)
