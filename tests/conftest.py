"""What all tests share: the real scans, one BLAS thread, and small datasets on disk."""

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

# Libraries read these when they are loaded, so the imports come after.
import shutil
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from reports import finished_run, reference_run
from runs import run
from scenes import write_dataset
from tries import Tally

REAL_DATA = Path(__file__).resolve().parents[2] / "shared" / "data"


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


@pytest.fixture(scope="session")
def tally():
    """The count of what faults were tried and what was lost; a table of it where a folder is named for that."""
    folder = os.environ.get("FIDPIPE_FAULTS_TABLE")
    return Tally(Path(folder) if folder else None)
