"""The order of work: what is admitted when, and what cannot fit."""

from dataclasses import replace

import pandas as pd
import pytest

from fidpipe.pipeline import run as run_module
from fidpipe.pipeline.engine import costs, runner, schedule, session
from fidpipe.pipeline.engine import memory as admission
from fidpipe.pipeline.engine.pool import InProcess, Memory, WorkerDied
from fidpipe.schemas.errors import StageError
from fidpipe.schemas.settings import load
from runs import assert_same_tables, run
from scenes import write_dataset

GIB = 2**30


class TwoAtOnce(InProcess):
    """A pool that says it runs two tasks at once in a given memory; it remembers what it was given."""

    n_workers = 2

    def __init__(self, memory):
        super().__init__()
        self.given = Memory(memory, memory)
        self.submitted = []

    @property
    def memory(self):
        return self.given

    def submit(self, function, *args, **options):
        self.submitted.append(function.__name__)
        return super().submit(function, *args, **options)


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    return write_dataset(tmp_path_factory.mktemp("data") / "streets", 3)


@pytest.fixture(scope="module")
def finished(dataset, tmp_path_factory):
    out = tmp_path_factory.mktemp("runs") / "streets"
    run(dataset, out)
    return out


def run_in(pool, monkeypatch, dataset, out):
    monkeypatch.setattr(session, "start_pool", lambda *args: pool)
    return run(dataset, out)


def test_a_pair_that_cannot_fit_fails_with_size_need_and_setting(dataset, tmp_path, monkeypatch):
    outcome = run_in(TwoAtOnce(GIB // 4), monkeypatch, dataset, tmp_path / "run")
    assert len(outcome.failures) == 3
    for reason in outcome.failures.values():
        assert "points" in reason and "GiB of memory may be needed" in reason and "machine.memory_gib" in reason


def test_an_object_that_cannot_fit_fails_its_pair_alone(dataset, finished, tmp_path, monkeypatch):
    largest = pd.read_parquet(finished / "metrics").groupby("pair_id").n_keep.max()
    loser = largest.idxmax()
    limit = (largest.max() + largest.drop(loser).max()) / 2
    for module in (schedule, admission, runner):
        monkeypatch.setattr(module, "object_bytes", lambda n: 100 * GIB if n > limit else 0)
    outcome = run_in(TwoAtOnce(8 * GIB), monkeypatch, dataset, tmp_path / "run")
    assert list(outcome.failures) == [loser]
    assert f"of {largest.max()} aligned nodes: 1e+02 GiB" in outcome.failures[loser]
    assert "graph.k" in outcome.failures[loser]
    assert not (tmp_path / "run" / "selection" / f"{loser}.parquet").exists()


def test_objects_larger_than_a_share_are_scored_one_by_one_with_the_same_numbers(
    dataset, finished, tmp_path, monkeypatch
):
    monkeypatch.setattr(schedule, "_FEW_PAIRS_A_WORKER", 0)  # no pair is split for speed
    monkeypatch.setattr(costs, "_BYTES_A_NODE", 2**22)
    pool = TwoAtOnce(3 * GIB // 2)
    assert not run_in(pool, monkeypatch, dataset, tmp_path / "run").failures
    assert "score_objects" in pool.submitted
    assert_same_tables(tmp_path / "run", finished)


def test_tasks_that_may_run_at_once_fit_into_the_memory(dataset, tmp_path, monkeypatch):
    at_once = []

    class Watched(schedule.Schedule):
        def _admit(self):
            super()._admit()
            needs = sorted((order.need for order in self._running.values()), reverse=True)
            at_once.append((len(needs), sum(needs[:2])))

    monkeypatch.setattr("fidpipe.pipeline.engine.session.Schedule", Watched)
    monkeypatch.setattr(schedule, "_LEAST_WEIGHT", 1.0)  # a task a pair
    monkeypatch.setattr(costs, "_BYTES_A_NODE", 2**22)
    memory = 3 * GIB
    pool = TwoAtOnce(memory)
    assert not run_in(pool, monkeypatch, dataset, tmp_path / "run").failures
    assert max(need for n, need in at_once if n > 1) <= memory - 2 * costs.PROCESS_BYTES
    assert 1 in {n for n, _ in at_once}  # some had to wait until nothing ran beside them


def test_a_pair_with_a_large_object_whose_worker_dies_once_is_scored_all_the_same(
    dataset, finished, tmp_path, monkeypatch
):
    class DyingOnce(TwoAtOnce):
        died = False

        def next_done(self):
            handle, outcome = super().next_done()
            if not self.died:
                self.died = True
                return handle, WorkerDied("killed")
            return handle, outcome

    monkeypatch.setattr(schedule, "_FEW_PAIRS_A_WORKER", 0)
    monkeypatch.setattr(costs, "_BYTES_A_NODE", 2**22)
    pool = DyingOnce(3 * GIB // 2)
    assert not run_in(pool, monkeypatch, dataset, tmp_path / "run").failures
    assert pool.died
    assert_same_tables(tmp_path / "run", finished)


def test_small_pairs_go_together_and_give_the_same(dataset, finished, tmp_path, monkeypatch):
    pool = TwoAtOnce(8 * GIB)
    assert not run_in(pool, monkeypatch, dataset, tmp_path / "run").failures
    assert pool.submitted == ["run_pairs"]
    assert_same_tables(tmp_path / "run", finished)


def test_pairs_that_nobody_ended_are_an_error_not_a_silence(dataset, tmp_path, monkeypatch):
    monkeypatch.setattr(schedule.Schedule, "_admit", lambda self: None)
    with pytest.raises(RuntimeError, match="3 pairs were left over"):
        run_in(TwoAtOnce(GIB), monkeypatch, dataset, tmp_path / "run")


@pytest.mark.parametrize("n_workers", [2, 32])
def test_what_fits_alone_does_not_depend_on_the_number_of_workers(dataset, finished, tmp_path, monkeypatch, n_workers):
    pool = TwoAtOnce(2 * GIB)
    pool.n_workers = n_workers
    assert not run_in(pool, monkeypatch, dataset, tmp_path / "run").failures
    assert_same_tables(tmp_path / "run", finished)


def test_there_are_no_more_workers_than_the_memory_holds():
    assert costs.most_workers(2 * GIB) == 3
    assert costs.most_workers(1) == 1


def test_a_failed_extra_leaves_its_pair_scored_and_is_told(dataset, finished, tmp_path, monkeypatch):
    def fail(*_):
        raise StageError("no such thing")

    monkeypatch.setattr(run_module, "EXTRAS", tuple(replace(of, make=fail) for of in run_module.EXTRAS))
    outcome = run(dataset, tmp_path / "run", load(None, ["metrics.baselines=chamfer"]))
    assert {row["status"] for row in outcome.rows} == {"scored"}
    assert all("stage baselines: no such thing" in reason for reason in outcome.failures.values())
    assert len(outcome.failures) == 3
    assert_same_tables(tmp_path / "run", finished)
