"""`fidpipe ablate`: what is tried, that work is shared, and which setting is chosen."""

import json
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from matplotlib.image import imread

from fidpipe.pipeline.datasets.readers import read_scan
from fidpipe.pipeline.evaluate import evaluate_pair
from fidpipe.pipeline.paper.ablate import ablate_dataset, choose, means_along, parameter_sets
from fidpipe.schemas.errors import DatasetError, RunError, SettingsError
from fidpipe.schemas.metric_catalogue import OBJECT_METRICS
from fidpipe.schemas.settings import load
from fidpipe.schemas.tables import TABLES
from fidpipe.stages import method
from fidpipe.stages.paper.parameter_choice import ParameterSet
from runs import QUIET, command
from scenes import write_bin

N_POINTS = 100

SETTINGS = load(None, ["graph.k=12"])
VALUES = {"k": (8, 12), "tau_m": (0.2,), "delta_m": (0.5, 5.0), "t": (0.5, 1.0)}


def ablated(dataset, out, **options):
    return ablate_dataset(dataset, out, SETTINGS, QUIET, **{"values": VALUES, "n_workers": 1, **options})


@pytest.fixture(scope="module")
def done(dataset, tmp_path_factory):
    return ablated(dataset, tmp_path_factory.mktemp("ablate") / "run")


def test_a_finished_ablation_takes_further_pairs_and_other_values_only_if_asked(done, dataset, tmp_path):
    out = tmp_path / "run"
    ablated(dataset, out, pattern="000")
    assert ablated(dataset, out).tables["ablate"].equals(done.tables["ablate"])
    record = (out / "run.json").read_bytes()
    for options, why in (
        ({"grid": True}, "grid was False, is True"),
        ({"values": VALUES | {"k": (10,)}}, r"values was .* is .*10, 12"),
        ({"pattern": "000"}, "pairs 001 not requested"),
    ):
        with pytest.raises(RunError, match=why):
            ablated(dataset, out, **options)
    assert (out / "run.json").read_bytes() == record
    more = VALUES | {"delta_m": (0.5, 3.0, 5.0)}
    wider = ablated(dataset, out, values=more, replace=True)
    assert set(wider.tables["ablate"].column("delta_m").to_pylist()) == {0.5, 3.0, 5.0}


def test_one_setting_moves_at_a_time_or_all_of_them_do():
    base = ParameterSet(90, 0.2, 5.0, 1.0)
    values = {"k": (60, 90), "tau_m": (0.2, 0.3), "delta_m": (5.0,), "t": (0.5, 1.0, 2.0)}
    assert len(parameter_sets(base, values, grid=False)) == 1 + 1 + 1 + 0 + 2
    assert len(parameter_sets(base, values, grid=True)) == 2 * 2 * 1 * 3


def test_a_graph_is_built_once_for_each_pair_side_and_graph_setting(dataset, tmp_path, monkeypatch):
    built = []

    def counted(points, settings):
        built.append((len(points), settings.k, settings.tau_m))
        return build_graph(points, settings)

    build_graph = method.build_graph
    monkeypatch.setattr(method, "build_graph", counted)
    outcome = ablated(dataset, tmp_path / "run", grid=True)
    assert outcome.tables["ablate"].num_rows == 2 * 2 * 2 * 2
    assert len(built) == len(set(built)) == 2 * 2 * 2  # pairs, sides, values of k
    built.clear()
    ablated(dataset, tmp_path / "run", grid=True)
    assert built == []


def test_a_row_has_the_numbers_of_an_evaluation_under_its_settings(done, dataset):
    scans = [read_scan(dataset / side / "001.bin").points for side in ("real", "sim")]
    rows = done.tables["ablate"].to_pandas().query("pair_id == '001'")
    for _, row in rows.iterrows():
        words = [f"graph.k={row.k}", f"matching.delta_m={row.delta_m}", f"selection.t={row.t}"]
        summary = evaluate_pair(*scans, load(None, words)).summary
        assert row.match_rate == summary["match_rate"]
        assert row.n_communities_sim == summary["n_communities_sim"]
        for metric in OBJECT_METRICS:
            assert row[f"{metric}_mean"] == pytest.approx(summary[f"{metric}_mean"], rel=1e-12), (metric, words)


def test_two_workers_give_the_same_rows(done, dataset, tmp_path):
    assert ablated(dataset, tmp_path / "run", n_workers=2).tables["ablate"].equals(done.tables["ablate"])


def test_simulated_points_are_moved_into_the_real_frame(done, dataset, tmp_path):
    moved = tmp_path / "moved"
    for side, shift_m in (("real", 0.0), ("sim", 1.0)):
        points = read_scan(dataset / side / "001.bin").points
        write_bin(moved / side / "001.bin", points - [shift_m, 0.0, 0.0])
    motion = "1 0 0 1 0 1 0 0 0 0 1 0"
    manifest = f"pair_id,real,sim,T_real_sim\n001,real/001.bin,sim/001.bin,{motion}\n"
    (moved / "pairs.csv").write_text(manifest)
    expected = done.tables["ablate"].to_pandas().query("pair_id == '001'")
    rows = ablated(moved, tmp_path / "run").tables["ablate"].to_pandas()
    assert rows.match_rate.to_numpy() == pytest.approx(expected.match_rate.to_numpy())


