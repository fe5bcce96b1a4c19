"""Verdicts of families of scores, from rows of `pairs` written by hand."""

import numpy as np
import pytest

from fidpipe.pipeline.results.displaced import MovedWorld
from fidpipe.pipeline.results.families import judge_families, overall
from fidpipe.stages.statistics.comparison import Difference

SURFACES = [f"covered_{side}_{reach}" for side in ("real", "sim") for reach in ("0p1m", "0p3m", "1m")]
PERFECT = dict.fromkeys(SURFACES, 0.8) | {
    "n_sim_points": 10_000,
    **dict.fromkeys(("n_missing_pieces", "n_invented_pieces", "missing_pieces_share", "invented_pieces_share"), 0.0),
    **dict.fromkeys(("shift_x_m", "shift_y_m", "shift_z_m", "roughness_bias_m", "roughness_area_m"), 0.0),
    **dict.fromkeys(("ground_real_peak_m", "ground_sim_peak_m"), -1.7),
    **dict.fromkeys(("cdc_mean", "r_lambda_mean", "r_gap_mean"), 0.3),
    **{"found": 0.9, "match_rate": 0.6, "sensor_real_beams": 64, "sensor_sim_beams": 64},
}


def judged(n=10, preset="reference", base=None, moved=None, **steps):
    """The families by name if columns of n pairs change by these steps, with a tenth of them as noise.

    moved : parameters of the displacement between the simulated scans; None if it is not known
    """
    rng = np.random.default_rng(0)
    before = PERFECT | (base or {})
    rows = {}
    for i in range(n):
        own = {column: before[column] + rng.normal(0, 0.01) for column in SURFACES}
        first = before | own
        after = {column: first[column] + step * rng.normal(1, 0.1) for column, step in steps.items()}
        rows[str(i)] = (first, first | after)
    world = moved and MovedWorld(dict.fromkeys(moved, Difference(difference=0.1)))
    found = judge_families(preset, rows, np.arange(n, dtype=np.int32), world=world)
    return {family.name: family for family in found}, overall(found)


def test_nothing_changed_is_the_same():
    families, decision = judged()
    assert {family.verdict for family in families.values()} == {"same"}
    assert decision == "same"


def test_a_world_that_is_12_cm_lower_is_worse_on_three_pairs():
    families, decision = judged(3, shift_z_m=-0.12, ground_sim_peak_m=-0.12)
    assert (families["position"].verdict, decision) == ("worse", "worse")


def test_only_the_distance_from_0_decides_the_direction_of_a_shift():
    for start, step, verdict in ((0.2, -0.2, "better"), (0.1, -0.3, "worse"), (-0.2, 0.15, "better")):
        families, decision = judged(base={"shift_y_m": start}, shift_y_m=step)
        assert (families["position"].verdict, decision) == (verdict, verdict)


def test_points_that_are_lost_are_not_better_because_fewer_are_wrong():
    families, decision = judged(covered_real_0p3m=-0.05, covered_sim_0p3m=0.03, n_sim_points=-3000, cdc_mean=-0.02)
    assert families["surface missing"].verdict == "worse"
    assert families["surface invented"].why == families["objects"].why == "follows from surface missing"
    assert decision == "worse"


def test_smeared_points_are_not_better_because_they_cover_more():
    families, decision = judged(covered_real_0p3m=0.01, covered_sim_0p3m=-0.02, covered_sim_0p1m=-0.02)
    assert families["surface invented"].verdict == "worse"
    assert families["surface missing"].why == "follows from surface invented"
    assert decision == "worse"


def test_much_right_surface_with_a_little_wrong_one_is_mixed():
    families, decision = judged(covered_real_0p3m=0.1, covered_sim_0p3m=-0.01, n_sim_points=3000)
    assert [families[f"surface {what}"].verdict for what in ("missing", "invented")] == ["better", "worse"]
    assert decision == "mixed"


def test_a_shift_that_is_fixed_next_to_objects_that_are_lost_is_mixed():
    families, decision = judged(base={"shift_x_m": 0.3}, shift_x_m=-0.3, n_missing_pieces=2.0)
    assert (families["position"].verdict, families["surface missing"].verdict, decision) == ("better", "worse", "mixed")


