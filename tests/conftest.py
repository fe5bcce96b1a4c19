"""Shared by all tests: the real scans, one BLAS thread, and small datasets on disk."""

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

# Libraries read these when they are loaded, so the imports come after.
import gc
import shutil
import time
from pathlib import Path
from zlib import crc32

import numpy as np
import pytest

from scenarios import Shared

#: Days in which CI runs each exhaustive test once.
N_SLICES = 12
STARTED = time.monotonic()
REAL_DATA = Path(__file__).resolve().parents[2] / "shared" / "data"


def pytest_addoption(parser):
    parser.addoption(
        "--slice",
        type=int,
        metavar="DAY",
        help=f"one of {N_SLICES} parts of the exhaustive tests",
    )
    parser.addoption(
        "--minutes", type=float, metavar="N", help="skip the tests that have not begun by then"
    )


def pytest_collection_modifyitems(config, items):
    """With --slice, keep the exhaustive tests of that day."""
    if (day := config.getoption("--slice")) is not None:
        kept = [
            item
            for item in items
            if item.get_closest_marker("exhaustive")
            and crc32(item.nodeid.encode()) % N_SLICES == day % N_SLICES
        ]
        config.hook.pytest_deselected(items=[item for item in items if item not in kept])
        items[:] = kept


def pytest_runtest_setup(item):
    """With --minutes, skip a test that would begin later."""
    minutes = item.config.getoption("--minutes")
    if minutes is not None and time.monotonic() - STARTED > 60 * minutes:
        pytest.skip(f"{item.nodeid}: not reached within {minutes:g} minutes")


def pytest_unconfigure():
    """Commands that ran in this process froze its objects; libraries report those that are never collected."""
    gc.unfreeze()


@pytest.fixture(scope="session", autouse=True)
def unforced_writes():
    """This process leaves it to the system when files are on the disk, which would take a fifth of a small run."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(os, "fsync", lambda file: None)
        yield


@pytest.fixture(scope="session")
def real_data() -> Path:
    """The folder of real scans; without it the test is skipped, or fails where real data are required."""
    if not REAL_DATA.is_dir():
        if os.environ.get("FIDPIPE_REQUIRE_REAL_DATA") == "1":
            pytest.fail(f"FIDPIPE_REQUIRE_REAL_DATA=1 and {REAL_DATA} is absent")
        pytest.skip(f"{REAL_DATA} is absent")
    return REAL_DATA


@pytest.fixture(scope="session")
def scenario(request, tmp_path_factory) -> Shared:
    """The folders of shared finished runs by their names in `scenarios`; not to be written to."""
    base = tmp_path_factory.getbasetemp()
    return Shared(base.parent if hasattr(request.config, "workerinput") else base)


@pytest.fixture(scope="session")
def report_run(scenario) -> Path:
    """A small finished run whose pairs and classes have hostile names; not to be written to."""
    return scenario("labelled") / "run"


@pytest.fixture(scope="session")
def by_reference(scenario) -> Path:
    """A small finished run whose objects the real side fixes; not to be written to."""
    return scenario("reference") / "run"


@pytest.fixture(scope="module")
def dataset(request, scenario) -> Path:
    """Two small pairs, or as many and as large ones as the module says by N_PAIRS and N_POINTS."""
    module = request.module
    return (
        scenario("plain", getattr(module, "N_PAIRS", 2), getattr(module, "N_POINTS", 150))
        / "streets"
    )


@pytest.fixture(scope="module")
def finished(dataset) -> Path:
    """The finished run of these; not to be written to."""
    return dataset.with_name("run")


@pytest.fixture
def data(dataset, tmp_path) -> Path:
    """A copy of the dataset that a test may spoil."""
    return shutil.copytree(dataset, tmp_path / "streets")


@pytest.fixture
def again(finished, tmp_path) -> Path:
    """A copy of the finished run that a test may spoil."""
    return shutil.copytree(finished, tmp_path / "run")


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(20)