def test_a_broken_pair_is_listed_and_the_others_are_there(data, tmp_path):
    (data / "sim" / "001.bin").write_bytes(b"")
    outcome = ablated(data, tmp_path / "run")
    assert list(outcome.failures) == ["001"]
    assert json.loads((tmp_path / "run" / "run.json").read_text())["failures"] == outcome.failures
    assert set(outcome.tables["ablate"].column("pair_id").to_pylist()) == {"000"}


def test_a_wrong_value_is_refused_before_any_work(dataset, tmp_path):
    with pytest.raises(SettingsError, match="graph.k.*got 0"):
        ablated(dataset, tmp_path / "run", values={"k": (0,)})
    with pytest.raises(SettingsError, match="graph.k.*7.5"):
        ablated(dataset, tmp_path / "run", values={"k": (7.5,)})
    with pytest.raises(SettingsError, match=r"000\.bin"):
        ablated(dataset / "real" / "000.bin", tmp_path / "run")
    with pytest.raises(DatasetError, match=r"x\*"):
        ablated(dataset, tmp_path / "run", pattern="x*")
    assert not (tmp_path / "run").exists()


def made_up(done, rates, r_lambdas):
    """An outcome over k = 30, 60, 90 with these scores, a column a pair."""
    rows = [
        {
            "pair_id": f"{pair}",
            **ParameterSet(k, 0.2, 5.0, 1.0)._asdict(),
            **dict.fromkeys(("n_communities_real", "n_communities_sim", "n_matched"), 1),
            "match_rate": rate,
            "r_lambda_mean": r_lambda,
        }
        for k, of_rate, of_lambda in zip((30, 60, 90), rates, r_lambdas, strict=True)
        for pair, (rate, r_lambda) in enumerate(zip(of_rate, of_lambda, strict=True))
    ]
    values = {"k": (30, 60, 90), "tau_m": (0.2,), "delta_m": (5.0,), "t": (1.0,)}
    request = {"base": [90, 0.2, 5.0, 1.0], "values": values, "grid": False}
    return replace(done, request=request, tables={"ablate": TABLES["ablate"].from_rows(rows)})


BETTER = [0.80, 0.83, 0.79, 0.80]
USUAL = [0.60, 0.62, 0.59, 0.61]
WORSE = [0.50, 0.52, 0.48, 0.51]
ALIKE = [[0.60, 0.70, 0.50, 0.62], [0.66, 0.61, 0.59, 0.57], [0.58, 0.69, 0.55, 0.60]]
LOWER = [[0.30, 0.31, 0.29, 0.30], [0.40, 0.42, 0.39, 0.41], [0.36, 0.37, 0.35, 0.36]]


@pytest.mark.parametrize(
    ("rates", "r_lambdas", "k", "text"),
    [
        (ALIKE, [[0.4, 0.3, 0.35, 0.38]] * 3, None, "do not decide"),
        ([WORSE, BETTER, USUAL], [[0.4] * 4] * 3, 60, "match rate 0.805 against 0.605"),
        ([[0.6] * 4] * 3, LOWER, 30, "r_lambda 0.300 against 0.360"),
        ([WORSE, USUAL, BETTER], [[0.4] * 4] * 3, 90, "k = 90 stays"),
        (
            [[0.5, 0.5], [0.9, 0.9], [0.6, 0.6]],
            [[0.4, 0.4]] * 3,
            None,
            "got 2; k = 90 stays",
        ),
    ],
)
def test_the_match_rate_decides_then_r_lambda_and_the_value_in_force_stays_if_neither_does(
    done, rates, r_lambdas, k, text
):
    (choice,) = choose(made_up(done, rates, r_lambdas))
    assert (choice.chosen.k, choice.decided) == (k or 90, k is not None)
    assert text in choice.text


def test_delta_is_never_chosen(done):
    outcome = made_up(done, [[0.5] * 4] * 3, [[0.4] * 4] * 3)
    outcome.request["values"]["delta_m"] = (1.0, 5.0)
    assert [choice.name for choice in choose(outcome)] == ["k"]


def test_diffusion_time_cannot_change_the_match_rate(done):
    along = means_along(done, "t").query("metric == 'match_rate'")
    assert len(along) == 2
    assert along["mean"].nunique() == 1


def test_the_command_prints_a_choice_and_its_rule(dataset, tmp_path):
    words = ("--workers", 1, "--set", "graph.k=12", "--k", "8", "--tau", "0.2", "--delta", "5", "--t", "1")
    result = command("ablate", dataset, *words, cwd=tmp_path, code=0)
    assert "Rule: " in result.stdout
    assert len(pd.read_parquet(tmp_path / "runs" / "streets-ablate" / "ablate.parquet")) == 2 * 2
    picture = imread(tmp_path / "runs" / "streets-ablate" / "ablate.png")
    assert len(np.unique(picture.reshape(-1, picture.shape[-1]), axis=0)) > 50
