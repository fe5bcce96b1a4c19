"""A pair whose reader crashes the interpreter, never ends or fills the memory: one that another package installed."""

import json
import os
import re
import shutil
import time
from contextlib import contextmanager

import numpy as np
import pytest

from runs import own_process, run, some_of
from scenes import drifted, street, write_dataset
from tries import Started, assert_resumes, lines_of, n_lost

N_PAIRS = 4
LIMIT_S = 3  # a healthy pair takes 0.2 s
POISON = "002"

#: Reads what `numpy.save` writes, unless a file next to it names something else to do.
READER = """
import ctypes
import time

import numpy as np

from fidpipe.pipeline.datasets.readers.scan import scan_from_columns


def read(path):
    trap = path.with_suffix(".do")
    if trap.exists():
        path.with_suffix(".begun").touch()
        HARM[trap.read_text()]()
    with path.open("rb") as file:
        return scan_from_columns(path, dict(zip("xyz", np.load(file).T, strict=True)))


def crash():
    ctypes.string_at(0)


def hang():
    ctypes.PyDLL(None).sleep(900)  # with the interpreter held, as a library does that has lost its way


def wait():
    time.sleep(900)


def fill_memory():
    kept = []
    while True:
        kept.append(np.ones(4_000_000))


HARM = {"crash": crash, "hang": hang, "wait": wait, "fill_memory": fill_memory}
"""


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    """Small streets, of which one pair is in the format of the other package."""
    folder = write_dataset(tmp_path_factory.mktemp("data") / "streets", N_PAIRS)
    scan = street(seed=77)
    for side, points in (("real", scan), ("sim", drifted(scan, seed=7))):
        (folder / side / f"{POISON}.bin").unlink()
        with (folder / side / f"{POISON}.trap").open("wb") as file:
            np.save(file, points)
    return folder


@pytest.fixture(autouse=True)
def installed(tmp_path_factory, monkeypatch):
    """The other package, where the command and its workers find it."""
    folder = tmp_path_factory.mktemp("site")
    about = folder / "fidpipe_trap-1.0.dist-info"
    about.mkdir()
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: fidpipe-trap\nVersion: 1.0\n")
    (about / "entry_points.txt").write_text("[fidpipe.readers]\ntrap = fidpipe_trap\n")
    (folder / "fidpipe_trap.py").write_text(READER)
    monkeypatch.setenv("PYTHONPATH", str(folder), prepend=os.pathsep)


@pytest.fixture(scope="module")
def undisturbed(dataset, tmp_path_factory):
    """The run of the same scans in a format of ours."""
    folder = shutil.copytree(dataset, tmp_path_factory.mktemp("undisturbed") / "streets")
    for scan in folder.glob("*/*.trap"):
        scan.rename(scan.with_suffix(".npy"))
    run(folder, folder / "run")
    return folder / "run"


@contextmanager
def trap(dataset, what):
    """Within it the reader does something else; a path that exists once it has begun."""
    path = dataset / "real" / f"{POISON}.do"
    path.write_text(what)
    try:
        yield path.with_suffix(".begun")
    finally:
        path.unlink()
        path.with_suffix(".begun").unlink(missing_ok=True)


DIED = "stage ground, real: the worker process died"
OUT_OF_TIME = f"{LIMIT_S} s of work in stage ground, real"
OUT_OF_MEMORY = r"cannot be read \(Unable to allocate|the worker process died"  # the limit of the worker, or dask's
IN_LITTLE_MEMORY = ("--set", "machine.memory_gib=1.5")
WITH_LIMIT = ("--pair-timeout", LIMIT_S)

#: What the reader does, with how many workers and which options, and the message.
TRIES = [
    ("crash", 1, (), DIED),
    ("crash", 2, (), DIED),
    ("hang", 2, WITH_LIMIT, OUT_OF_TIME),
    ("wait", 2, WITH_LIMIT, OUT_OF_TIME),
    ("fill_memory", 2, IN_LITTLE_MEMORY, OUT_OF_MEMORY),
]


@pytest.mark.parametrize(
    ("what", "workers", "words", "reason"),
    some_of(TRIES, TRIES[:1]),
    ids=[f"{t[0]}-{t[1]}" for t in TRIES],
)
def test_a_pair_whose_reader_breaks_fails_alone_and_is_named(
    dataset, undisturbed, tmp_path, what, workers, words, reason
):
    out = tmp_path / "run"
    with trap(dataset, what):
        started = Started("run", dataset, "--out", out, "--workers", workers, *words)
        code, errors = started.end()
        named = [
            line for line in lines_of(errors) if re.search(f"pair {POISON}: .*{reason}", line)
        ]
        assert (code, len(named)) == (3, 1), errors
        assert "Traceback" not in errors
        assert n_lost(out, undisturbed) == 1
        status = own_process("status", out, timeout=60, code=0)
        assert "1 pair failed" in status.stdout + status.stderr or POISON in status.stdout
    assert_resumes(dataset, out, undisturbed, start=own_process)


def test_check_names_a_pair_whose_reader_crashes_and_reads_the_others(dataset):
    with trap(dataset, "crash"):
        done = own_process("check", dataset, "--json")
    found = json.loads(done.stdout)
    assert (done.returncode, len(found["faults"])) == (1, 1)
    assert re.match(f"pair {POISON}: the worker process died", found["faults"][0])
    assert [pair["real"] is None for pair in found["pairs"]] == [
        pair["pair_id"] == POISON for pair in found["pairs"]
    ]


@pytest.mark.exhaustive
def test_a_reader_that_is_interrupted_leaves_nothing(dataset, undisturbed, tmp_path):
    out = tmp_path / "run"
    with trap(dataset, "hang") as begun:
        started = Started("run", dataset, "--out", out, "--workers", 2)
        assert started.wait_for(begun.exists)
        time.sleep(0.5)
        started.process.terminate()
        code, errors = started.end()
        assert (code, lines_of(errors)[-1:]) == (
            130,
            ["interrupted; run the same command again to resume"],
        )
    assert_resumes(dataset, out, undisturbed, start=own_process)
