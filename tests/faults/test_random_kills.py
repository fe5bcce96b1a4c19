"""Kill -9 of the command and of a worker, SIGTERM and Ctrl-C, once and again while it stops, at random moments."""

import os
import random
import signal
import time
from contextlib import suppress

import psutil
import pytest

from runs import assert_same_tables, some_of, temporary_files
from tries import Started, assert_resumes, lines_of

N_PAIRS = 6
INTERRUPTED = "interrupted; run the same command again to resume"


@pytest.fixture(scope="module")
def work_s(dataset, tmp_path_factory):
    """Seconds that an undisturbed command works after it has opened its folder, on this machine as it is now."""
    out = tmp_path_factory.mktemp("undisturbed") / "run"
    undisturbed = start(dataset, out)
    begun = time.monotonic()
    assert undisturbed.end()[0] == 0
    return time.monotonic() - begun


def start(dataset, out, workers=2):
    started = Started("run", dataset, "--out", out, "--workers", workers)
    assert started.wait_for((out / ".writer").exists)
    return started


def started_for(dataset, folder, moments):
    """A command that still works after a random time; another moment is drawn if it ended before."""
    for i in range(20):
        out = folder / f"run{i}"
        started, moment = start(dataset, out), next(moments)
        if not started.ends_within(moment):
            return started, out, moment
        assert started.end()[0] == 0
    raise TimeoutError("the command always ended first")


def random_moments(seed, longest_s):
    rng = random.Random(seed)
    while True:
        yield rng.uniform(0.0, longest_s)


@pytest.mark.exhaustive
@pytest.mark.parametrize("seed", range(10))
def test_a_command_that_is_killed_goes_on_where_it_was(dataset, finished, tmp_path, work_s, seed):
    started, out, moment = started_for(dataset, tmp_path, random_moments(seed, work_s))
    print(f"seed {seed}: kill -9 of the command {moment:.3f} s after it opened its folder")
    started.kill()
    told = assert_resumes(dataset, out, finished, workers=1 + seed % 2)
    assert "preset paper" in told


@pytest.mark.parametrize("seed", some_of(range(10), [0]))
def test_a_killed_worker_costs_a_run_nothing(dataset, finished, tmp_path, work_s, seed):
    rng = random.Random(1000 + seed)
    for i in range(20):
        out = tmp_path / f"run{i}"
        started = start(dataset, out)
        moment = rng.uniform(0.0, work_s / 2)
        if started.wait_for(started.workers) and not started.ends_within(moment) and (there := started.workers()):
            break
        assert started.end()[0] == 0
    else:
        raise TimeoutError("the command always ended first")
    victim = rng.choice(sorted(there, key=lambda process: process.pid))
    print(f"seed {seed}: kill -9 of worker {victim.pid} {moment:.3f} s after the first of them was there")
    try:
        victim.kill()
    except psutil.NoSuchProcess:
        pytest.skip("the worker ended by itself in that moment")
    code, errors = started.end()
    assert (code, "Traceback" in errors) == (0, False), errors
    assert_same_tables(out, finished)
    assert temporary_files(out) == []


@pytest.mark.parametrize(
    ("number", "n_signals", "seed"),
    some_of(
        [(number, n, seed) for number in (signal.SIGINT, signal.SIGTERM) for n in (1, 2) for seed in range(3)],
        [(signal.SIGINT, 2, 0), (signal.SIGTERM, 1, 0)],
    ),
)
def test_a_command_that_is_told_to_stop_says_so_once(dataset, finished, tmp_path, work_s, number, n_signals, seed):
    moments = random_moments(f"{seed} {number} {n_signals}", work_s)
    started, out, moment = started_for(dataset, tmp_path, moments)
    pause = next(moments) / 4
    print(f"seed {seed}: {n_signals} times {number!r} after {moment:.3f} s, {pause:.3f} s apart")
    for i in range(n_signals):
        time.sleep(pause if i else 0.0)
        send(started, number)
    code, errors = started.end()
    if code == 0:  # all was written; it only ended
        assert (out / "pairs.parquet").exists()
    else:
        assert (code, lines_of(errors)[-1:]) == (130, [INTERRUPTED]), errors
        assert errors.count(INTERRUPTED) == 1
        assert "Traceback" not in errors
    assert_resumes(dataset, out, finished)


def send(started, number):
    """Ctrl-C as a terminal sends it, to the workers too; an order to end as a batch system does, to the command."""
    if started.process.poll() is not None:
        return
    if number == signal.SIGINT:
        os.killpg(started.process.pid, number)
    else:
        started.process.send_signal(number)


@pytest.mark.exhaustive
def test_a_stopped_worker_does_not_keep_a_run_from_ending(dataset, finished, tmp_path):
    out = tmp_path / "run"
    started = start(dataset, out)
    assert started.wait_for(started.workers)
    stopped = started.workers()
    for worker in stopped:
        worker.suspend()
    assert not started.ends_within(2.0)
    send(started, signal.SIGTERM)
    assert started.ends_within(60.0)
    for worker in stopped:
        with suppress(psutil.NoSuchProcess):
            worker.resume()
    code, errors = started.end()
    assert (code, lines_of(errors)[-1:]) == (130, [INTERRUPTED]), errors
    assert_resumes(dataset, out, finished)
