from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest

from fidpipe.pipeline.jobs import STAGES
from fidpipe.pipeline.results.finished import FinishedRun
from fidpipe.pipeline.results.status import run_status
from fidpipe.schemas.errors import RunError
from fidpipe.schemas.settings import load
from fidpipe.schemas.tables import TABLES
from runs import (
    FOLDERS,
    JOBS_PER_PAIR,
    STAGE_NAMES,
    assert_same_tables,
    changed_files,
    changed_tables,
    command,
    copied,
    marks,
    run,
    some_of,
    temporary_files,
)
from scenes import drifted, street, write_bin, write_dataset, write_pair

N_PAIRS = 3
RAYS = ("rays", "ray_scores")


def test_every_table_has_the_schema_of_the_contract(finished):
    assert temporary_files(finished) == []
    for folder in FOLDERS:
        files = list((finished / folder).glob("*.parquet"))
        assert len(files) == (
            6 if folder in ("ground", "sensor", "graph", "communities", "objects") else 3
        )
        for path in files:
            table = pq.read_table(path)
            TABLES[folder].check(table)
            keys = table.select(list(TABLES[folder].keys)).to_pandas()
            assert keys.equals(keys.sort_values(list(TABLES[folder].keys), kind="stable")), path
    TABLES["pairs"].check(pq.read_table(finished / "pairs.parquet"))
    TABLES["timings"].check(pq.read_table(finished / "timings.parquet"))


def test_a_second_run_makes_nothing(again, dataset):
    before = marks(again)
    outcome = run(dataset, again)
    assert (outcome.n_made, outcome.n_reused) == (0, 3 * JOBS_PER_PAIR)
    assert not changed_files(again, before)
    timings = pd.read_parquet(again / "timings.parquet")
    assert timings.reused.all()
    assert (timings.seconds >= 0).all()


@pytest.mark.parametrize(
    ("word", "untouched"),
    [
        (
            "matching.delta_m=3",
            [
                "ground",
                "sensor",
                "graph",
                "communities",
                "objects",
                "surface",
                "pieces",
                "coverage",
                "causes",
                *RAYS,
            ],
        ),
        ("selection.t=2", [name for name in FOLDERS if name not in ("selection", "metrics")]),
        pytest.param(
            "communities.seed=1",
            ["ground", "sensor", "graph", "pieces", "causes", *RAYS],
            marks=pytest.mark.exhaustive,
        ),
        ("graph.k=30", ["ground", "sensor", "pieces", "causes", *RAYS]),
        ("pieces.reach_m=2", ["ground", "sensor", "graph", "causes", *RAYS]),
        pytest.param("ground.prior_m=0.2", ["sensor"], marks=pytest.mark.exhaustive),
        ("input.max_range_m=50", []),
    ],
)
def test_a_changed_setting_touches_its_stage_and_those_after_it(
    again, dataset, tmp_path, word, untouched
):
    before = marks(again)
    run(dataset, again, load(None, [word]))
    assert changed_tables(again, before) == set(FOLDERS) - set(untouched)
    run(dataset, tmp_path / "fresh", load(None, [word]))
    assert_same_tables(again, tmp_path / "fresh")


def test_a_changed_input_file_touches_its_pair_alone(finished, tmp_path, dataset):
    data, again = copied(dataset, finished, tmp_path)
    write_bin(data / "sim" / "001.bin", drifted(street(10), seed=99))
    before = marks(again)
    run(data, again)
    changed = changed_files(again, before)
    assert {name.split("/")[1].split(".")[0] for name in changed} == {"001"}
    assert not any(name.endswith(".real.parquet") for name in changed)


def test_files_are_known_wherever_the_command_is_called(tmp_path, monkeypatch):
    data = write_dataset(tmp_path / "streets", 2, n=40)
    run(data, tmp_path / "run")
    monkeypatch.chdir(tmp_path)
    assert run(Path("streets"), tmp_path / "run").n_made == 0


@pytest.mark.parametrize(
    "stage", some_of(STAGE_NAMES, ["ground", "matching", "surface", "metrics"])
)
def test_from_makes_a_stage_and_those_after_it_again(again, dataset, stage):
    before = marks(again)
    outcome = run(dataset, again, from_stage=stage)
    redone = STAGE_NAMES[STAGE_NAMES.index(stage) :]
    assert outcome.n_made == 3 * sum(
        len(stage.parts) for stage in STAGES if stage.name in redone
    )
    assert changed_tables(again, before) - {"objects", "ray_scores"} == set(redone)


def test_a_pattern_limits_the_work_and_keeps_the_rest(dataset, tmp_path):
    out = tmp_path / "run"
    assert [row["pair_id"] for row in run(dataset, out, pattern="00[12]").rows] == [
        "001",
        "002",
    ]
    assert [row["pair_id"] for row in run(dataset, out, pattern="000").rows] == [
        "000",
        "001",
        "002",
    ]
    limited = run(dataset, out, load(None, ["matching.delta_m=3"]), pattern="000")
    assert [row["pair_id"] for row in limited.rows] == ["000"]
    assert {path.name for path in (out / "matching").iterdir()} == {"000.parquet"}
    assert len(list((out / "graph").iterdir())) == 6


