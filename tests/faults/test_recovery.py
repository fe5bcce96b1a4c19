"""Runs in a folder whose ledger is lost, that was killed, or that may not be written.

The tables are the source of truth: their footers are enough to resume.
"""

import json
import shutil
from dataclasses import replace

import pandas as pd
import pyarrow.parquet as pq
import pytest

from fidpipe.pipeline import run as run_module
from fidpipe.pipeline.jobs import STAGES
from fidpipe.pipeline.results.finished import FinishedRun, pair_facts
from fidpipe.pipeline.results.status import run_status
from fidpipe.pipeline.storage.ledger import LEDGER
from fidpipe.schemas.errors import RunError, StageError
from fidpipe.schemas.settings import load
from runs import (
    FOLDERS,
    JOBS_PER_PAIR,
    STAGE_NAMES,
    assert_same_tables,
    changed_tables,
    flip,
    listening,
    marks,
    run,
    some_of,
)

N_JOBS = 2 * JOBS_PER_PAIR


def lose_ledger(out):
    (out / LEDGER).unlink()


def run_told(dataset, out):
    """A run, and what it said."""
    reporter, said = listening()
    return run(dataset, out, reporter=reporter), said.getvalue()


def test_a_run_without_its_ledger_makes_nothing_and_touches_no_table(again, finished, dataset):
    before = marks(again)
    lose_ledger(again)
    outcome, told = run_told(dataset, again)
    assert (outcome.n_made, outcome.n_reused, outcome.failures) == (0, N_JOBS, {})
    assert marks(again) == before
    assert "replacing" not in told
    assert "removing" not in told
    before = json.loads((finished / "run.json").read_text())
    for part in ("summary", "findings", "inputs", "pairs"):
        assert outcome.record.as_dict()[part] == before[part]
    assert pd.read_parquet(again / "timings.parquet").empty  # seconds were in the lost ledger
    assert run(dataset, again).n_made == 0


def test_results_that_are_out_of_date_are_not_taken_for_lack_of_a_ledger(again, dataset, tmp_path):
    lose_ledger(again)
    settings = load(None, ["matching.delta_m=3"])
    assert run(dataset, again, settings).n_made == 6
    run(dataset, tmp_path / "fresh", settings)
    assert_same_tables(again, tmp_path / "fresh")


TWO_TABLES = ({"communities", "objects"}, {"rays", "ray_scores"})  # of one job


@pytest.mark.parametrize("folder", some_of(FOLDERS, ["communities", "metrics"]))
@pytest.mark.parametrize("where", ["page", "footer"])
def test_without_a_ledger_a_damaged_table_alone_is_made_again(again, finished, dataset, folder, where):
    before = marks(again)
    path = sorted((again / folder).glob("*.parquet"))[0]
    lose_ledger(again)
    has_values = where == "footer" or len(pd.read_parquet(path)) > 0
    flip(path, 40 if where == "page" else path.read_bytes().index(b"fidpipe.job") + 60)
    outcome, told = run_told(dataset, again)
    assert_same_tables(again, finished)
    if not has_values:  # the bytes of a page without rows are not read
        return
    assert outcome.n_made == 1
    of_one_job = next((both for both in TWO_TABLES if folder in both), {folder})
    assert changed_tables(again, before) == of_one_job
    assert f"removing {len(of_one_job)} file" in told


def test_show_and_status_need_no_ledger(again, finished):
    lose_ledger(again)
    files = {path: path.read_bytes() for path in again.rglob("*") if path.is_file()}
    whole, lost = FinishedRun(finished), FinishedRun(again)
    assert lost.rows == whole.rows
    assert pair_facts(lost, "001") == pair_facts(whole, "001")
    assert run_status(again).stages == {stage: {"done": 2} for stage in STAGE_NAMES}
    assert {path: path.read_bytes() for path in again.rglob("*") if path.is_file()} == files


def test_a_run_whose_tables_lost_their_footers_is_not_shown_as_if_it_were_whole(again):
    lose_ledger(again)
    for path in again.rglob("*.parquet"):
        pq.write_table(pq.read_table(path).replace_schema_metadata({"fidpipe.key": "key"}), path)
    with pytest.raises(RunError, match=r"pairs\.parquet"):
        FinishedRun(again)
    assert run_status(again).stages == {stage: {"to do": 2} for stage in STAGE_NAMES}


def test_a_failure_that_the_ledger_has_lost_is_found_again(data, tmp_path):
    (data / "real" / "000.bin").write_bytes(b"12345")
    out = tmp_path / "run"
    before = run(data, out)
    lose_ledger(out)
    outcome = run(data, out)
    assert outcome.failures == before.failures
    assert outcome.n_made == 0


def test_a_run_with_nothing_to_do_leaves_the_finished_record_until_it_has_the_next(again, dataset, monkeypatch):
    """Readers next to it see the finished run, also if it dies."""
    before = FinishedRun(again).record
    seen = []

    def dies(*_):
        seen.append(FinishedRun(again).record)
        raise KeyboardInterrupt

    monkeypatch.setattr(run_module.Run, "write", dies)
    with pytest.raises(KeyboardInterrupt):
        run(dataset, again)
    assert seen == [FinishedRun(again).record] == [before]


def test_readers_next_to_a_working_run_say_so_and_then_that_it_has_not_ended(again, dataset, monkeypatch):
    def dies(*_):
        with pytest.raises(RunError, match="another fidpipe"):
            FinishedRun(again)
        raise KeyboardInterrupt

    monkeypatch.setattr(run_module.Run, "write", dies)
    with pytest.raises(KeyboardInterrupt):
        run(dataset, again, from_stage="metrics")
    with pytest.raises(RunError, match="the run has not ended"):
        FinishedRun(again)


def test_another_table_of_pairs_takes_the_finished_record_away_until_it_has_the_next(again, dataset, monkeypatch):
    """A new pair that fails before all stages: nothing is computed, and the table of pairs has one more row."""
    larger = shutil.copytree(dataset, again.with_name("larger"))
    shutil.rmtree(again)
    run(larger, again)
    for side in ("real", "sim"):
        (larger / side / "more.bin").write_bytes(b"no points")
    monkeypatch.setattr(run_module, "write_timings", lambda *_: (_ for _ in ()).throw(KeyboardInterrupt))
    with pytest.raises(KeyboardInterrupt):
        run(larger, again)
    with pytest.raises(RunError, match="the run has not ended"):
        FinishedRun(again)


def test_a_failed_stage_leaves_nothing_that_a_lost_ledger_could_bring_back(dataset, finished, tmp_path):
    def fail(context):
        raise StageError("no such thing")

    out = tmp_path / "run"
    stages = (*STAGES[:-1], replace(STAGES[-1], make=fail))
    assert len(run(dataset, out, stages=stages).failures) == 2
    lose_ledger(out)
    assert run(dataset, out).n_made == N_JOBS
    assert_same_tables(out, finished)
