"""The order of work: what is admitted when, what cannot fit, and what becomes of a pair whose worker dies."""

import math
import re
from dataclasses import replace

import pandas as pd
import pytest

from fidpipe.pipeline.datasets import content
from fidpipe.pipeline.engine import costs
from fidpipe.pipeline.jobs import EXTRAS, STAGES
from fidpipe.schemas.errors import StageError
from fidpipe.schemas.settings import load
from pools import GIB, DyingPool, WatchedPool
from runs import JOBS_PER_PAIR, assert_same_tables, listening, run

N_PAIRS = 3

LARGE_NODES = {"BYTES_PER_NODE": 2**22}
N_JOBS = 3 * JOBS_PER_PAIR
EXTRA = load(None, ["metrics.baselines=chamfer", "stability.seeds=2"])


def too_large_above(limit):
    """Objects above a limit need more memory than anybody has, all others none."""
    return {"object_bytes": lambda n_keep: 100 * GIB if n_keep > limit else 0}


def fail(context):
    raise StageError("no such thing")


def extras(**makes):
    """The pipeline with all extras, some of them with another job."""
    return (
        *STAGES,
        *(replace(stage, make=makes.get(stage.name, stage.make)) for stage in EXTRAS),
    )


@pytest.mark.parametrize(
    "bytes_per_point", [16, 1, 10**6], ids=["known", "fewer points than estimated", "more"]
)
def test_a_pair_that_cannot_fit_fails_with_size_need_and_setting(
    dataset, tmp_path, monkeypatch, bytes_per_point
):
    monkeypatch.setattr(content, "_BYTES_PER_POINT", bytes_per_point)
    outcome = run(dataset, tmp_path / "run", pool=WatchedPool(memory=GIB // 4))
    assert len(outcome.failures) == 3
    for reason in outcome.failures.values():
        assert all(
            words in reason
            for words in ("points", "GiB of memory may be needed", "machine.memory_gib")
        )
        assert "stage ground" not in reason


def test_an_object_that_cannot_fit_fails_its_pair_alone(dataset, finished, tmp_path):
    largest = pd.read_parquet(finished / "metrics").groupby("pair_id").n_keep.max()
    loser = largest.idxmax()
    policy = too_large_above((largest.max() + largest.drop(loser).max()) / 2)
    outcome = run(dataset, tmp_path / "run", pool=WatchedPool(), policy=policy)
    assert list(outcome.failures) == [loser]
    assert f"of {largest.max()} aligned nodes: 1e+02 GiB" in outcome.failures[loser]
    assert "graph.k" in outcome.failures[loser]
    assert not (tmp_path / "run" / "selection" / f"{loser}.parquet").exists()


def test_objects_larger_than_a_share_are_scored_one_by_one_with_the_same_numbers(
    dataset, finished, tmp_path
):
    pool = WatchedPool(memory=3 * GIB // 2)
    policy = LARGE_NODES | {"WORTH_SPLITTING_S": math.inf}  # no pair is split for speed
    assert not run(dataset, tmp_path / "run", pool=pool, policy=policy).failures
    assert "score_objects" in pool.submitted
    assert_same_tables(tmp_path / "run", finished)


@pytest.mark.parametrize("n_workers", [1, 2])
def test_a_long_pair_is_made_job_by_job_and_object_by_object_so_that_progress_moves(
    dataset, finished, tmp_path, n_workers
):
    pool = WatchedPool(n_workers=n_workers)
    reporter, told = listening(seconds_between_lines=0.0)
    policy = {"WORTH_SPLITTING_S": 0.0, "LONG_PAIR": 0, "BATCH_S": 0.0}
    assert not run(
        dataset, tmp_path / "run", pool=pool, policy=policy, reporter=reporter
    ).failures
    jobs_of_sides = [
        len(jobs) for jobs in pool.batches if jobs[0][1] in ("ground", "graph", "communities")
    ]
    assert set(jobs_of_sides) == {1}
    assert re.search(r"^0 of 3 pairs, 0 failed, \d+ %", told.getvalue(), re.MULTILINE)
    counts = re.findall(r"000: (\d+) of (\d+) objects", told.getvalue())
    assert [int(n) for n, _ in counts] == list(range(1, int(counts[0][1]) + 1))
    # a line without objects for each other batch and each pair: none covers up that of a batch of objects
    n_others = len(pool.submitted) - pool.submitted.count("score_objects")
    n_lines = sum("objects" not in line for line in told.getvalue().splitlines())
    assert n_lines <= n_others + 3
    assert_same_tables(tmp_path / "run", finished)


def test_tasks_that_may_run_at_once_fit_into_the_memory(dataset, tmp_path):
    policy = LARGE_NODES | {"WORTH_SPLITTING_S": 0.0, "BATCH_S": 0.0}  # one task per object
    ample = WatchedPool(memory=64 * GIB)
    scarce = WatchedPool(memory=2 * GIB)
    for name, pool in (("ample", ample), ("scarce", scarce)):
        assert not run(dataset, tmp_path / name, pool=pool, policy=policy).failures
    usable = 2 * GIB - 2 * costs.PROCESS_BYTES
    assert max(need for _, need in ample.at_once) > usable
    assert max(need for n, need in scarce.at_once if n > 1) <= usable
    assert_same_tables(tmp_path / "ample", tmp_path / "scarce")


@pytest.mark.parametrize("function", ["run_batch", "score_objects", "gather_objects"])
def test_a_pair_with_a_large_object_whose_worker_dies_once_is_scored_all_the_same(
    dataset, finished, tmp_path, function
):
    pool = DyingPool(lambda jobs, name: name == function, 1, memory=3 * GIB // 2)
    policy = LARGE_NODES | {"WORTH_SPLITTING_S": math.inf}
    assert not run(dataset, tmp_path / "run", pool=pool, policy=policy).failures
    assert pool.n_deaths == 1
    assert_same_tables(tmp_path / "run", finished)


def test_what_a_dying_worker_leaves_is_made_job_by_job_with_nothing_next_to_it(
    dataset, finished, tmp_path
):
    pool = DyingPool(lambda jobs, name: True, 1)
    outcome = run(dataset, tmp_path / "run", pool=pool)
    assert (outcome.failures, outcome.n_made) == ({}, N_JOBS)
    assert [len(jobs) for jobs in pool.batches] == [N_JOBS, *[1] * N_JOBS]
    assert {n for n, _ in pool.at_once} == {1}
    assert_same_tables(tmp_path / "run", finished)


def test_a_job_that_loses_its_worker_alone_too_fails_its_pair_alone(
    dataset, finished, tmp_path
):
    pool = DyingPool(lambda jobs, name: ("001", "matching", "") in jobs)
    outcome = run(dataset, tmp_path / "run", pool=pool)
    assert list(outcome.failures) == ["001"]
    assert outcome.failures["001"].startswith("stage matching: the worker process died")
    assert pool.n_deaths == 1 + 1  # with others, alone
    assert outcome.n_made == N_JOBS - JOBS_PER_PAIR  # nothing of the failed pair stays
    assert not (
        tmp_path / "run" / "matching" / "001.parquet"
    ).exists()  # the dead worker's file is orphaned
    assert run(dataset, tmp_path / "run").n_made == JOBS_PER_PAIR
    assert_same_tables(tmp_path / "run", finished)


def test_an_extra_that_loses_its_worker_alone_too_fails_alone(dataset, finished, tmp_path):
    pool = DyingPool(lambda jobs, name: ("001", "baselines", "") in jobs)
    outcome = run(dataset, tmp_path / "run", EXTRA, pool=pool)
    assert {row["status"] for row in outcome.rows} == {"scored"}
    assert list(outcome.failures) == ["001"]
    assert outcome.failures["001"].startswith("stage baselines: ")
    assert outcome.n_made == N_JOBS + 5
    assert_same_tables(tmp_path / "run", finished)


def test_pairs_fall_into_batches_by_side_and_object_and_give_the_same(
    dataset, finished, tmp_path
):
    pool = WatchedPool()
    policy = {"WORTH_SPLITTING_S": 0.0, "BATCH_S": 0.0}
    assert not run(dataset, tmp_path / "run", pool=pool, policy=policy).failures
    n_objects = len(pd.read_parquet(tmp_path / "run" / "metrics"))
    assert pool.submitted.count("score_objects") == n_objects > 3
    assert pool.submitted.count("gather_objects") == 3
    stages = set()
    for jobs in pool.batches:
        stages.add(tuple(stage for _, stage, _ in jobs))
    assert stages == {
        ("ground", "sensor", "graph", "communities"),
        ("matching",),
        ("coverage",),
        ("surface",),
        ("pieces",),
        ("rays",),
        ("causes",),
    }
    assert_same_tables(tmp_path / "run", finished)


def test_pairs_that_nobody_began_are_an_error_not_a_silence(dataset, tmp_path):
    nothing_begins = {"PAIRS_PER_WORKER": 0}
    with pytest.raises(RuntimeError, match="3 pairs"):
        run(dataset, tmp_path / "run", pool=WatchedPool(), policy=nothing_begins)


@pytest.mark.parametrize("n_workers", [2, 32])
def test_what_fits_alone_does_not_depend_on_the_number_of_workers(
    dataset, finished, tmp_path, n_workers
):
    assert not run(dataset, tmp_path / "run", pool=WatchedPool(n_workers, 2 * GIB)).failures
    assert_same_tables(tmp_path / "run", finished)


def test_there_are_no_more_workers_than_the_memory_holds():
    assert costs.most_workers(2 * GIB) == 3
    assert costs.most_workers(1) == 1


def test_a_failed_extra_does_not_stop_another(dataset, finished, tmp_path):
    outcome = run(dataset, tmp_path / "run", EXTRA, stages=extras(baselines=fail))
    assert outcome.failures == dict.fromkeys(
        ("000", "001", "002"), "stage baselines: no such thing"
    )
    assert {row["status"] for row in outcome.rows} == {"scored"}
    assert outcome.record.seeds.n_pairs == 3
    assert outcome.n_made == N_JOBS + 2 * 3  # the other extras of each pair
    mended = run(dataset, tmp_path / "run", EXTRA)
    assert (mended.failures, mended.n_made) == ({}, 3)
    assert_same_tables(tmp_path / "run", finished)
