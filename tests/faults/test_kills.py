"""Processes that die, are interrupted, or run at the same time."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pexpect
import pytest

import broken_jobs
from fidpipe.pipeline.engine.cluster import DaskPool
from fidpipe.pipeline.engine.pool import WorkerDied
from fidpipe.pipeline.storage.ledger import LEDGER
from runs import (
    FIDPIPE,
    JOBS_PER_PAIR,
    STAGE_NAMES,
    assert_same_tables,
    own_process,
    run,
    some_of,
    temporary_files,
)
from tries import wait_until

N_PAIRS = 4

TESTS = Path(broken_jobs.__file__).parent


@pytest.mark.parametrize(
    ("how", "stage"),
    some_of(
        [(how, stage) for how in ("kill", "kill-writing") for stage in STAGE_NAMES],
        [("kill", "matching"), ("kill-writing", "communities")],
    ),
)
def test_a_run_killed_in_a_stage_goes_on_where_it_was(dataset, finished, tmp_path, how, stage):
    out = tmp_path / "run"
    died = subprocess.run(
        [sys.executable, TESTS / "broken_jobs.py", how, stage, "2", dataset, out],
        check=False,
        capture_output=True,
    )
    assert died.returncode == -(signal.SIGXFSZ if how == "kill-writing" else signal.SIGKILL), (
        died.stderr
    )
    assert not (out / "pairs.parquet").exists()
    assert (temporary_files(out) == []) == (how == "kill")
    outcome = run(dataset, out)
    assert outcome.n_made == N_PAIRS * JOBS_PER_PAIR  # they were one batch
    assert_same_tables(out, finished)
    assert temporary_files(out) == []


@pytest.mark.exhaustive
def test_ctrl_c_on_a_terminal_ends_heavy_work_within_seconds(real_data, tmp_path):
    out = tmp_path / "run"
    words = [
        "run",
        str(real_data / "kitti_twin"),
        "--out",
        str(out),
        "--workers",
        "2",
        "--pairs",
        "000002",
    ]
    terminal = pexpect.spawn(FIDPIPE, words, encoding="utf-8", timeout=60, dimensions=(40, 160))
    wait_until((out / "matching" / "000002.parquet").exists)  # only objects are left
    terminal.sendintr()
    begun = time.monotonic()
    terminal.expect("interrupted; run the same command again to resume")
    terminal.expect(pexpect.EOF)
    terminal.close()
    assert time.monotonic() - begun < 15  # 1 to 4 on a machine with nothing else to do
    assert "Traceback" not in terminal.before
    assert terminal.exitstatus == 130


def test_a_second_run_on_the_same_folder_is_refused(dataset, finished, tmp_path):
    out = tmp_path / "run"
    words = [FIDPIPE, "run", dataset, "--out", out, "--workers", "1"]
    process = subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    wait_until((out / LEDGER).exists)
    process.send_signal(signal.SIGSTOP)
    second = own_process("run", dataset, "--out", out, "--workers", "1", code=1)
    assert "another fidpipe" in second.stderr
    process.send_signal(signal.SIGCONT)
    process.communicate(timeout=120)
    assert process.returncode == 0
    assert_same_tables(out, finished)


def note(path):
    """Append a line to a file, so that a test can count the calls."""
    with path.open("a") as file:
        file.write("called\n")
    return path.read_text()


@pytest.fixture
def pool(monkeypatch):
    """One worker process, which can import this module."""
    monkeypatch.setenv("PYTHONPATH", str(Path(__file__).parent), prepend=os.pathsep)
    pool = DaskPool(1)
    yield pool
    pool.close()


def test_a_finished_task_is_not_run_again_when_its_worker_dies(pool, tmp_path):
    handle = pool.submit(note, tmp_path / "calls")
    assert pool.next_done() == (handle, "called\n")
    pool.submit(os._exit, 1)
    assert isinstance(pool.next_done()[1], WorkerDied)
    pool.submit(pow, 2, 5)
    assert pool.next_done()[1] == 32
    assert (tmp_path / "calls").read_text() == "called\n"