def test_a_displacement_that_shrinks_while_both_surfaces_get_worse_does_not_count():
    steps = {"shift_x_m": -0.1, "covered_real_0p3m": -0.05, "covered_sim_0p3m": -0.05}
    families, decision = judged(base={"shift_x_m": 0.2}, **steps)
    assert (families["position"].why, decision) == ("both surfaces lie farther apart", "worse")


def test_scores_of_one_family_that_move_both_ways_are_mixed():
    families, decision = judged(cdc_mean=-0.05, found=-0.2)
    assert (families["objects"].verdict, decision) == ("mixed", "mixed")


def test_roughness_shows_a_loss_but_no_gain_and_nothing_where_points_are_lost():
    families, decision = judged(roughness_bias_m=0.02)
    assert (families["surface noise"].verdict, decision) == ("worse", "worse")
    families, decision = judged(base={"roughness_bias_m": -0.03}, roughness_bias_m=0.02)
    assert (families["surface noise"].why, decision) == ("roughness alone is not fidelity", "undecided")
    families, decision = judged(roughness_bias_m=0.02, n_sim_points=-2000)
    assert (families["surface noise"].why, decision) == ("follows from the number of points", "undecided")


def test_range_noise_is_best_where_it_is_the_real_one():
    noise = {"sensor_real_range_noise_m": 0.02, "sensor_sim_range_noise_m": 0.0}
    assert judged(base=noise, sensor_sim_range_noise_m=0.02)[1] == "better"
    assert judged(base=noise, sensor_sim_range_noise_m=0.06)[1] == "worse"


RAYS = {"rays_same": 0.7, "rays_in_front": 0.1, "rays_behind": 0.1, "rays_dropped": 0.05, "rays_no_surface": 0.0}
RAYS |= {"rays_sim_only": 0.05, "rays_bias_m": 0.0, "rays_scale": 0.0}


def test_lost_returns_solid_foliage_and_a_wrong_range_are_worse():
    for steps in (
        {"rays_same": -0.2, "rays_dropped": 0.2},
        {"rays_same": -0.1, "rays_in_front": 0.1},
        {"rays_bias_m": 0.1, "rays_scale": 0.01},
    ):
        families, decision = judged(base=RAYS, **steps)
        assert (families["rays"].verdict, decision) == ("worse", "worse")


def test_of_opposed_scores_of_rays_the_sum_counts():
    families, decision = judged(base=RAYS, rays_same=0.05, rays_in_front=0.02, rays_behind=-0.07)
    assert (families["rays"].verdict, decision) == ("better", "better")
    assert {score.name: score.why for score in families["rays"].scores if score.why} == {
        "simulated in front": "follows from simulated behind"
    }
    families, decision = judged(base=RAYS, rays_same=-0.05, rays_dropped=0.08, rays_sim_only=-0.03)
    assert (families["rays"].verdict, decision) == ("worse", "worse")


def test_rays_of_a_displaced_simulation_do_not_count():
    steps = {
        "shift_z_m": 0.12,
        "ground_sim_peak_m": 0.12,
        "rays_same": 0.3,
        "rays_behind": -0.35,
        "rays_sim_only": 0.05,
    }
    families, decision = judged(base=RAYS | {"shift_z_m": -0.12, "ground_sim_peak_m": -1.82}, **steps)
    assert (families["position"].verdict, families["rays"].why, decision) == (
        "better",
        "a displaced simulation is paired with other rays",
        "better",
    )


@pytest.mark.parametrize(
    "moved", [("range bias",), ("range scale", "range bias"), ("height",), ("height", "range bias")]
)
def test_longer_ranges_alone_are_no_displacement(moved):
    base = RAYS | {"rays_bias_m": 0.0}
    families, decision = judged(base=base, moved=moved, shift_z_m=-0.05, rays_bias_m=0.1)
    assert decision == "worse"
    if "height" in moved:
        assert (families["position"].verdict, families["rays"].why) == (
            "worse",
            "a displaced simulation is paired with other rays",
        )
    else:
        assert families["position"].why == "follows from rays: longer or shorter ranges alone"
        assert (families["rays"].verdict, families["rays"].why) == ("worse", "")


