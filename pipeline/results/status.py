"""How far a run is: stages by pairs, done, stale, failed, to do. Reads the run and its dataset, writes nothing."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from pathlib import Path

from rich.console import Console

from ...schemas.errors import RunError
from ...schemas.settings import parse
from ..datasets.pairs import read_dataset
from ..engine.progress import Reporter
from ..engine.request import RunRequest
from ..engine.session import Session
from ..engine.task import PairTask
from ..run import stages_of
from ..storage.record import StageSeconds, read_run
from ..storage.store import Store

STATES = ("done", "stale", "failed", "to do")


@dataclass(frozen=True)
class RunStatus:
    """How far a run is.

    stages : by stage, how many pairs are in which state
    failures : why each failed pair failed
    mean_seconds : by stage and step, mean over the pairs that have it
    """

    folder: Path
    dataset: Path
    n_pairs: int
    stages: dict[str, Counter[str]]
    failures: dict[str, str]
    mean_seconds: dict[str, dict[str, float]]


def run_status(folder: Path) -> RunStatus:
    """How far a run is, judged by its dataset as it is now and by the settings that it was made with.

    Raises
    ------
    RunError
        The folder is no run.
    """
    record = read_run(folder)
    if not record:
        raise RunError(f"run {folder}: no run.json found; a folder written by fidpipe run is wanted")
    if "experiment" in record:
        made_by = f"fidpipe {record['experiment']}"
        raise RunError(
            f"run {folder}: was written by {made_by}, which goes on when it is run again; status is for runs"
        )
    dataset = read_dataset(Path(record["dataset"]))
    store = Store(folder)
    request = RunRequest(dataset.folder, folder, parse(record["settings"]))
    in_force = stages_of(request.settings)
    session = Session(request, in_force, dataset, dataset.pairs, store, Reporter(Console(quiet=True)))
    session.inspect(note=False)
    session.plan()
    failures = {row["pair_id"]: row["reason"] for row in session.standing.rows() if row["status"] == "failed"}
    stages: dict[str, Counter[str]] = {stage.name: Counter() for stage in in_force}
    for pair in dataset.pairs:
        task = session.standing.task(pair.pair_id)
        for stage in in_force:
            stages[stage.name][_state(store, stage.name, pair.pair_id, task, pair.pair_id in failures)] += 1
    seconds = StageSeconds()
    for job in session.standing.records():
        seconds.add(job)
    return RunStatus(folder, dataset.folder, len(dataset.pairs), stages, failures, seconds.mean())


def _state(store: Store, stage: str, pair_id: str, task: PairTask | None, failed: bool) -> str:
    own = [job for job in task.jobs if job.stage == stage] if task else []
    if own and all(job.stored for job in own):
        return "done"
    if failed:
        return "failed"
    is_there = any((stage, pair_id, job.side) in store.records for job in own if not job.stored)
    return "stale" if is_there else "to do"
