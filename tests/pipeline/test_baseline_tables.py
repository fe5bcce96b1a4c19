import io
import json
import shutil

import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest
from rich.console import Console

import fidpipe
from fidpipe.pipeline.engine.schedule import Policy
from fidpipe.pipeline.jobs import STAGES
from fidpipe.pipeline.jobs.baselines import summarise_baselines
from fidpipe.pipeline.report.render import terminal
from fidpipe.pipeline.report.views.run_view import baselines_view
from fidpipe.pipeline.results.status import run_status
from fidpipe.pipeline.storage.tables import JobRecord
from fidpipe.schemas.record import BaselineSummary
from fidpipe.schemas.settings import load
from fidpipe.schemas.tables import BASELINES
from runs import JOBS_PER_PAIR, assert_same_tables, changed_files, marks, run, run_twice

N_PAIRS = 3

ALL = load(None, ["metrics.baselines=all"])
FEW = load(None, ["metrics.baselines=chamfer,emd"])


@pytest.fixture(scope="module")
def both(dataset, tmp_path_factory):
    return run_twice(dataset, tmp_path_factory, ALL)


@pytest.fixture(scope="module")
def plain(both):
    return both[0]


@pytest.fixture(scope="module")
def compared(both):
    """The plain run, to which the baselines were added later."""
    return both[1:]


@pytest.fixture
def again(compared, tmp_path):
    return shutil.copytree(compared[0], tmp_path / "run")


def baselines(out):
    files = sorted((out / "baselines").glob("*.parquet"))
    return {path.stem: pq.read_table(path) for path in files}


def same(a, b):
    return a.keys() == b.keys() and all(a[name].equals(b[name]) for name in a)


def test_a_run_without_them_writes_none(plain):
    assert not (plain / "baselines").exists()
    assert "baselines" not in json.loads((plain / "run.json").read_text())


def test_adding_them_reuses_everything_else(plain, compared):
    out, outcome = compared
    assert (outcome.n_made, outcome.n_reused) == (3, 3 * JOBS_PER_PAIR)
    assert not changed_files(out, marks(plain))
    assert_same_tables(out, plain)


def test_a_fresh_run_with_them_gives_the_same_tables(dataset, compared, tmp_path):
    run(dataset, tmp_path / "run", ALL)
    assert_same_tables(tmp_path / "run", compared[0])
    assert same(baselines(tmp_path / "run"), baselines(compared[0]))


def test_there_is_a_row_for_each_object_and_each_pair_of_scans(compared):
    out, _ = compared
    metrics = pd.read_parquet(out / "metrics")
    assert list(baselines(out)) == ["000", "001", "002"]
    for pair_id, table in baselines(out).items():
        BASELINES.check(table)
        frame = table.to_pandas()
        n_matched = int((metrics.pair_id == pair_id).sum())
        assert (frame.real_id.notna().sum(), frame.real_id.isna().sum()) == (15 * n_matched, 10)
        assert frame.real_id.isna().to_numpy()[-10:].all()
        assert not frame.duplicated(["real_id", "sim_id", "baseline"]).any()
        assert frame[frame.value.isna()].reason.notna().all()


def test_centred_earth_movers_are_the_mean_distance_of_the_nodes_in_the_selection(compared):
    out, _ = compared
    points = pd.read_parquet(out / "ground").set_index(["pair_id", "side", "point_id"])[["x", "y", "z"]]
    frame = pd.read_parquet(out / "baselines").query("baseline == 'emd_centred_mean_m'")
    found = frame.set_index(["pair_id", "real_id"]).value
    for (pair_id, real_id), own in pd.read_parquet(out / "selection").groupby(["pair_id", "real_id"]):
        real, sim = (points.loc[pair_id, side].loc[own[f"{side}_point_id"]].to_numpy() for side in ("real", "sim"))
        apart = (real - real.mean(axis=0)) - (sim - sim.mean(axis=0))
        assert found[pair_id, real_id] == pytest.approx(np.linalg.norm(apart, axis=1).mean())


def test_seconds_are_in_the_timings_one_step_a_baseline(compared):
    timings = pd.read_parquet(compared[0] / "timings.parquet").query("stage == 'baselines'")
    steps = set(timings.step)
    assert set(ALL.metrics.baselines) <= steps
    assert {f"{name}, whole scan" for name in ("chamfer", "dcd", "icp", "sliced_wasserstein")} <= steps
    assert not {"emd, whole scan", "r_h, whole scan"} & steps


def test_what_a_run_made_is_new_in_its_timings_and_all_else_reused(again, dataset):
    def reused():
        timings = pd.read_parquet(again / "timings.parquet")
        return {stage: set(own) for stage, own in timings.groupby("stage").reused}

    run(dataset, again, ALL, from_stage="baselines")
    first = reused()
    assert first.pop("baselines") == {False}
    assert set().union(*first.values()) == {True}
    run(dataset, again, ALL)
    assert set().union(*reused().values()) == {True}
    run(dataset, again)
    assert "baselines" not in reused()
    run(dataset, again, ALL)
    assert reused()["baselines"] == {True}


