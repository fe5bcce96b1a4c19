"""Stages that a run has on demand (baselines, seeds and tasks): their tables, their record, and how long they stay."""

import json
import re
import shutil

import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest

import fidpipe
from fidpipe.pipeline.jobs.baselines_job import summarise_baselines
from fidpipe.pipeline.results.compare import compare_runs
from fidpipe.pipeline.results.measures import TASK_GAPS
from fidpipe.pipeline.results.status import run_status
from fidpipe.pipeline.storage.table_files import JobRecord
from fidpipe.schemas.metric_catalogue import SEEDED_SCORES
from fidpipe.schemas.settings import load
from fidpipe.schemas.tables import TABLES
from runs import JOBS_PER_PAIR, assert_same_tables, changed_tables, command, marks, run

BASELINE_WORD, SEED_WORD = "metrics.baselines=all", "stability.seeds=2"
ALL = load(None, [BASELINE_WORD, SEED_WORD, "tasks.names=all"])
EXTRAS = ("baselines", "seeds", "tasks")


@pytest.fixture(scope="module")
def folder(scenario):
    return scenario("extras")


@pytest.fixture(scope="module")
def dataset(folder):
    return folder / "streets"


@pytest.fixture(scope="module")
def finished(folder):
    """The run of two pairs with all extras; not to be written to."""
    return folder / "run"


@pytest.fixture(scope="module")
def record(finished):
    return json.loads((finished / "run.json").read_text())


def extras(out):
    """The tables of the extras by stage and pair."""
    return {
        (stage, path.stem): pq.read_table(path)
        for stage in EXTRAS
        for path in (out / stage).glob("*.parquet")
    }


def test_a_run_to_which_they_are_added_later_reuses_everything_else(
    dataset, finished, tmp_path
):
    out = tmp_path / "run"
    run(dataset, out)
    assert not set(EXTRAS) & (
        json.loads((out / "run.json").read_text()).keys() | set(out.iterdir())
    )
    before = marks(out)
    outcome = run(dataset, out, ALL)
    assert (outcome.n_made, outcome.n_reused) == (2 * len(EXTRAS), 2 * JOBS_PER_PAIR)
    assert changed_tables(out, before) == {*EXTRAS, "task_objects"}
    assert_same_tables(out, finished)
    assert extras(out) == extras(finished)
    assert run(dataset, out, ALL).n_made == 0
    assert [run_status(out).stages[stage] for stage in EXTRAS] == [{"done": 2}] * len(EXTRAS)


def test_the_seeds_of_a_pair_are_what_runs_under_them_give(dataset, finished, tmp_path):
    for seed in range(2):
        for row in run(
            dataset, tmp_path / str(seed), load(None, [f"communities.seed={seed}"])
        ).rows:
            found = (
                extras(finished)["seeds", row["pair_id"]]
                .to_pandas()
                .set_index("seed")
                .loc[seed]
            )
            assert {name: found[name] for name in SEEDED_SCORES} == {
                name: row[name] for name in SEEDED_SCORES
            }
    run(dataset, tmp_path / "run", load(None, [SEED_WORD, "communities.seed=7"]), pattern="000")
    (table,) = extras(tmp_path / "run").values()
    assert TABLES["seeds"].check(table.cast(TABLES["seeds"].schema))["seed"].to_pylist() == [
        7,
        8,
    ]


def test_the_record_holds_the_spread_over_seeds_and_pairs(finished, record):
    by_pair = pd.read_parquet(finished / "seeds").groupby("pair_id")
    assert (record["seeds"]["n_seeds"], record["seeds"]["n_pairs"]) == (2, 2)
    for name in SEEDED_SCORES:
        of = record["seeds"]["dataset"][name]
        mean = by_pair[name].mean()
        std = by_pair[name].std()
        assert (of["mean"], of["std_pairs"]) == (
            pytest.approx(mean.mean()),
            pytest.approx(mean.std()),
        )
        assert of["std_seeds"] == pytest.approx(np.sqrt((std**2).mean()))


def test_seconds_are_in_the_timings_one_step_a_baseline(finished):
    timings = pd.read_parquet(finished / "timings.parquet").query("stage == 'baselines'")
    steps = set(timings.step)
    assert set(ALL.metrics.baselines) <= steps


