"""A cluster of worker processes over TCP: its results, rejected workers, and workers that die."""

import ctypes
import os
import signal
import socket
import time
from dataclasses import replace
from functools import partial
from pathlib import Path

import psutil
import pytest
from clusters import TEST_MODULES, Cluster
from distributed import LocalCluster

import broken_jobs
from fidpipe.pipeline.engine import cluster as engine_cluster
from fidpipe.pipeline.engine.cluster import (
    DaskPool,
    Requirements,
    code_hash,
    code_versions,
    worker_fault,
)
from fidpipe.pipeline.engine.engine import Machines
from fidpipe.pipeline.generate.best_case_run import run_best_case
from fidpipe.pipeline.jobs import metrics_job, selection_job
from fidpipe.pipeline.storage.run_record import library_versions
from fidpipe.pipeline.storage.table_files import TOKEN, TableFolder
from fidpipe.schemas.errors import RunError
from fidpipe.schemas.settings import Settings
from runs import (
    JOBS_PER_PAIR,
    QUIET,
    assert_same_tables,
    own_process,
    run,
    some_of,
    temporary_files,
)

N_PAIRS = 6
LIMIT_S = 3.0  # a healthy pair takes 0.2 s
ENDLESS_S = 900
POISON_IN_METRICS = "002"


@pytest.fixture
def cluster(tmp_path):
    with Cluster(tmp_path / "cluster") as cluster:
        yield cluster


def kill_own_worker_once(context, at_work):
    """The metrics job, which once kills its worker, before it does anything or in the middle of writing its table."""
    flag = Path(os.environ["KILLED"])
    if context.pair_id == POISON_IN_METRICS and not flag.exists():
        flag.write_text(str(os.getpid()))
        if at_work == "beginning":
            os.kill(os.getpid(), signal.SIGKILL)
        os.replace = lambda *names: os.kill(os.getpid(), signal.SIGKILL)
    return metrics_job.make_metrics(context)


def never_ending_graph(folder, context):
    """The graph job, which for one pair never comes back from a library that holds the interpreter."""
    if context.pair_id == broken_jobs.POISON:
        (folder / str(os.getpid())).touch()
        ctypes.PyDLL(None).sleep(ENDLESS_S)
    return broken_jobs.graph_job.make_graph(context)


def never_ending_selection(context):
    """The selection job, which for one pair never ends."""
    while context.pair_id == broken_jobs.POISON:
        time.sleep(1.0)
    return selection_job.make_selection(context)


@pytest.mark.parametrize("at_work", some_of(["beginning", "writing"], ["writing"]))
def test_three_workers_over_tcp_one_of_them_killed_give_the_tables_of_a_local_run(
    dataset, finished, tmp_path, cluster, at_work
):
    killed = tmp_path / "killed"
    cluster.add_workers(3, "--no-nanny", KILLED=str(killed))
    stages = broken_jobs.with_job("metrics", partial(kill_own_worker_once, at_work=at_work))
    outcome = run(
        dataset, tmp_path / "run", workers=None, scheduler=cluster.address, stages=stages
    )
    dead = [process for process in cluster.workers if process.poll() is not None]
    assert [process.pid for process in dead] == [int(killed.read_text())]
    assert outcome.failures == {}
    assert outcome.n_made == N_PAIRS * JOBS_PER_PAIR
    assert_same_tables(tmp_path / "run", finished)
    assert temporary_files(tmp_path / "run") == []


@pytest.mark.exhaustive
def test_a_pair_whose_worker_dies_each_time_fails_and_says_so(dataset, tmp_path, cluster):
    cluster.add_workers(3, "--nanny")
    stages = broken_jobs.with_job("graph", broken_jobs.poisoned_graph)
    outcome = run(
        dataset, tmp_path / "run", workers=None, scheduler=cluster.address, stages=stages
    )
    assert list(outcome.failures) == [broken_jobs.POISON]
    reason = outcome.failures[broken_jobs.POISON]
    assert reason.startswith(
        "stage graph, real: the worker process died, and again when the pair ran alone"
    )
    assert "4 workers each time, the last one tcp://127.0.0.1:" in reason


