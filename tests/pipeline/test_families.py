"""Verdicts of families of scores of the world, from rows of `pairs` written by hand."""

import numpy as np
import pandas as pd

from fidpipe.pipeline.results.families import ScoredPairs, judge_families, overall

SURFACES = [
    f"covered_{side}_{reach}" for side in ("real", "sim") for reach in ("0p1m", "0p3m", "1m")
]
PIECES = (
    "n_missing_pieces",
    "n_invented_pieces",
    "missing_pieces_share",
    "invented_pieces_share",
)
PERFECT = dict.fromkeys(SURFACES, 0.8) | dict.fromkeys(PIECES, 0.0)
PERFECT |= dict.fromkeys(("cdc_mean", "r_lambda_mean", "r_gap_mean"), 0.3)
PERFECT |= {"n_sim_points": 10_000, "found": 0.9, "match_rate": 0.6}


def verdict_of(families):
    tends_worse = any(family.tendency == "worse" for family in families)
    return overall(
        {family.verdict for family in families if not family.why}, tends_worse=tends_worse
    )


def scored(rows, blocks=None):
    """Pairs of rows before and after; by default each is a block."""
    before, after = zip(*rows, strict=True)
    if blocks is None:
        blocks = np.arange(len(rows), dtype=np.int32)
    return ScoredPairs([pd.DataFrame(before), pd.DataFrame(after)], blocks)


def judged(n=10, preset="reference", base=None, worse_causes=(), **steps):
    """The families by name if columns of n pairs change by these steps, with a tenth of them as noise."""
    rng = np.random.default_rng(0)
    before = PERFECT | (base or {})
    rows = []
    for _ in range(n):
        noisy = {column: before[column] + rng.normal(0, 0.01) for column in SURFACES}
        first = before | noisy
        after = {
            column: first[column] + step * rng.normal(1, 0.1) for column, step in steps.items()
        }
        rows.append((first, first | after))
    families = judge_families(preset, scored(rows), worse_causes=worse_causes)
    return {family.name: family for family in families}, verdict_of(families)


def test_nothing_changed_is_the_same():
    families, decision = judged()
    assert {family.verdict for family in families.values()} == {"same"}
    assert decision == "same"


def test_points_that_are_lost_are_not_better_because_fewer_are_wrong():
    families, decision = judged(
        covered_real_0p3m=-0.05, covered_sim_0p3m=0.03, n_sim_points=-3000, cdc_mean=-0.02
    )
    assert families["surface missing"].verdict == "worse"
    assert (
        families["surface invented"].why
        == families["objects"].why
        == "follows from surface missing"
    )
    assert decision == "worse"


def test_smeared_points_are_not_better_because_they_cover_more():
    families, decision = judged(
        covered_real_0p3m=0.01, covered_sim_0p3m=-0.02, covered_sim_0p1m=-0.02
    )
    assert families["surface invented"].verdict == "worse"
    assert families["surface missing"].why == "follows from surface invented"
    assert decision == "worse"


def test_much_right_surface_with_a_little_wrong_one_is_mixed():
    families, decision = judged(
        covered_real_0p3m=0.1, covered_sim_0p3m=-0.01, n_sim_points=3000
    )
    assert [families[f"surface {what}"].verdict for what in ("missing", "invented")] == [
        "better",
        "worse",
    ]
    assert decision == "mixed"


def test_an_improvement_that_follows_from_a_worse_sensor_does_not_count():
    families, decision = judged(worse_causes=["lost returns"], covered_sim_0p3m=0.05)
    assert families["surface invented"].why == "follows from lost returns"
    assert decision != "better"


def test_scores_of_one_family_that_move_both_ways_are_mixed():
    families, decision = judged(cdc_mean=-0.05, found=-0.2)
    assert (families["objects"].verdict, decision) == ("mixed", "mixed")


def test_no_simulator_is_better_while_a_family_tends_to_the_worse():
    assert judged(covered_real_0p3m=0.1)[1] == "better"
    rises = (0.02, 0.03, -0.005, 0.03, 0.02, 0.0, 0.03, 0.01, 0.02, -0.005)
    rows = []
    for i, rise in enumerate(rises):
        sim = 0.8 + 0.02 * (-1) ** i
        moved = {"covered_real_0p3m": 0.9, "covered_sim_1m": sim, "cdc_mean": 0.3 + rise}
        rows.append((PERFECT, PERFECT | moved))
    families = judge_families("reference", scored(rows))
    by_name = {family.name: family for family in families}
    assert (by_name["objects"].verdict, by_name["objects"].tendency) == ("undecided", "worse")
    assert verdict_of(families) == "mixed"


def test_columns_that_are_null_in_all_pairs_are_left_out():
    families, _ = judged(base={"n_missing_pieces": None, "missing_pieces_share": None})
    assert [score.name for score in families["surface missing"].scores] == [
        f"real covered {reach} m" for reach in ("0.3", "1", "0.1")
    ]


def test_preset_paper_compares_the_match_rate():
    paper = {score.name for score in judged(preset="paper")[0]["objects"].scores}
    reference = {score.name for score in judged(preset="reference")[0]["objects"].scores}
    assert paper - reference == {"match rate"}
    assert reference - paper == {"objects found"}


def changed_in(n_changed, n_frames=10):
    """The decision on frames of one place if the coverage of some of its eight sectors falls."""
    rng = np.random.default_rng(1)
    rows = []
    parts = []
    for _ in range(n_frames):
        steps = -0.1 * (np.arange(8) < n_changed) + rng.normal(0, 0.002, 8)
        rows.append((PERFECT, PERFECT | {"covered_real_0p3m": 0.8 + steps.mean()}))
        for step in steps:
            parts.append(({"covered_real_0p3m": 0.8}, {"covered_real_0p3m": 0.8 + step}))
    sectors = scored(parts, np.tile(np.arange(8, dtype=np.int32), n_frames))
    alone = judge_families("reference", scored(rows))
    with_sectors = judge_families("reference", scored(rows), sectors=sectors)
    return verdict_of(alone), verdict_of(with_sectors)


def test_neighbouring_frames_decide_what_changed_in_all_directions():
    assert changed_in(8) == ("worse", "worse")


def test_neighbouring_frames_do_not_decide_what_changed_at_one_place():
    assert changed_in(1) == ("worse", "undecided")


def test_tasks_are_decided_over_places_but_not_without_directions():
    lost = {"objects.lost": 0.2, "occupancy.mismatch": 0.3}
    families, decision = judged(base=lost, **{"objects.lost": 0.1})
    assert (families["tasks"].verdict, decision) == ("worse", "worse")
    assert [score.verdict for score in families["tasks"].scores] == ["worse", "same"]
    rows = [({"objects.lost": 0.2}, {"objects.lost": 0.3 + 0.001 * i}) for i in range(10)]
    sectors = scored([(PERFECT, PERFECT)] * 80)
    (tasks,) = judge_families("reference", scored(rows), sectors=sectors)
    assert (tasks.verdict, tasks.scores[0].towards) == ("undecided", "worse")
