"""`fidpipe ablate`: what is tried, and that work is shared."""

import json

import numpy as np
import pandas as pd
import pytest
from matplotlib.image import imread

from fidpipe.pipeline.datasets.readers import read_scan
from fidpipe.pipeline.evaluate import evaluate_pair
from fidpipe.pipeline.jobs import graph_job
from fidpipe.pipeline.paper.ablate import (
    ParameterSet,
    ablate_dataset,
    means_along,
    parameter_sets,
)
from fidpipe.schemas.errors import DatasetError, RunError, SettingsError
from fidpipe.schemas.metric_catalogue import OBJECT_METRICS
from fidpipe.schemas.settings import load
from runs import QUIET, command
from scenes import write_bin

N_POINTS = 100

SETTINGS = load(None, ["graph.k=12"])
VALUES = {"k": (8, 12), "tau_m": (0.2,), "delta_m": (0.5, 5.0), "t": (0.5, 1.0)}


def ablated(dataset, out, **options):
    return ablate_dataset(
        dataset, out, SETTINGS, QUIET, **{"values": VALUES, "n_workers": 1, **options}
    )


@pytest.fixture(scope="module")
def done(dataset, tmp_path_factory):
    return ablated(dataset, tmp_path_factory.mktemp("ablate") / "run")


def test_a_finished_ablation_takes_further_pairs_and_other_values_only_if_asked(
    done, dataset, tmp_path
):
    out = tmp_path / "run"
    ablated(dataset, out, pattern="000")
    assert ablated(dataset, out).tables["ablate"].equals(done.tables["ablate"])
    record = (out / "run.json").read_bytes()
    for options, why in (
        ({"values": VALUES | {"k": (10,)}}, r"ablate.k was \[8, 12\], is \[10, 12\]"),
    ):
        with pytest.raises(RunError, match=why):
            ablated(dataset, out, **options)
    assert (out / "run.json").read_bytes() == record
    assert ablated(dataset, out, pattern="000").tables["ablate"].equals(done.tables["ablate"])
    more = VALUES | {"delta_m": (0.5, 3.0, 5.0)}
    wider = ablated(dataset, out, values=more, replace=True)
    assert set(wider.tables["ablate"].column("delta_m").to_pylist()) == {0.5, 3.0, 5.0}


def test_one_setting_moves_at_a_time():
    base = ParameterSet(90, 0.2, 5.0, 1.0)
    values = {"k": (60, 90), "tau_m": (0.2, 0.3), "delta_m": (5.0,), "t": (0.5, 1.0, 2.0)}
    assert len(parameter_sets(base, values)) == 1 + 1 + 1 + 0 + 2


def test_a_graph_is_built_once_for_each_pair_side_and_graph_setting(
    dataset, tmp_path, monkeypatch
):
    built = []

    def counted(points, settings):
        built.append((len(points), settings.k, settings.tau_m))
        return build_graph(points, settings)

    build_graph = graph_job.build_graph
    monkeypatch.setattr(graph_job, "build_graph", counted)
    outcome = ablated(dataset, tmp_path / "run")
    assert outcome.tables["ablate"].num_rows == 2 * (1 + 1 + 1 + 1)
    assert len(built) == len(set(built)) == 2 * 2 * 2  # pairs, sides, values of k
    built.clear()
    ablated(dataset, tmp_path / "run")
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
            assert row[f"{metric}_mean"] == pytest.approx(
                summary[f"{metric}_mean"], rel=1e-12
            ), (
                metric,
                words,
            )


def test_two_workers_give_the_same_rows(done, dataset, tmp_path):
    assert (
        ablated(dataset, tmp_path / "run", n_workers=2)
        .tables["ablate"]
        .equals(done.tables["ablate"])
    )


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
    assert (
        json.loads((tmp_path / "run" / "run.json").read_text())["failures"] == outcome.failures
    )
    assert set(outcome.tables["ablate"].column("pair_id").to_pylist()) == {"000"}


def test_a_wrong_value_is_refused_before_any_work(dataset, tmp_path):
    with pytest.raises(SettingsError, match="graph.k.*got 0"):
        ablated(dataset, tmp_path / "run", values={"k": (0,)})
    with pytest.raises(SettingsError, match="graph.k.*7.5"):
        ablated(dataset, tmp_path / "run", values={"k": (7.5,)})
    with pytest.raises(DatasetError, match=r"000\.bin"):
        ablated(dataset / "real" / "000.bin", tmp_path / "run")
    with pytest.raises(DatasetError, match=r"x\*"):
        ablated(dataset, tmp_path / "run", pattern="x*")
    assert not (tmp_path / "run").exists()


def test_diffusion_time_cannot_change_the_match_rate(done):
    along = means_along(done, "t").query("metric == 'match_rate'")
    assert len(along) == 2
    assert along["mean"].nunique() == 1


def test_the_command_prints_a_table_and_draws_its_figure(dataset, tmp_path):
    words = (
        "--workers",
        1,
        "--set",
        "graph.k=12",
        "--k",
        "8",
        "--tau",
        "0.2",
        "--delta",
        "5",
        "--t",
        "1",
    )
    result = command("ablate", dataset, *words, cwd=tmp_path, code=0)
    assert "graph.k: " in result.stdout
    assert (
        len(pd.read_parquet(tmp_path / "runs" / "streets-ablate" / "ablate.parquet")) == 2 * 2
    )
    picture = imread(tmp_path / "runs" / "streets-ablate" / "ablate.png")
    assert len(np.unique(picture.reshape(-1, picture.shape[-1]), axis=0)) > 50


def test_an_option_without_numbers_is_named(dataset, tmp_path):
    result = command("ablate", dataset, "--tau", "a,b", cwd=tmp_path, code=2)
    assert "--tau: expected numbers with commas, got 'a,b'" in result.stderr