@pytest.mark.exhaustive
def test_relative_paths_are_those_of_the_command_not_of_workers_in_other_folders(
    dataset, finished, tmp_path, cluster, monkeypatch
):
    cluster.add_workers(1)
    monkeypatch.chdir(tmp_path)
    named = Path(os.path.relpath(dataset))
    one = {"pattern": "000"}
    machines = Machines(None, cluster.address)
    outcome = run(named, Path("run"), workers=None, scheduler=cluster.address, **one)
    assert outcome.failures == {}
    assert outcome.n_made == JOBS_PER_PAIR
    assert run(named, tmp_path / "run", **one).n_reused == JOBS_PER_PAIR
    assert (
        run_best_case(
            named, Path("best_case"), Settings(), QUIET, machines=machines, **one
        ).failures
        == {}
    )
    assert [path.name for path in (tmp_path / "cluster").iterdir() if path.is_dir()] == []


def kill_scheduler(context):
    """The metrics job, which for one pair ends the scheduler."""
    if context.pair_id == POISON_IN_METRICS:
        os.kill(int(os.environ["SCHEDULER"]), signal.SIGKILL)
        time.sleep(0.5)
    return metrics_job.make_metrics(context)


@pytest.mark.exhaustive
@pytest.mark.parametrize(
    ("stages", "reason"),
    [
        (broken_jobs.with_job("graph", broken_jobs.poisoned_graph), "no worker for 2 s"),
        (broken_jobs.with_job("metrics", kill_scheduler), "scheduler {}: .*"),
    ],
    ids=["workers", "scheduler"],
)
def test_a_run_that_loses_its_workers_or_its_scheduler_says_so_and_is_resumed(
    dataset, finished, tmp_path, cluster, monkeypatch, stages, reason
):
    monkeypatch.setattr(engine_cluster, "_WITHOUT_WORKERS_S", 2.0)
    cluster.add_workers(1, "--no-nanny", SCHEDULER=str(cluster.scheduler.pid))
    with pytest.raises(RunError, match=reason.format(cluster.address)):
        run(dataset, tmp_path / "run", workers=None, scheduler=cluster.address, stages=stages)
    run(dataset, tmp_path / "run")
    assert_same_tables(tmp_path / "run", finished)


@pytest.mark.exhaustive
def test_the_command_works_on_a_cluster(dataset, finished, tmp_path, cluster):
    address = cluster.add_workers(2).address
    own_process("run", dataset, "--out", tmp_path / "run", "--scheduler", address, code=0)
    assert_same_tables(tmp_path / "run", finished)