def test_a_pair_that_left_the_dataset_leaves_the_run(finished, tmp_path, dataset):
    data, again = copied(dataset, finished, tmp_path)
    for side in ("real", "sim"):
        (data / side / "002.bin").unlink()
    outcome = run(data, again)
    assert [row["pair_id"] for row in outcome.rows] == ["000", "001"]
    assert not [path for folder in FOLDERS for path in (again / folder).glob("002*")]


def test_a_broken_pair_fails_alone_with_its_reason(data, tmp_path):
    (data / "real" / "000.bin").write_bytes(b"12345")
    flat = np.column_stack(
        [np.random.default_rng(0).uniform(-20, 20, (900, 2)), np.full(900, -1.7)]
    )
    write_bin(data / "sim" / "001.bin", flat)
    outcome = run(data, tmp_path / "run")
    rows = {row["pair_id"]: row for row in outcome.rows}
    assert [rows[name]["status"] for name in ("000", "001", "002")] == [
        "failed",
        "failed",
        "scored",
    ]
    assert "000.bin" in rows["000"]["reason"]
    assert rows["001"]["reason"].startswith("stage ground, sim: ")
    assert "ground.prior_m (now 0.3)" in rows["001"]["reason"]
    assert rows["001"]["r_lambda_mean"] is None
    for table in FOLDERS:
        names = {path.name.split(".")[0] for path in (tmp_path / "run" / table).iterdir()}
        assert names == {"002"}
    status = run_status(tmp_path / "run")
    assert status.stages["metrics"] == {"done": 1, "failed": 2}
    again = run(data, tmp_path / "run", pattern="002")
    assert {row["pair_id"]: row["status"] for row in again.rows} == {
        "000": "failed",
        "001": "failed",
        "002": "scored",
    }


def test_a_pair_that_became_bad_leaves_no_old_result_and_is_scored_again_once_it_is_mended(
    finished, dataset, tmp_path
):
    data, out = copied(dataset, finished, tmp_path)
    scan = data / "sim" / "001.bin"
    good = scan.read_bytes()
    scan.write_bytes(good[:-5])
    assert set(run(data, out).failures) == {"001"}
    assert not [path for folder in FOLDERS for path in (out / folder).glob("001*")]
    scan.write_bytes(good)
    outcome = run(data, out)
    assert (outcome.failures, outcome.n_made) == ({}, JOBS_PER_PAIR)
    assert run_status(out).failures == {}


def test_a_folder_that_is_not_a_run_is_left_alone(dataset, tmp_path):
    (tmp_path / "letters").mkdir()
    (tmp_path / "letters" / "dear.txt").write_text("you")
    with pytest.raises(RunError, match="letters"):
        run(dataset, tmp_path / "letters")
    assert [path.name for path in (tmp_path / "letters").iterdir()] == ["dear.txt"]


def test_a_run_of_another_dataset_is_left_alone(again, tmp_path):
    other = write_dataset(tmp_path / "other", 1)
    before = marks(again)
    with pytest.raises(RunError, match="other.*--out"):
        run(other, again)
    assert marks(again) == before


def test_road_peaks_that_differ_by_over_5_cm_are_noted_where_each_side_is_cut_at_its_own(
    tmp_path,
):
    scan = street()
    write_pair(tmp_path / "data", scan, scan + [0, 0, 0.12])
    notes = {}
    for preset, tolerance_m in (("paper", 0.02), ("reference", 0.001)):
        outcome = run(tmp_path / "data", tmp_path / preset, load(None, preset=preset))
        notes[preset] = outcome.record.notes
        (row,) = outcome.rows
        assert row["ground_sim_threshold_m"] - row["ground_real_threshold_m"] == pytest.approx(
            0.12, abs=tolerance_m
        )
    assert notes["reference"] == {}
    (note,) = notes["paper"]["a"]
    assert "11 cm above" in note
    assert any(
        note in caution.words
        for caution in FinishedRun(tmp_path / "paper").record.overview.trust
    )
    assert note in command("show", tmp_path / "paper", "a").stdout.replace("\n", " ")


def test_each_side_may_have_its_own_columns(dataset, tmp_path):
    scan = street()
    seen = drifted(street())
    write_pair(tmp_path / "same", scan, seen)
    write_bin(tmp_path / "other" / "real" / "a.bin", scan)
    write_bin(tmp_path / "other" / "sim" / "a.bin", seen, 6)
    settings = load(None, ["input.sim_columns=x y z ring time intensity"])
    same, other = (
        run(tmp_path / "same", tmp_path / "a"),
        run(tmp_path / "other", tmp_path / "b", settings),
    )
    assert other.rows == same.rows
