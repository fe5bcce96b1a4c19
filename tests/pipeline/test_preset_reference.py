"""Runs whose objects are fixed on the real side, from the command to the report."""

import json

import numpy as np
import pandas as pd
import pytest

from fidpipe.pipeline.results.compare import compare_runs
from fidpipe.pipeline.results.finished import FinishedRun
from fidpipe.pipeline.results.gate import judge_run, parse_word
from fidpipe.schemas.errors import SettingsError
from fidpipe.schemas.settings import load, overrides, parse, preset_of
from fidpipe.schemas.settings_text import to_toml
from recompute import recompute
from runs import command, run, tables
from scenes import box, drifted, street, write_bin, write_pair


def test_the_terminal_the_comparison_and_the_gate_take_it(by_reference):
    out = by_reference
    shown = command("show", out, "--all", code=0)
    assert "By range and class" in shown.stdout
    (comparison,) = compare_runs([out, out])
    assert comparison.on_partition == ""
    assert not comparison.unfollowed
    result = judge_run(
        out,
        [parse_word("covered.real.0.3m.mean=0.1", "min"), parse_word("shift_m.max=9", "max")],
    )
    assert result.passed
    assert not any("partition" in note for note in result.notes)


def test_seeds_ablation_and_perturbation_take_it(dataset, tmp_path):
    words = ["--preset", "reference", "--workers", 1]
    command(
        "run",
        dataset,
        "--out",
        tmp_path / "seeds",
        "--pairs",
        "001",
        "--seeds",
        2,
        *words,
        code=0,
    )
    table = pd.read_parquet(tmp_path / "seeds" / "seeds")
    row = tables(tmp_path / "seeds")["pairs.parquet"].to_pylist()[0]
    assert table.match_rate[0] == row["match_rate"]
    sweep = ["--sweep", "dropout=0.3", "--repeats", 1, "--global-repeats", 1]
    command("perturb", dataset, "--out", tmp_path / "perturb", *sweep, *words, code=0)
    rows = pd.read_parquet(tmp_path / "perturb" / "perturb_global.parquet")
    assert (rows.match_rate == 1).all()  # nothing is missing from a copy that has lost points
    ablation = ("ablate", dataset, "--out", tmp_path / "ablate", "--pairs", "001", *words)
    command(*ablation, "--k", "60,90", "--tau", "0.2", "--t", "1", code=0)
    assert set(pd.read_parquet(tmp_path / "ablate" / "ablate.parquet").delta_m) == {5.0}
    refused = command(*ablation, "--delta", "1,9", code=1)
    assert "are not matched by distance" in refused.stderr


@pytest.mark.parametrize(
    ("word", "left_out"), [((), {"0"}), (("communities.leave_out=0,2",), {"0", "2"})]
)
def test_points_of_classes_that_are_left_out_belong_to_no_object(tmp_path, word, left_out):
    scan = street(seed=1)
    write_pair(tmp_path, scan, drifted(scan))
    # classes 0, 1 and 2
    np.digitize(scan[:, 0], [-5, 3]).astype("<u4").tofile(tmp_path / "real" / "a.label")
    settings = load(None, ["communities.reference=labels", *word], preset="reference")
    outcome = run(tmp_path, tmp_path / "run", settings)
    assert not outcome.failures
    own = {
        side: pd.read_parquet(tmp_path / "run" / "ground" / f"a.{side}.parquet").merge(
            pd.read_parquet(tmp_path / "run" / "communities" / f"a.{side}.parquet"),
            on="point_id",
        )
        for side in ("real", "sim")
    }
    assert set(own["real"].label[own["real"].community_id == -1]) == left_out
    assert not set(own["real"].label[own["real"].community_id >= 0]) & left_out
    assert (
        own["sim"].community_id[own["sim"].x < -5.5] == -1
    ).mean() > 0.9  # some lie out of reach
    objects = pd.read_parquet(tmp_path / "run" / "objects" / "a.real.parquet")
    assert set(objects.label) == {"0", "1", "2"} - left_out
    assert (
        objects.n_points.tolist()
        == own["real"].query("community_id >= 0").community_id.value_counts().tolist()
    )
    coverage = pd.read_parquet(tmp_path / "run" / "coverage" / "a.parquet")
    assert coverage.n_points[coverage.community_id.isna()].tolist() == [
        len(own["real"]),
        len(own["sim"]),
    ]
    assert [
        difference for difference in recompute(tmp_path / "run") if difference.is_too_large
    ] == []