def test_the_record_holds_means_over_pairs_of_means_over_objects(compared):
    out, outcome = compared
    frame = pd.read_parquet(out / "baselines")
    summary = {(row["baseline"], row["level"]): row for row in outcome.record.as_dict()["baselines"]}
    assert json.loads((out / "run.json").read_text())["baselines"] == outcome.record.as_dict()["baselines"]
    for name in ("chamfer_mean_m", "dcd", "icp_rmse_m"):
        of_objects = frame[(frame.baseline == name) & frame.real_id.notna()]
        means = of_objects.groupby("pair_id").value.mean()
        row = summary[name, "objects"]
        assert (row["mean"], row["std"]) == (pytest.approx(means.mean()), pytest.approx(means.std()))
        assert (row["n"], row["n_null"]) == (of_objects.value.notna().sum(), of_objects.value.isna().sum())
        of_scans = frame[(frame.baseline == name) & frame.real_id.isna()].value
        assert summary[name, "scans"]["mean"] == pytest.approx(of_scans.mean())


def test_a_second_run_makes_nothing(again, dataset):
    assert run(dataset, again, ALL).n_made == 0
    assert run_status(again).stages["baselines"] == {"done": 3}


def test_other_baselines_make_only_their_tables_again(again, dataset):
    before = marks(again)
    assert run(dataset, again, FEW).n_made == 3
    assert not changed_files(again, before)
    assert {name for table in baselines(again).values() for name in table["baseline"].to_pylist()} == {
        "chamfer_mean_m",
        "chamfer_squared_m2",
        "chamfer_one_way_sum_m",
        "emd_mean_m",
        "emd_kept_mean_m",
        "emd_centred_mean_m",
    }


def test_the_order_in_which_they_are_named_changes_nothing(again, dataset):
    run(dataset, again, FEW)
    assert run(dataset, again, load(None, ["metrics.baselines=emd,chamfer,emd"])).n_made == 0


def test_they_stay_while_they_are_true_and_go_when_the_results_change(again, dataset):
    before = baselines(again)
    assert run(dataset, again).n_made == 0
    assert same(baselines(again), before)
    run(dataset, again, load(None, ["matching.delta_m=3"]))
    assert not baselines(again)


def test_a_damaged_table_is_made_again(again, dataset, compared):
    path = again / "baselines" / "001.parquet"
    path.write_bytes(path.read_bytes()[:-9])
    assert run(dataset, again, ALL).n_made == 1
    assert same(baselines(again), baselines(compared[0]))


def test_asking_for_one_pair_keeps_the_scores_of_all(plain, dataset, tmp_path):
    out = shutil.copytree(plain, tmp_path / "run")
    outcome = run(dataset, out, FEW, pattern="001")
    assert list(baselines(out)) == ["001"]
    assert [row["status"] for row in outcome.rows] == ["scored"] * 3


def test_from_makes_them_again(again, dataset):
    assert run(dataset, again, ALL, from_stage="baselines").n_made == 3


def test_python_gives_the_same_numbers_as_the_command(compared, dataset):
    scans = [
        np.fromfile(dataset / side / "001.bin", dtype="<f4").reshape(-1, 4)[:, :3].astype(float)
        for side in ("real", "sim")
    ]
    result = fidpipe.evaluate_pair(*scans, settings=ALL)
    written = baselines(compared[0])["001"].to_pandas()
    pd.testing.assert_frame_equal(
        result.baselines.drop(columns="pair_id"), written.drop(columns="pair_id"), check_exact=True
    )
    assert result.summary["status"] == "scored"
    assert fidpipe.evaluate_pair(*scans).baselines is None


@pytest.mark.exhaustive
def test_two_workers_give_the_same_tables(dataset, compared, tmp_path):
    run(dataset, tmp_path / "run", ALL, workers=2, policy=Policy(worth_splitting_s=0.0))
    assert_same_tables(tmp_path / "run", compared[0])
    assert same(baselines(tmp_path / "run"), baselines(compared[0]))


def test_no_stage_of_the_scores_depends_on_their_settings():
    assert not any("metrics" in stage.settings for stage in STAGES)


def test_the_terminal_shows_each_baseline_with_its_time(compared):
    shown = io.StringIO()
    rows = [BaselineSummary.from_dict(row) for row in compared[1].record.as_dict()["baselines"]]
    Console(width=100, file=shown).print(terminal(baselines_view(rows)))
    text = shown.getvalue()
    for name in ("chamfer_squared_m2", "sliced_wasserstein_m", "icp_rmse_m", "netlsd", "r_h"):
        assert name in text
    assert "whole scans" in text
    assert "m²" in text


def test_a_baseline_that_is_null_in_every_object_has_no_mean():
    means = [{"level": "objects", "baseline": "netlsd", "unit": None, "mean": None, "n": 0, "n_null": 4}]
    record = JobRecord("baselines", "a", "", "key", {}, facts={"means": means}, steps=(("netlsd", 0.5),))
    (row,) = summarise_baselines([record], load(None, ["metrics.baselines=netlsd"]))
    assert (row["mean"], row["std"], row["n"], row["n_null"], row["seconds"]) == (None, None, 0, 4, 0.5)
