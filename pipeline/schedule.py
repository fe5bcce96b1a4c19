"""The order of work: which tasks of which pairs are submitted when, and what is done when one ends.

Pairs are started through a bounded window. A pair is one task; only when few pairs are left for the workers does it
fall into tasks by side and, largest first, by object. A pair whose worker died is tried once more with nothing
beside it, so that only the guilty one fails. Leaves to others: where tasks run (`fanout`), what is kept (`session`).
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

from .fanout import Handle, Pool, WorkerDied
from .jobs import gather_objects, run_jobs, score_objects
from .task import Failure, Job, ObjectScores, PairTask, Report

_SIDE_STAGES = ("ground", "graph", "communities")
_OBJECT_STAGES = ("selection", "metrics")
_PAIRS_A_WORKER = 2
_FEW_PAIRS_A_WORKER = 4
_FIRST = 1e6  # priority of what others wait for
_WORTH_SPLITTING_S = 1.0
_BATCH_S = 0.5


def side_seconds(n_raw: int) -> float:
    """Roughly what the stages of one side cost; orders tasks and guesses the time left, nothing else."""
    return 0.01 + 3.5e-5 * n_raw


def object_seconds(n_keep: int) -> float:
    """Roughly what one matched object costs."""
    return 0.002 + 5e-6 * n_keep + 4e-10 * n_keep**3


@dataclass
class _Active:
    """A pair that is being worked on."""

    task: PairTask
    failure: Failure | None = None
    suspect: bool = False
    waiting: set[Handle] = field(default_factory=set)

    @property
    def todo(self) -> list[Job]:
        return [job for job in self.task.jobs if not job.stored]


class Schedule:
    """Works off the jobs of many pairs.

    Parameters
    ----------
    pool : where tasks run
    tasks : the pairs, each with jobs to be made
    n_raw : points of both files, by pair_id
    on_report : called with what each task has finished, as soon as it has
    on_end : called with pair_id and failure (or None) when a pair has ended
    """

    def __init__(
        self,
        pool: Pool,
        tasks: Iterable[PairTask],
        n_raw: Mapping[str, int],
        on_report: Callable[[Report], None],
        on_end: Callable[[str, Failure | None], None],
    ) -> None:
        self._pool = pool
        self._pending = deque(tasks)
        self._n_raw = n_raw
        self._on_report = on_report
        self._on_end = on_end
        self._active: dict[str, _Active] = {}
        self._pair_of: dict[Handle, _Active] = {}
        self._quarantine: deque[_Active] = deque()
        self._alone = False

    def run(self) -> None:
        """Works until every pair has ended."""
        self._fill()
        while self._pair_of:
            handle, outcome = self._pool.next_done()
            pair = self._pair_of.pop(handle)
            pair.waiting.discard(handle)
            self._take(pair, outcome)
            if not pair.waiting:
                self._go_on(pair)
            self._fill()

    def _fill(self) -> None:
        if self._alone:
            return
        window = (_FEW_PAIRS_A_WORKER if self._few_left() else _PAIRS_A_WORKER) * self._pool.n_workers
        while self._pending and len(self._active) < window:
            pair = _Active(self._pending.popleft())
            self._active[pair.task.pair.pair_id] = pair
            self._go_on(pair)
        if self._quarantine and not self._active:
            self._alone = True
            pair = self._quarantine.popleft()
            self._active[pair.task.pair.pair_id] = pair
            self._submit(pair, run_jobs, _names(pair.todo))

    def _take(self, pair: _Active, outcome: Any) -> None:
        if isinstance(outcome, WorkerDied):
            if self._alone and pair.failure is None:
                job = pair.todo[0]
                reason = (
                    f"the worker process died, and again when the pair ran alone (out of memory?): {outcome.detail}"
                )
                pair.failure = Failure(job.stage, job.side, reason)
            pair.suspect = True
        elif isinstance(outcome, Report):
            self._on_report(outcome)
            pair.task = pair.task.with_records(outcome.records)
            pair.failure = pair.failure or outcome.failure

    def _go_on(self, pair: _Active) -> None:
        """Submits what comes next for a pair of which nothing is running."""
        if pair.failure or not pair.todo:
            self._end(pair)
        elif pair.suspect:
            del self._active[pair.task.pair.pair_id]
            self._quarantine.append(pair)
        elif not self._is_worth_splitting(pair):
            self._submit(pair, run_jobs, _names(pair.todo))
        elif sides := [job for job in pair.todo if job.stage in _SIDE_STAGES]:
            split = not pair.task.settings.ground.shared
            for side in ("real", "sim") if split else ("",):
                if own := [job for job in sides if not split or job.side == side]:
                    self._submit(pair, run_jobs, _names(own), priority=_FIRST)
        elif matching := [job for job in pair.todo if job.stage == "matching"]:
            self._submit(pair, run_jobs, _names(matching), priority=_FIRST)
        elif any(job.stage in _OBJECT_STAGES for job in pair.todo):
            self._submit_objects(pair)
        else:
            for job in pair.todo:
                self._submit(pair, run_jobs, _names([job]))

    def _end(self, pair: _Active) -> None:
        self._alone = False
        del self._active[pair.task.pair.pair_id]
        self._on_end(pair.task.pair.pair_id, pair.failure)

    def _is_worth_splitting(self, pair: _Active) -> bool:
        if self._alone or self._pool.n_workers == 1 or not self._few_left():
            return False
        if any(job.stage in _SIDE_STAGES for job in pair.todo):
            return side_seconds(self._n_raw[pair.task.pair.pair_id]) > _WORTH_SPLITTING_S
        n_keep = _n_keep(pair.task)
        return n_keep is None or sum(object_seconds(n) for _, n in n_keep) > _WORTH_SPLITTING_S

    def _few_left(self) -> bool:
        return len(self._pending) + len(self._active) <= _FEW_PAIRS_A_WORKER * self._pool.n_workers

    def _submit_objects(self, pair: _Active) -> None:
        """Selection and scores of a pair's objects: large ones alone, small ones together, largest first."""
        sizes = sorted(_n_keep(pair.task) or [], key=lambda of: (-of[1], of[0]))
        first = (
            1000.0 * object_seconds(sizes[0][1]) if sizes else 0.0
        )  # one pair after the other: workers keep its tables
        parts = []
        batch: list[int] = []
        seconds = 0.0
        for i, (real_id, n) in enumerate(sizes):
            batch.append(real_id)
            seconds += object_seconds(n)
            if seconds >= _BATCH_S or i + 1 == len(sizes):
                parts.append(self._submit(pair, score_objects, tuple(batch), priority=first + seconds, keep=True))
                batch, seconds = [], 0.0
        self._submit(pair, gather_objects, parts, priority=_FIRST)

    def _submit(
        self, pair: _Active, function: Callable[..., Report | ObjectScores | Failure], *args: Any, **options: Any
    ) -> Handle:
        handle = self._pool.submit(function, pair.task, *args, **options)
        pair.waiting.add(handle)
        self._pair_of[handle] = pair
        return handle


def _names(jobs: Iterable[Job]) -> tuple[tuple[str, str], ...]:
    return tuple((job.stage, job.side) for job in jobs)


def _n_keep(task: PairTask) -> list[tuple[int, int]] | None:
    """Real id and nodes of each matched object, where the matching is done."""
    job = next(job for job in task.jobs if job.stage == "matching")
    return [(real_id, n) for real_id, n in job.facts["n_keep"]] if job.stored else None