@pytest.mark.parametrize("kind", ["labels", "instances"])
def test_an_input_without_labels_fails_with_the_next_step(dataset, tmp_path, kind):
    settings = load(None, [f"communities.reference={kind}"], preset="reference")
    (reason, *_) = run(dataset, tmp_path / "run", settings).failures.values()
    assert f"the real scan has no {kind}" in reason
    assert "communities.reference=louvain" in reason


@pytest.mark.parametrize(
    ("preset", "words", "named", "departing"),
    [
        ("paper", [], "paper", []),
        ("reference", [], "reference", []),
        (
            "reference",
            ["graph.k=60", "communities.reach_m=0.5"],
            "reference",
            ["graph.k=60", "communities.reach_m=0.5"],
        ),
        (
            "paper",
            ["communities.objects=reference"],
            "reference",
            ["ground.peak=own", "graph.ties=point_id"],
        ),
    ],
)
def test_a_run_is_named_by_its_preset_and_what_departs_from_it(preset, words, named, departing):
    settings = load(None, words, preset=preset)
    assert (preset_of(settings), overrides(settings)) == (named, departing)
    if departing:
        assert load(None, overrides(settings), preset=named) == settings


def test_a_preset_that_is_not_there_or_not_in_the_file_is_named(tmp_path):
    with pytest.raises(SettingsError, match="'papr'.*did you mean paper"):
        load(None, preset="papr")
    named = tmp_path / "named.toml"
    named.write_text('preset = "reference"\n[graph]\nk = 60\n')
    assert overrides(load(named)) == ["graph.k=60"]
    assert load(named) == parse({"preset": "reference", "graph": {"k": 60}})
    full = tmp_path / "settings.toml"
    full.write_text(to_toml(load(None)))
    with pytest.raises(SettingsError, match="communities.objects = 'independent'"):
        load(full, preset="reference")
    with pytest.raises(SettingsError, match='expected objects = "reference" with reference'):
        load(None, ["communities.reference=labels"])


def test_road_that_only_one_cut_left_is_counted(tmp_path):
    """The simulated road lies 0.5 m lower but for a patch, which stays an object and is road on the real side."""
    patch = np.random.default_rng(1).uniform([8, 8, -1.72], [12, 12, -1.68], (200, 3))
    house = box([-10, 0, 0], [4, 4, 2], 300)
    rest = np.random.default_rng(2).uniform([-20, -20, -0.01], [20, 20, 0.01], (4000, 3))
    write_bin(tmp_path / "data/real/000.bin", np.vstack([rest - [0, 0, 1.7], patch, house]))
    write_bin(tmp_path / "data/sim/000.bin", np.vstack([rest - [0, 0, 2.2], patch, house]))
    run(tmp_path / "data", tmp_path / "run", load(None, ["ground.max_variance_loss=1"]))
    coverage = pd.read_parquet(tmp_path / "run" / "coverage").query("side == 'sim'")
    matching = pd.read_parquet(tmp_path / "run" / "matching").query("status == 'extra'")
    of_object = coverage.dropna(subset="community_id").set_index("community_id").road_share
    invented = of_object[matching.sim_id.astype(int)]
    assert (invented == 1).sum() >= 1
    assert set(of_object) <= {0.0, 1.0}


def test_missing_and_invented_objects_are_told_alike_everywhere(by_reference):
    pairs = pd.read_parquet(by_reference / "pairs.parquet")
    row = pairs.iloc[0]
    matching = pd.read_parquet(by_reference / "matching" / "0.parquet")
    objects = {
        side: pd.read_parquet(by_reference / "objects" / f"0.{side}.parquet")
        for side in ("real", "sim")
    }
    counts = matching.status.value_counts()
    assert counts.get("not_found", 0) == row["n_not_found"] > 0
    assert counts.get("extra", 0) == row["n_extra"] > 0
    assert (matching.sim_id[matching.status == "extra"] >= len(objects["real"])).all()
    empty = objects["sim"].n_points == 0
    assert objects["sim"].loc[empty, ["cx", "range_m", "linearity"]].isna().all(axis=None)
    found = FinishedRun(by_reference).pair("0")["objects"]
    assert len([of for of in found if of["real"] is None]) == row["n_extra"]
    findings = json.loads((by_reference / "run.json").read_text())["findings"]
    n_extra = sum(of["n_extra"] for of in findings["groups"] if of["by"] == "range")
    assert n_extra == pairs.n_extra.sum()
