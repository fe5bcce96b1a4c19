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


def at_work(dataset, folder, work_s, seed):
    """A command with workers after a random part of its work, its folder, and the random numbers that follow."""
    rng = random.Random(seed)
    for i in range(20):
        started = start(dataset, folder / f"run{i}")
        moment = rng.uniform(0.0, work_s)
        if not started.ends_within(moment) and started.wait_for(started.workers):
            print(f"seed {seed}: {moment:.3f} s after the command opened its folder")
            return started, folder / f"run{i}", rng
        assert started.end()[0] == 0
    raise TimeoutError("the command always ended first")


@pytest.mark.parametrize("seed", some_of(range(10), [0]))
def test_a_killed_worker_costs_a_run_nothing(dataset, finished, tmp_path, work_s, seed):
    started, out, rng = at_work(dataset, tmp_path, work_s, seed)
    with suppress(psutil.NoSuchProcess, IndexError):  # it may end by itself in that moment
        rng.choice(started.workers()).kill()
    code, errors = started.end()
    assert (code, "Traceback" in errors) == (0, False), errors
    assert_same_tables(out, finished)
    assert temporary_files(out) == []


STOPS = [
    (number, n, seed)
    for number in (signal.SIGINT, signal.SIGTERM)
    for n in (1, 2)
    for seed in range(3)
]
STOPS += [(signal.SIGKILL, 1, seed) for seed in range(10)]


@pytest.mark.parametrize(("number", "n_signals", "seed"), some_of(STOPS, [STOPS[3], STOPS[6]]))
def test_a_command_that_is_killed_or_told_to_stop_resumes(
    dataset, finished, tmp_path, work_s, number, n_signals, seed
):
    started, out, rng = at_work(dataset, tmp_path, work_s, f"{seed} {number} {n_signals}")
    for i in range(n_signals):
        time.sleep(rng.uniform(0.0, work_s / 4) if i else 0.0)
        send(started, number)
    code, errors = started.end()
    if code == 0:  # all was written; it only ended
        assert (out / "pairs.parquet").exists()
    elif number == signal.SIGKILL:
        assert code == -number
    else:
        assert (code, lines_of(errors)[-1:], errors.count(INTERRUPTED)) == (
            130,
            [INTERRUPTED],
            1,
        ), errors
    assert "Traceback" not in errors
    assert "preset paper" in assert_resumes(dataset, out, finished, workers=1 + seed % 2)


def send(started, number):
    """Ctrl-C as a terminal sends it, to the workers too; another signal to the command alone."""
    if started.process.poll() is not None:
        return
    if number == signal.SIGINT:
        os.killpg(started.process.pid, number)
    else:
        started.process.send_signal(number)
