"""Changes around a run: its dataset, the clock, a disk that is full or read-only."""

import os
import re
import signal
import tempfile
from pathlib import Path

import pytest

from runs import own_process, run, some_of
from scenes import drifted, street, write_bin
from tries import Started, assert_resumes, lines_of

N_PAIRS = 4


def other_scan(path):
    write_bin(path, drifted(street(30), seed=99))


CHANGES = {
    "another scan": (
        other_scan,
        "003.bin: the file changed while the run was using it; run the same command again",
    ),
    "cut off": (lambda path: path.write_bytes(path.read_bytes()[:-7]), "003.bin: .*bytes"),
    "taken away": (Path.unlink, "003.bin: .*(No such file|not found|missing)"),
}


@pytest.mark.parametrize("change", some_of(CHANGES, ["another scan"]))
def test_a_dataset_that_changes_during_the_run_gives_no_mixed_result(data, tmp_path, change):
    out = tmp_path / "run"
    harm, reason = CHANGES[change]
    started = Started("run", data, "--out", out, "--workers", 1)
    assert started.wait_for((out / "ground" / "000.real.parquet").exists)
    # so that it changes in the middle, regardless of the machine's load
    started.process.send_signal(signal.SIGSTOP)
    harm(data / "sim" / "003.bin")
    started.process.send_signal(signal.SIGCONT)
    code, errors = started.end()
    assert code == 3, errors
    (told,) = [line for line in lines_of(errors) if "pair 003" in line]
    assert re.search(reason, told), told
    assert "Traceback" not in errors
    fresh = tmp_path / "fresh"
    run(data, fresh)
    code = 3 if change != "another scan" else 0
    assert_resumes(data, out, fresh, code=code)


def test_scans_that_change_and_change_back_between_two_runs_change_nothing(
    data, finished, tmp_path
):
    out = tmp_path / "run"
    run(data, out)
    kept = (data / "sim" / "003.bin").read_bytes()
    other_scan(data / "sim" / "003.bin")
    run(data, out)
    (data / "sim" / "003.bin").write_bytes(kept)
    os.utime(data / "sim" / "003.bin", (0, 0))  # older than all that was made of it
    assert_resumes(data, out, finished)


def test_files_from_the_future_and_the_past_are_judged_by_what_they_hold(
    data, finished, tmp_path
):
    out = tmp_path / "run"
    run(data, out)
    for i, path in enumerate(sorted([*out.rglob("*.parquet"), *data.rglob("*.bin")])):
        os.utime(path, (0, 0) if i % 2 else (4e9, 4e9))
    assert run(data, out).n_made == 0
    assert_resumes(data, out, finished)


@pytest.fixture
def temporary():
    """A folder for temporary files, whose path is short enough for the sockets in it."""
    with tempfile.TemporaryDirectory() as folder:
        yield Path(folder)


def test_what_a_killed_command_left_among_temporary_files_is_removed_by_the_next(
    data, finished, tmp_path, temporary
):
    out = tmp_path / "run"
    started = Started("run", data, "--out", out, "--workers", 2, TMPDIR=str(temporary))
    assert started.wait_for(lambda: list(out.glob("ground/*.parquet")))
    left = {path.name.partition("-")[0] for path in temporary.glob("*/*")}
    assert {"pymp", "dask"} <= left, left
    for process in started.family():
        process.kill()
    started.end()
    assert list(temporary.iterdir())
    own_process(
        "run",
        data,
        "--out",
        out,
        "--workers",
        2,
        code=0,
        env={**os.environ, "TMPDIR": str(temporary)},
    )
    assert not list(temporary.iterdir())
    assert_resumes(data, out, finished)
