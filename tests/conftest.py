"""What all tests share: the real scans, one BLAS thread, and small datasets on disk."""

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

# Libraries read these when they are loaded, so the imports come after.
import shutil
import time
from functools import cache
from pathlib import Path
from zlib import crc32

import numpy as np
import pytest

from reports import finished_run, reference_run
from runs import run
from scenes import write_dataset

#: Days in which CI runs each exhaustive test once.
N_SLICES = 12
STARTED = time.monotonic()
REAL_DATA = Path(__file__).resolve().parents[2] / "shared" / "data"


def pytest_addoption(parser):
    parser.addoption("--slice", type=int, metavar="DAY", help=f"one of {N_SLICES} parts of the exhaustive tests")
    parser.addoption("--minutes", type=float, metavar="N", help="skip the tests that have not begun by then")


def pytest_collection_modifyitems(config, items):
    """With --slice, keep the exhaustive tests of that day."""
    if (day := config.getoption("--slice")) is not None:
        kept = [
            item
            for item in items
            if item.get_closest_marker("exhaustive") and crc32(item.nodeid.encode()) % N_SLICES == day % N_SLICES
        ]
        config.hook.pytest_deselected(items=[item for item in items if item not in kept])
        items[:] = kept


def pytest_runtest_setup(item):
    """With --minutes, skip a test that would begin later."""
    minutes = item.config.getoption("--minutes")
    if minutes is not None and time.monotonic() - STARTED > 60 * minutes:
        pytest.skip(f"{item.nodeid}: not reached within {minutes:g} minutes")


@pytest.fixture(scope="session")
def real_data() -> Path:
    """The folder of real scans; without it the test is skipped, or fails where real data are required."""
    if not REAL_DATA.is_dir():
        if os.environ.get("FIDPIPE_REQUIRE_REAL_DATA") == "1":
            pytest.fail(f"FIDPIPE_REQUIRE_REAL_DATA=1 and {REAL_DATA} is absent")
        pytest.skip(f"{REAL_DATA} is absent")
    return REAL_DATA


@pytest.fixture(scope="session")
def report_run(tmp_path_factory) -> Path:
    """A small finished run whose pairs and classes have hostile names; not to be written to."""
    return finished_run(tmp_path_factory.mktemp("report"))


@pytest.fixture(scope="session")
def by_reference(tmp_path_factory) -> Path:
    """A small finished run whose objects the real side fixes; not to be written to."""
    return reference_run(tmp_path_factory.mktemp("reference"))


@pytest.fixture(scope="session")
def streets(tmp_path_factory):
    """Folders of small pairs by their number and points a thing, each made once; not to be written to."""
    return cache(lambda n_pairs, n: write_dataset(tmp_path_factory.mktemp("data") / "streets", n_pairs, n))


@pytest.fixture(scope="session")
def runs_of_streets(tmp_path_factory):
    """Finished runs of these by their folder, each made once; not to be written to."""

    @cache
    def finished(dataset):
        out = tmp_path_factory.mktemp("runs") / "streets"
        run(dataset, out)
        return out

    return finished


@pytest.fixture(scope="module")
def dataset(request, streets) -> Path:
    """Two small pairs, or as many and as large ones as the module says by N_PAIRS and N_POINTS."""
    return streets(getattr(request.module, "N_PAIRS", 2), getattr(request.module, "N_POINTS", 150))


@pytest.fixture(scope="module")
def finished(dataset, runs_of_streets) -> Path:
    """The finished run of these; not to be written to."""
    return runs_of_streets(dataset)


@pytest.fixture
def again(finished, tmp_path) -> Path:
    """A copy of the finished run that a test may spoil."""
    return shutil.copytree(finished, tmp_path / "run")


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(20)
