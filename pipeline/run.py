"""The pipeline: its stages in their order, and a run over a dataset from reading to the record.

This is the page to read first. A run is the list of verbs in `run_dataset`. Leaves to others: what a stage computes
(`stages`), what a job reads and writes (`jobs`, `store`), when and where it runs (`schedule`, `fanout`).
"""

from __future__ import annotations

from fnmatch import fnmatchcase
from pathlib import Path

from ..schemas.errors import DatasetError, RunError
from ..schemas.settings import Settings
from .datasets.pairs import Dataset, ScanPair, read_dataset
from .engine.plan import Stage
from .engine.progress import Reporter
from .engine.request import RunOutcome, RunRequest
from .engine.session import Session
from .jobs import baselines as baseline_jobs
from .jobs import core as jobs
from .jobs import seeds as seed_jobs
from .storage.ledger import INDEX
from .storage.record import read_run
from .storage.store import Store

_CUTTERS = {"pca": ("scikit-learn",), "patchwork": ("pypatchworkpp", "scikit-learn"), "none": ("scikit-learn",)}
_LOUVAINS = {"scikit-network": ("scikit-network",), "python-louvain": ("python-louvain", "networkx")}

#: The pipeline. To add a stage: a schema, a settings class, a function, a row here, a test.
STAGES = (
    Stage(
        "ground",
        takes=("scan",),
        gives=("ground",),
        per_side=True,
        settings=("input", "ground"),
        libraries=lambda settings: _CUTTERS[settings.ground.method],
        version=1,
        make=jobs.make_ground,
    ),
    Stage(
        "graph",
        takes=("ground",),
        gives=("graph",),
        per_side=True,
        settings=("graph",),
        libraries=lambda settings: (),
        version=1,
        make=jobs.make_graph,
    ),
    Stage(
        "communities",
        takes=("ground", "graph"),
        gives=("communities", "objects"),
        per_side=True,
        settings=("communities",),
        libraries=lambda settings: _LOUVAINS[settings.communities.backend],
        version=2,
        make=jobs.make_communities,
    ),
    Stage(
        "matching",
        takes=("objects",),
        gives=("matching",),
        per_side=False,
        settings=("matching",),
        libraries=lambda settings: (),
        version=1,
        make=jobs.make_matching,
    ),
    Stage(
        "selection",
        takes=("ground", "graph", "communities", "matching"),
        gives=("selection",),
        per_side=False,
        settings=("selection",),
        libraries=lambda settings: ("POT",),
        version=1,
        make=jobs.make_selection,
    ),
    Stage(
        "metrics",
        takes=("ground", "graph", "communities", "objects", "matching", "selection"),
        gives=("metrics",),
        per_side=False,
        settings=(),
        libraries=lambda settings: (),
        version=1,
        make=jobs.make_metrics,
    ),
)
STAGE_NAMES = tuple(stage.name for stage in STAGES)

#: What is made besides, where the settings ask for it; no stage above depends on any of it.
EXTRAS = (
    Stage(
        baseline_jobs.STAGE,
        takes=("ground", "graph", "communities", "matching", "selection"),
        gives=("baselines",),
        per_side=False,
        settings=("selection", "metrics"),
        libraries=baseline_jobs.libraries,
        version=1,
        make=baseline_jobs.make_baselines,
        is_wanted=lambda settings: bool(settings.metrics.baselines),
        summarise=baseline_jobs.summarise_baselines,
    ),
    Stage(
        seed_jobs.STAGE,
        takes=("ground", "graph", "metrics"),
        gives=("seeds",),
        per_side=False,
        settings=("stability",),
        libraries=lambda settings: (),
        version=1,
        make=seed_jobs.make_seeds,
        is_wanted=lambda settings: settings.stability.seeds > 1,
        summarise=seed_jobs.summarise_seeds,
    ),
)


def stages_of(settings: Settings) -> tuple[Stage, ...]:
    """The stages that a run under these settings goes through."""
    return (*STAGES, *(stage for stage in EXTRAS if stage.is_wanted and stage.is_wanted(settings)))


def run_dataset(request: RunRequest, reporter: Reporter) -> RunOutcome:
    """Evaluates a dataset: makes every table that is not there yet under its wanted key.

    Raises
    ------
    FidpipeError
        The dataset as a whole, a setting or the run's folder is wrong; before any work.
    KeyboardInterrupt
        As it came; the run can be gone on with.
    """
    dataset = read_dataset(request.dataset)
    selected = select_pairs(dataset, request.pattern)
    check_folder(request.out, request.dataset)
    store = Store(request.out)
    with store.locked():
        run = Session(request, stages_of(request.settings), dataset, selected, store, reporter)
        try:
            run.inspect()
            run.plan()
            run.clear()
            run.work()
            return run.write()
        finally:
            run.close()


def select_pairs(dataset: Dataset, pattern: str | None) -> tuple[ScanPair, ...]:
    """The pairs whose name matches."""
    if pattern is None:
        return dataset.pairs
    selected = tuple(pair for pair in dataset.pairs if fnmatchcase(pair.pair_id, pattern))
    if not selected:
        names = ", ".join(pair.pair_id for pair in dataset.pairs[:5])
        raise DatasetError(f"--pairs {pattern!r} matches none of the {len(dataset.pairs)} pairs ({names} ...)")
    return selected


def check_folder(out: Path, dataset: Path, experiment: str = "run") -> None:
    """Refuses a folder that is not a run, or is the run of another dataset or of another command."""
    if not out.exists():
        return
    if not out.is_dir():
        raise RunError(f"run {out}: is a file, a folder is wanted; give another --out")
    if not (out / INDEX).exists() and any(not path.name.startswith(".") for path in out.iterdir()):
        raise RunError(f"run {out}: the folder holds other things than a run; give another --out")
    record = read_run(out)
    before, made_by = record.get("dataset"), record.get("experiment", "run")
    if before and made_by != experiment:
        raise RunError(f"run {out}: was written by fidpipe {made_by}, not by fidpipe {experiment}; give another --out")
    if before and Path(before) != dataset.resolve() and Path(before).exists():
        raise RunError(f"run {out}: holds the results of {before}, not of {dataset}; give another --out")
