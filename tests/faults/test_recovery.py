"""Runs in a folder whose ledger is lost, that was killed, or that may not be written."""

import shutil
from dataclasses import replace

import pytest

from fidpipe.pipeline import run as run_module
from fidpipe.pipeline.jobs import STAGES
from fidpipe.pipeline.results.finished import FinishedRun
from fidpipe.pipeline.results.status import run_status
from fidpipe.pipeline.storage.ledger import LEDGER
from fidpipe.schemas.errors import RunError, StageError
from runs import (
    JOBS_PER_PAIR,
    STAGE_NAMES,
    assert_same_tables,
    changed_files,
    listening,
    marks,
    run,
)

N_JOBS = 2 * JOBS_PER_PAIR


def lose_ledger(out):
    shutil.rmtree(out / LEDGER)


def run_told(dataset, out):
    """A run, and what it said."""
    reporter, said = listening()
    return run(dataset, out, reporter=reporter), said.getvalue()


def test_a_run_without_its_ledger_is_computed_again(again, finished, dataset):
    lose_ledger(again)
    with pytest.raises(RunError, match=r"pairs\.parquet is damaged or gone"):
        FinishedRun(again)
    assert run_status(again).stages == {stage: {"to do": 2} for stage in STAGE_NAMES}
    outcome, text = run_told(dataset, again)
    assert (outcome.n_made, outcome.n_reused, outcome.failures) == (N_JOBS, 0, {})
    assert "that no finished job accounts for" in text
    assert_same_tables(again, finished)
    assert run(dataset, again).n_made == 0


def test_a_pair_without_its_entry_is_computed_again_alone(again, finished, dataset):
    (again / LEDGER / "001.json").unlink()
    before = marks(again)
    outcome = run(dataset, again)
    assert (outcome.n_made, outcome.n_reused) == (JOBS_PER_PAIR, JOBS_PER_PAIR)
    assert all("/001." in name for name in changed_files(again, before))
    assert_same_tables(again, finished)


def test_a_failure_that_the_ledger_has_lost_is_found_again(data, tmp_path):
    (data / "real" / "000.bin").write_bytes(b"12345")
    out = tmp_path / "run"
    before = run(data, out)
    lose_ledger(out)
    outcome = run(data, out)
    assert outcome.failures == before.failures
    assert outcome.n_made == JOBS_PER_PAIR


def test_a_run_with_nothing_to_do_leaves_the_finished_record_until_it_has_the_next(
    again, dataset, monkeypatch
):
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


def test_readers_next_to_a_working_run_say_so_and_then_that_it_has_not_ended(
    again, dataset, monkeypatch
):
    def dies(*_):
        with pytest.raises(RunError, match="another fidpipe"):
            FinishedRun(again)
        raise KeyboardInterrupt

    monkeypatch.setattr(run_module.Run, "write", dies)
    with pytest.raises(KeyboardInterrupt):
        run(dataset, again, from_stage="metrics")
    with pytest.raises(RunError, match="the run has not ended"):
        FinishedRun(again)


def test_another_table_of_pairs_takes_the_finished_record_away_until_it_has_the_next(
    again, dataset, monkeypatch
):
    """A new pair that fails before all stages: nothing is computed, and the table of pairs has one more row."""
    larger = shutil.copytree(dataset, again.with_name("larger"))
    shutil.rmtree(again)
    run(larger, again)
    for side in ("real", "sim"):
        (larger / side / "more.bin").write_bytes(b"no points")
    monkeypatch.setattr(
        run_module, "timing_rows", lambda *_: (_ for _ in ()).throw(KeyboardInterrupt)
    )
    with pytest.raises(KeyboardInterrupt):
        run(larger, again)
    with pytest.raises(RunError, match="the run has not ended"):
        FinishedRun(again)


def test_a_failed_stage_leaves_nothing_that_a_lost_ledger_could_bring_back(
    dataset, finished, tmp_path
):
    def fail(context):
        raise StageError("no such thing")

    out = tmp_path / "run"
    stages = (*STAGES[:-1], replace(STAGES[-1], make=fail))
    assert len(run(dataset, out, stages=stages).failures) == 2
    lose_ledger(out)
    assert run(dataset, out).n_made == N_JOBS
    assert_same_tables(out, finished)