@pytest.mark.parametrize("library", some_of(["fidpipe", "scipy"], ["scipy"]))
def test_a_worker_of_another_version_is_refused_before_anything_runs(
    dataset, tmp_path, cluster, library
):
    there = tmp_path / f"{library}-0.0.9.dist-info"
    there.mkdir()
    (there / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {library}\nVersion: 0.0.9\n")
    cluster.add_workers(2).add_workers(
        1, PYTHONPATH=os.pathsep.join([str(tmp_path), TEST_MODULES])
    )
    refused = own_process(
        "run", dataset, "--out", tmp_path / "run", "--scheduler", cluster.address
    )
    here = library_versions([library])[library]
    assert refused.returncode == 1
    assert f"{library} 0.0.9 (here {here})" in refused.stderr
    assert f"a worker on {socket.gethostname()}: " in refused.stderr
    assert not list((tmp_path / "run").rglob("*.parquet"))


def test_a_cluster_that_starts_workers_for_tasks_is_asked_for_one(tmp_path):
    (tmp_path / TOKEN).write_text("shared")
    with LocalCluster(
        n_workers=0,
        threads_per_worker=1,
        host="127.0.0.1",
        scheduler_kwargs={"dashboard": False},
    ) as adaptive:
        adaptive.adapt(minimum=0, maximum=1, interval="100ms")
        required = Requirements(code_versions([]), TableFolder(tmp_path, "shared"))
        pool = DaskPool(1, address=adaptive.scheduler_address, required=required)
        # a worker that joins from now on sees other files
        (tmp_path / TOKEN).write_text("moved")
        try:
            pool.submit(pow, 2, 5)
            with pytest.raises(RunError, match=str(tmp_path)):
                pool.next_done()
        finally:
            pool.close()


@pytest.mark.exhaustive
def test_workers_without_a_memory_limit_or_with_a_time_limit_but_no_nanny_are_refused(
    dataset, tmp_path, cluster
):
    cluster.add_workers(1, "--no-nanny", "--memory-limit", "0")
    words = (
        "run",
        dataset,
        "--out",
        tmp_path / "run",
        "--scheduler",
        cluster.address,
        "--pairs",
        "000",
    )
    refused = own_process(*words, code=1)
    assert "--memory-limit" in refused.stderr
    named = (*words, "--set", "machine.memory_gib=2")
    refused = own_process(*named, "--pair-timeout", "60", code=1)
    assert "a nanny and --nthreads 1" in refused.stderr
    assert own_process(*named).returncode == 0


@pytest.mark.parametrize(
    "on", some_of(["one process", "two processes", "a cluster"], ["two processes"])
)
def test_a_pair_that_never_ends_fails_alone_and_leaves_no_process(
    dataset, finished, tmp_path, request, monkeypatch, on
):
    monkeypatch.setenv("PYTHONPATH", TEST_MODULES)
    address = (
        request.getfixturevalue("cluster").add_workers(2, "--nanny").address
        if on == "a cluster"
        else None
    )
    workers = {"one process": 1, "two processes": 2}.get(on)
    pids = tmp_path / "pids"
    pids.mkdir()
    stages = broken_jobs.with_job("graph", partial(never_ending_graph, pids))
    begun = time.monotonic()
    outcome = run(
        dataset,
        tmp_path / "run",
        workers=workers,
        scheduler=address,
        stages=stages,
        pair_timeout_s=LIMIT_S,
    )
    assert time.monotonic() - begun < ENDLESS_S / 3
    assert list(outcome.failures) == [broken_jobs.POISON]
    assert (
        f"not finished after {LIMIT_S:g} s of work in stage graph, real"
        in outcome.failures[broken_jobs.POISON]
    )
    assert not (tmp_path / "run" / ".time_limit").exists()
    assert len(list(pids.iterdir())) == 1
    assert not any(psutil.pid_exists(int(path.name)) for path in pids.iterdir())
    if on != "a cluster":
        own = psutil.Process()
        assert [
            child for child in own.children(recursive=True) if child.ppid() != own.pid
        ] == []
    assert run(dataset, tmp_path / "run").n_made == JOBS_PER_PAIR
    assert_same_tables(tmp_path / "run", finished)


def test_a_worker_with_other_code_or_other_files_is_refused(tmp_path):
    (tmp_path / TOKEN).write_text("mine")
    versions = code_versions([])
    required = Requirements(versions, TableFolder(tmp_path, "mine"))
    assert worker_fault(required) == ""
    others = replace(required, versions=dict.fromkeys(versions, "01234567"))
    assert f"{code_hash()} (here 01234567)" in worker_fault(others)
    another = replace(required, tables=TableFolder(tmp_path, "another"))
    assert worker_fault(another).startswith(str(tmp_path))
    gone = tmp_path / "gone"
    missing = replace(required, tables=TableFolder(gone, "mine"))
    assert worker_fault(missing).startswith(str(gone))
    with pytest.raises(RunError, match=r"scipy .*0\.0\.9"):
        engine_cluster._in_worker(replace(required, versions={"scipy": "0.0.9"}), pow, 2, 5)


@pytest.mark.exhaustive
def test_a_pair_in_many_batches_of_which_none_ends_fails_alone(dataset, tmp_path, monkeypatch):
    monkeypatch.setenv("PYTHONPATH", TEST_MODULES)
    stages = broken_jobs.with_job("selection", never_ending_selection)
    small = {"WORTH_SPLITTING_S": 0.0, "BATCH_S": 0.0}
    outcome = run(
        dataset,
        tmp_path / "run",
        workers=2,
        stages=stages,
        policy=small,
        pair_timeout_s=LIMIT_S,
    )
    assert list(outcome.failures) == [broken_jobs.POISON]
    assert (
        f"not finished after {LIMIT_S:g} s of work in stage selection; a larger"
        in outcome.failures[broken_jobs.POISON]
    )
