"""The tasks that workers run: some jobs of a pair, or of several pairs, or the scores of some objects of one.

Leaves to others: what a job makes (`jobs`), which tasks there are and when (`schedule`), where they run (`fanout`).
"""

from __future__ import annotations

import traceback
from collections.abc import Iterable

from ...schemas.errors import FidpipeError
from ..jobs.core import score_rows, select_rows
from ..storage.ledger import JobRecord
from .costs import largest_object, object_bytes
from .task import Failure, Job, ObjectScores, PairTask, Report
from .workbench import Workbench

#: The stages that work on matched objects, one by one if they are large.
OBJECT_STAGES = ("selection", "metrics")


def run_jobs(
    task: PairTask,
    wanted: Iterable[tuple[str, str]],
    bytes_for_objects: int | None = None,
) -> Report:
    """Makes the wanted (stage, side) jobs of a pair in order; a failure ends it, and what was finished stays.

    Where an object needs more than `bytes_for_objects` it ends before the first stage that works on objects.
    """
    bench = Workbench(task)
    return _reported(bench, [job for job in task.jobs if (job.stage, job.side) in set(wanted)], bytes_for_objects)


def run_pairs(parts: list[tuple[PairTask, tuple[tuple[str, str], ...], int]]) -> list[Report]:
    """What `run_jobs` gives for each of several pairs, in one task: the way to a worker then costs less a pair."""
    return [run_jobs(*part) for part in parts]


def score_objects(task: PairTask, real_ids: tuple[int, ...]) -> ObjectScores | Failure:
    """Selection and scores of some matched objects of a pair whose matching is done; nothing is written."""
    bench = _kept_bench(task)
    job = bench.job("selection")
    try:
        selection = bench.table("selection") if job.stored else select_rows(bench, real_ids)
        selection_steps = bench.take_steps()
        job = bench.job("metrics")
        metrics = score_rows(bench, real_ids, selection)
        return ObjectScores(selection, metrics, selection_steps, bench.take_steps())
    except Exception as error:  # one broken pair does not stop a dataset
        return _failure(job, error)


def gather_objects(task: PairTask, parts: list[ObjectScores | Failure]) -> Report:
    """Writes the tables of a pair from the scores of all its objects."""
    for part in parts:
        if isinstance(part, Failure):
            return Report(task.pair.pair_id, failure=part)
    scores = [part for part in parts if isinstance(part, ObjectScores)]
    bench = Workbench(task, scores=scores)
    return _reported(bench, [job for job in task.jobs if job.stage in OBJECT_STAGES and not job.stored])


def _kept_bench(task: PairTask) -> Workbench:
    """The workbench of a pair whose objects are scored in several tasks; a process keeps the last two."""
    keys = tuple(job.key for job in task.jobs)
    if (task.token, keys) not in _KEPT:
        while len(_KEPT) >= 2:
            del _KEPT[next(iter(_KEPT))]
        _KEPT[task.token, keys] = Workbench(task)
    return _KEPT[task.token, keys]


_KEPT: dict[tuple[str, tuple[str, ...]], Workbench] = {}


def _reported(bench: Workbench, jobs: list[Job], bytes_for_objects: int | None = None) -> Report:
    records: list[JobRecord] = []
    for job in jobs:
        if job.stage in OBJECT_STAGES and bytes_for_objects is not None:
            _, n_keep = largest_object(bench.facts("matching")["n_keep"])
            if object_bytes(n_keep) > bytes_for_objects:
                break
        try:
            records.append(bench.finish(job, *job.make(bench, job.side)))
        except Exception as error:  # one broken pair does not stop a dataset
            return Report(bench.pair_id, tuple(records), _failure(job, error))
    return Report(bench.pair_id, tuple(records))


def _failure(job: Job, error: Exception) -> Failure:
    if isinstance(error, FidpipeError):
        return Failure(job.stage, job.side, str(error))
    if isinstance(error, MemoryError):
        return Failure(job.stage, job.side, f"out of memory ({error})")
    trace = "".join(traceback.format_exception(error))
    return Failure(job.stage, job.side, f"internal error: {type(error).__name__}: {error}", trace)
