"""Progress of a run: stages by pairs, done, stale, failed, to do. Reads the run and its dataset, writes nothing."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection
from dataclasses import dataclass, field
from pathlib import Path

from ...schemas.errors import RunError
from ...schemas.settings import parse
from ..datasets.pairs import local_folder, read_dataset
from ..engine.plan import PairPlan, plan_jobs, plan_pair, with_results
from ..engine.survey import hash_files
from ..jobs import stages_under
from ..stage import Stage
from ..storage.folder import RunFolder
from ..storage.table_files import JobName
from .finished import record_of_run

STATES = ("done", "stale", "failed", "to do")


@dataclass
class RunStatus:
    """Progress of a run.

    stages : by stage, how many pairs are in which state
    failures : why each failed pair failed
    damaged : names of the tables that are not as they were written
    """

    folder: Path
    dataset: str
    n_pairs: int
    stages: dict[str, Counter[str]]
    failures: dict[str, str] = field(default_factory=dict)
    damaged: list[str] = field(default_factory=list)


def run_status(folder: Path) -> RunStatus:
    """Progress of a run, given its dataset as it is now and the settings that it was made with.

    Raises
    ------
    RunError
        The folder is not a run.
    """
    record = record_of_run(folder)
    if not {"dataset", "settings"} <= record.keys():
        raise RunError(
            f"run {folder}: run.json is damaged, it names no dataset or no settings; run it again"
        )
    dataset = read_dataset(local_folder(record["dataset"]))
    settings = parse(record["settings"])
    stages = stages_under(settings)
    store = RunFolder(folder)
    jobs = plan_jobs(stages, settings)
    states: dict[str, Counter[str]] = {stage.name: Counter() for stage in stages}
    status = RunStatus(folder, record["dataset"], len(dataset.pairs), states)
    contents, faults = hash_files(dataset.pairs, store)
    for pair in dataset.pairs:
        name = pair.pair_id
        if name in faults:
            status.failures[name] = faults[name]
            for counts in states.values():
                counts["failed"] += 1
            continue
        plan = plan_pair(jobs, pair, contents[name], dataset.label_names)
        plan, unwanted = with_results(plan, store)
        reason = store.ledger.failure(name, [plan.keys[job.name] for job in plan.todo])
        if reason:
            status.failures[name] = reason
        for stage in stages:
            state = _stage_state(stage, plan, unwanted, has_failed=bool(reason))
            states[stage.name][state] += 1
        for finished in store.ledger.jobs(name).values():
            if finished.name in unwanted:
                status.damaged += store.damaged_files(finished)
    for finished in store.ledger.jobs("").values():
        status.damaged += store.damaged_files(finished)
    return status


def _stage_state(
    stage: Stage, plan: PairPlan, unwanted: Collection[JobName], *, has_failed: bool
) -> str:
    """One of `STATES`: the state of a stage of a pair."""
    if all((stage.name, part) in plan.records for part in stage.parts):
        return "done"
    if has_failed:
        return "failed"
    if any((stage.name, plan.pair_id, part) in unwanted for part in stage.parts):
        return "stale"
    return "to do"