def test_what_a_run_made_is_new_in_its_timings_and_all_else_reused(again, dataset):
    def reused():
        timings = pd.read_parquet(again / "timings.parquet")
        return {stage: set(own) for stage, own in timings.groupby("stage").reused}

    assert run(dataset, again, ALL, from_stage="baselines").n_made == 2 * len(EXTRAS)
    first = reused()
    assert [first.pop(stage) for stage in EXTRAS] == [{False}] * len(EXTRAS)
    assert set().union(*first.values()) == {True}
    run(dataset, again, ALL)
    assert set().union(*reused().values()) == {True}
    run(dataset, again)
    assert "baselines" not in reused()
    run(dataset, again, ALL)
    assert reused()["baselines"] == {True}


def test_other_baselines_or_seeds_make_only_their_table_again(again, dataset):
    before = extras(again)
    main = marks(again)
    assert run(dataset, again, load(None, [BASELINE_WORD, "stability.seeds=3"])).n_made == 2
    for name, table in extras(again).items():
        assert table.slice(0, before[name].num_rows).equals(before[name])
    assert (
        run(
            dataset, again, load(None, ["metrics.baselines=chamfer,emd", "stability.seeds=3"])
        ).n_made
        == 2
    )
    names = {
        name
        for pair_id in ("000", "001")
        for name in extras(again)["baselines", pair_id]["baseline"].to_pylist()
    }
    chamfer = {"chamfer_mean_m", "chamfer_squared_m2", "chamfer_one_way_sum_m"}
    assert names == chamfer | {"emd_mean_m", "emd_kept_mean_m", "emd_centred_mean_m"}
    assert (
        run(
            dataset,
            again,
            load(None, ["metrics.baselines=emd,chamfer,emd", "stability.seeds=3"]),
        ).n_made
        == 0
    )
    assert changed_tables(again, main) == {"baselines", "seeds"}


def test_they_stay_while_they_are_true_and_go_when_the_results_change(again, dataset):
    before = extras(again)
    assert run(dataset, again).n_made == 0
    assert extras(again) == before
    run(dataset, again, load(None, ["ground.prior_m=0.4"]))
    assert not extras(again)


def test_asking_for_one_pair_keeps_the_scores_of_all(finished, dataset, tmp_path):
    out = shutil.copytree(finished, tmp_path / "run")
    shutil.rmtree(out / "baselines")
    outcome = run(dataset, out, load(None, ["metrics.baselines=chamfer"]), pattern="001")
    assert [path.stem for path in (out / "baselines").iterdir()] == ["001"]
    assert [row["status"] for row in outcome.rows] == ["scored"] * 2


def test_python_gives_the_same_numbers_as_the_command(finished, dataset):
    scans = [fidpipe.read_scan(dataset / side / "001.bin").points for side in ("real", "sim")]
    result = fidpipe.evaluate_pair(*scans, settings=ALL)
    assert result.summary["status"] == "scored"
    for stage, found in (("baselines", result.baselines), ("seeds", result.seeds)):
        written = extras(finished)[stage, "001"].to_pandas()
        pd.testing.assert_frame_equal(
            found.drop(columns="pair_id"), written.drop(columns="pair_id"), check_exact=True
        )
    plain = fidpipe.evaluate_pair(*scans)
    assert (plain.baselines, plain.seeds) == (None, None)


def test_the_command_takes_the_seeds_as_an_option_and_shows_both(again, dataset):
    words = ("--workers", 1, "--seeds", 2, "--set", BASELINE_WORD)
    done = command("run", dataset, "--out", again, *words, code=0)
    assert f"0 jobs done, {2 * (JOBS_PER_PAIR + 2)} reused" in done.stdout
    assert "How stable the scores are (2 seeds, 2 pairs)" in done.stdout
    for name in (
        "chamfer_squared_m2",
        "objects",
        "scans",
        "m²",
    ):
        assert name in done.stdout
    for word in ("match rate", "r_lambda", "repeatability limit"):
        assert word in done.stdout


def test_a_baseline_that_is_null_in_every_object_has_no_mean():
    means = [
        {
            "level": "objects",
            "baseline": "emd_mean_m",
            "unit": "m",
            "mean": None,
            "n": 0,
            "n_null": 4,
        }
    ]
    job = JobRecord("baselines", "a", "", "key", {}, metadata={"means": means})
    (row,) = summarise_baselines([job], load(None, ["metrics.baselines=emd"]))["baselines"]
    assert (row["mean"], row["std"], row["n"], row["n_null"]) == (None, None, 0, 4)