def test_a_position_counts_where_no_rays_show_longer_ranges():
    families, decision = judged(moved=("range bias",), shift_z_m=-0.05)
    assert (families["position"].verdict, families["position"].why, decision) == ("worse", "", "worse")


def test_an_intensity_that_depends_on_range_alone_is_worse():
    base = {"intensity_rank_distance": 0.02, "intensity_ratio": 1.0}
    base |= {"intensity_real_by_range": 0.1, "intensity_sim_by_range": 0.15}
    families, decision = judged(base=base, intensity_rank_distance=0.25, intensity_sim_by_range=0.84)
    assert (families["intensity"].verdict, decision) == ("worse", "worse")


def test_half_the_beams_are_worse():
    families, decision = judged(8, sensor_sim_beams=-32)
    assert (families["sensor"].verdict, decision) == ("worse", "worse")
    assert families["sensor"].scores[0].difference.after == pytest.approx(0.5, abs=0.05)


def test_no_simulator_is_better_while_a_family_tends_to_the_worse():
    assert judged(base={"shift_x_m": 0.3}, shift_x_m=-0.3)[1] == "better"
    rises = (0.02, 0.03, -0.005, 0.03, 0.02, 0.0, 0.03, 0.01, 0.02, -0.005)
    first = PERFECT | {"shift_x_m": 0.3}
    rows = {
        str(i): (first, first | {"shift_x_m": 0.0, "cdc_mean": 0.3 + rise, "covered_real_1m": 0.8 + 0.01 * (-1) ** i})
        for i, rise in enumerate(rises)
    }
    found = judge_families("reference", rows, np.arange(10, dtype=np.int32))
    families = {family.name: family for family in found}
    assert (families["objects"].verdict, families["objects"].tendency) == ("undecided", "worse")
    assert overall(found) == "mixed"


def test_columns_that_are_null_in_all_pairs_are_left_out():
    families, _ = judged(base={"sensor_sim_beams": None, "n_missing_pieces": None, "missing_pieces_share": None})
    assert "sensor" not in families
    assert [score.name for score in families["surface missing"].scores] == [
        f"real covered {reach} m" for reach in ("0.3", "1", "0.1")
    ]


def test_preset_paper_compares_the_match_rate():
    names = {
        preset: {score.name for score in judged(preset=preset)[0]["objects"].scores}
        for preset in ("paper", "reference")
    }
    assert names["paper"] - names["reference"] == {"match rate"}
    assert names["reference"] - names["paper"] == {"objects found"}


def test_a_change_that_seeds_alone_make_is_undecided():
    first = dict(PERFECT)
    rows = {str(i): (first, first | {"cdc_mean": 0.32 + 0.001 * i}) for i in range(10)}
    blocks = np.arange(10, dtype=np.int32)
    assert overall(judge_families("reference", rows, blocks, {"cdc_mean": 0.01})) == "worse"
    assert overall(judge_families("reference", rows, blocks, {"cdc_mean": 0.1})) == "undecided"


def changed_in(n_changed, n_frames=10):
    """The decision on frames of one place if the coverage of some of its eight sectors falls."""
    rng = np.random.default_rng(1)
    rows, parts = {}, {}
    for i in range(n_frames):
        steps = -0.1 * (np.arange(8) < n_changed) + rng.normal(0, 0.002, 8)
        rows[str(i)] = PERFECT, PERFECT | {"covered_real_0p3m": 0.8 + steps.mean()}
        for k, step in enumerate(steps):
            parts[f"{i}/{k}"] = {"covered_real_0p3m": 0.8}, {"covered_real_0p3m": 0.8 + step}
    sectors = parts, np.tile(np.arange(8, dtype=np.int32), n_frames)
    own = np.arange(n_frames, dtype=np.int32)
    return overall(judge_families("reference", rows, own)), overall(
        judge_families("reference", rows, own, None, None, sectors)
    )


def test_neighbouring_frames_decide_what_changed_in_all_directions():
    assert changed_in(8) == ("worse", "worse")


def test_neighbouring_frames_do_not_decide_what_changed_at_one_place():
    assert changed_in(1) == ("worse", "undecided")