def test_the_obstacles_of_a_pair_are_those_of_its_gaps_and_join_its_objects(finished, record):
    gaps = (
        pd.read_parquet(finished / "tasks")
        .query("group == 'all'")
        .set_index(["pair_id", "task", "measure"])
    )
    obstacles = pd.read_parquet(finished / "task_objects")
    objects = pd.read_parquet(finished / "objects")
    keys = ["pair_id", "side", "community_id"]
    assert len(obstacles) == len(obstacles.merge(objects, on=keys, validate="m:1")) > 0
    for pair_id, of_pair in obstacles.groupby("pair_id"):
        for measure, side in (("lost", "real"), ("added", "sim")):
            fates = of_pair.loc[of_pair.side == side, "fate"]
            assert gaps.gap[pair_id, "objects", measure] == pytest.approx(
                (fates == measure).mean()
            )
    summary = {(row["task"], row["measure"]): row for row in record["tasks"]}
    assert {task for task, _ in summary} == {"objects", "ground", "occupancy", "free_space"}
    lost = summary["objects", "lost"]
    assert lost["n_pairs"] == 2
    assert lost["gap"] == pytest.approx(gaps.gap[:, "objects", "lost"].mean())


def test_only_the_tasks_that_are_asked_for_are_computed(dataset, finished, tmp_path):
    out = tmp_path / "run"
    run(dataset, out, load(None, ["tasks.names=ground"]), pattern="000")
    assert set(pd.read_parquet(out / "tasks").task) == {"ground"}
    assert pd.read_parquet(out / "task_objects").empty
    points = fidpipe.open_run(finished).points("000", "real")[["x", "y", "z"]].to_numpy()
    result = fidpipe.evaluate_pair(points, points, {"tasks": {"names": "all"}})
    assert set(result.tasks.gap.dropna()) == {0.0}
    assert set(result.task_objects.fate) == {"found"}


def test_the_tasks_are_in_the_answer_in_gates_and_in_python(
    dataset, finished, record, tmp_path
):
    gaps = {f"{row['task']}.{row['measure']}": row["gap"] for row in record["tasks"]}
    assert tuple(gaps) == tuple(TASK_GAPS.values())
    answer = command("show", finished, code=0).stdout
    lost = f"{100 * gaps['objects.lost']:.0f} %"
    assert re.search(rf"tasks\s+your obstacles: {lost} lost", answer)
    assert "wrongly_occupied" in command("show", finished, "--all", code=0).stdout
    limit = f"tasks.objects.lost={gaps['objects.lost'] + 1e-6}"
    command("gate", finished, "--max", limit, "--out", tmp_path, code=0)
    command(
        "gate", finished, "--max", "tasks.ground.height_m.max=-1", "--out", tmp_path, code=4
    )
    run(dataset, tmp_path / "run", pattern="000")
    assert "your obstacles" not in command("show", tmp_path / "run", code=0).stdout
    gate = command("gate", tmp_path / "run", "--max", limit, "--max", "pairs.to_do=1", code=4)
    assert "fidpipe run --tasks" in gate.stdout
    with pytest.raises(fidpipe.FidpipeError, match="run --tasks"):
        _ = fidpipe.open_run(tmp_path / "run").tasks
    assert set(fidpipe.open_run(finished).tasks.pair_id) == {"000", "001"}


def test_the_tasks_are_in_the_report(finished, record, tmp_path):
    command("report", finished, "--out", tmp_path / "report", code=0)
    page = (tmp_path / "report" / "report.html").read_text(encoding="utf-8")
    lost = next(row["gap"] for row in record["tasks"] if row["measure"] == "lost")
    assert f"your obstacles: {100 * lost:.0f} % lost" in page
    assert "wrongly_occupied" in page


def test_a_comparison_judges_the_tasks_of_runs_with_the_same_settings(
    dataset, finished, tmp_path
):
    (same,) = compare_runs([finished, finished])
    (tasks,) = [family for family in same.families if family.name == "tasks"]
    assert tasks.verdict == "same"
    assert "obstacles lost" in {score.name for score in tasks.scores}
    run(dataset, tmp_path / "run", load(None, ["tasks.names=ground"]))
    with pytest.raises(fidpipe.FidpipeError, match=r"settings differ \(tasks.names is "):
        compare_runs([finished, tmp_path / "run"])
    run(dataset, tmp_path / "run", load(None), replace=True)
    (other,) = compare_runs([finished, tmp_path / "run"])
    assert "tasks" not in {family.name for family in other.families}
