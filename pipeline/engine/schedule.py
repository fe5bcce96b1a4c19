"""The order of work: when the jobs of each pair are submitted, and the next step when a batch ends.

Pairs are begun through a bounded window. The jobs of a pair are one batch, and several small pairs
are one together; only when few pairs are left for the workers does a pair fall into batches by side
and, largest first, by object. If the workers of a batch die, its pairs are tried again, job by job
with nothing else running, so that only the job that causes it fails.
"""

from __future__ import annotations

import heapq
from collections import deque
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from shutil import rmtree
from typing import Any

from ...schemas.columns import SIDES
from ..stage import Grain
from ..storage.folder import RunFolder
from ..storage.table_files import JobRecord
from . import costs
from .plan import Job, JobFailure, PairPlan
from .pool import Handle, Pool, WorkerDied
from .progress import Reporter
from .time_limit import NOTES
from .worker import BatchResult, ObjectRows, PairBatch, job_title, run_batch

# How work is cut into batches; no result depends on it.
#: Pairs of each worker that are begun; once no more than these are left, pairs fall into smaller batches.
PAIRS_PER_WORKER = 2
WORTH_SPLITTING_S = 1.0  #: if they cost more than this
BATCH_S = 0.5  #: seconds of objects per batch
BUNDLE_S = 0.5  #: seconds of small pairs per batch
LONG_PAIR = 200_000  #: points of pairs that are done job by job, so that progress shows
LEAST_WEIGHT = 1 / 16  #: share of a batch that a pair has at least
_TASKS_PER_WORKER = 2  # submitted at the same time, so that none waits for the next


class Collector:
    """Collects what comes of the jobs of one folder: results in the ledger, failures by pair, progress.

    Parameters
    ----------
    folder : of the run, locked
    reporter : shows progress

    Attributes
    ----------
    failures : reasons by pair_id
    n_made : jobs that were done
    """

    def __init__(self, folder: RunFolder, reporter: Reporter) -> None:
        self.folder = folder
        self.reporter = reporter
        self.failures: dict[str, str] = {}
        self.n_made = 0
        self._traces: set[str] = set()

    def fail(self, pair_id: str, key: str, reason: str) -> None:
        """Record and report the failure of a pair.

        Parameters
        ----------
        key : of the job that failed; "" if the input cannot be used
        """
        self.failures[pair_id] = reason
        self.folder.ledger.put_failure(pair_id, key, reason)
        self.reporter.fail(f"pair {pair_id}", reason)

    def jobs_done(self, pair_id: str, records: Sequence[JobRecord]) -> None:
        """Add finished jobs of a pair to the ledger."""
        if records:
            self.folder.ledger.put_jobs(pair_id, records)
        self.n_made += len(records)
        self.reporter.advance(len(records))

    def pair_done(self, plan: PairPlan) -> None:
        """Report the failures of a pair that has ended.

        The ledger keeps the reason of a failed pair; all results of a pair without scores are
        removed.
        """
        order = list(plan.jobs)
        failures = sorted(plan.failures, key=lambda failure: order.index(failure.job))
        self.reporter.advance(len(plan.jobs) - len(plan.records), 1)
        required = [
            failure for failure in failures if not plan.jobs[failure.job].stage.is_extra
        ]
        if required:
            for record in self.folder.forget(plan.pair_id):
                self.n_made -= record.made_by == self.folder.token
        # which of the others were begun depends on the number of workers
        reported = required[:1] or failures
        if reported:
            reasons = [f"{job_title(*failure.job)}: {failure.reason}" for failure in reported]
            self.fail(plan.pair_id, plan.keys[reported[0].job], "; ".join(reasons))
        for failure in failures:
            if failure.trace and failure.trace not in self._traces:
                self._traces.add(failure.trace)
                self.reporter.say(failure.trace)


@dataclass
class _Pair:
    """A pair that is being worked on.

    is_lost : True if the pool has given up a batch of it
    n_waiting : batches of it that are queued or run
    scored : rows of its batches of objects
    n_scored : objects in them that are done
    """

    plan: PairPlan
    is_lost: bool = False
    n_waiting: int = 0
    scored: list[ObjectRows] = field(default_factory=list)
    n_scored: int = 0

    def chain(self, grain: Grain, part: str = "") -> list[Job]:
        """Its jobs of a grain and part that can be done one after the other without waiting for any other job."""
        done = set(self.plan.records)
        chain = []
        for job in self.plan.todo:
            if (job.stage.grain, job.part) == (grain, part) and done.issuperset(job.needs):
                chain.append(job)
                done.add(job.name)
        return chain

    def batch(self, jobs: Iterable[Job], most_bytes: int, **options: Any) -> PairBatch:
        """Some of its jobs as a batch."""
        return PairBatch(self.plan, tuple(job.name for job in jobs), most_bytes, **options)


#: Batches that wait for memory, or run, together: at most one of each pair.
_Task = list[tuple[_Pair, PairBatch]]


class Schedule:
    """Order of the jobs of many pairs.

    Parameters
    ----------
    pool : where batches run
    plans : of the pairs, each with jobs to be made; taken one by one as they are begun
    n_pairs, n_jobs : number of the pairs, and of their jobs
    collector : receives the results while the work proceeds
    """

    def __init__(
        self,
        pool: Pool,
        plans: Iterable[PairPlan],
        n_pairs: int,
        n_jobs: int,
        collector: Collector,
    ) -> None:
        self.pool = pool
        self._collector = collector
        self._pending = iter(plans)
        self._n_pending = n_pairs
        self._n_jobs = n_jobs
        self._active: dict[str, _Pair] = {}
        self._waiting: deque[_Task] = deque()
        self._running: dict[Handle, _Task] = {}
        self._bundle: list[_Pair] = []
        self._quarantine: deque[_Pair] = deque()
        self._is_alone = False

    def run(self) -> None:
        """Work until every pair has ended, and show progress."""
        if not self._n_pending:
            return
        folder, reporter = self._collector.folder, self._collector.reporter
        notes = folder.folder / NOTES
        rmtree(notes, ignore_errors=True)  # of an earlier run
        reporter.start(self._n_pending, self._n_jobs)
        try:
            self._fill()
            while self._running:
                handle, outcome = self.pool.next_done()
                task = self._running.pop(handle)
                is_lost = isinstance(outcome, WorkerDied)
                results = [outcome] * len(task) if is_lost else outcome
                for (pair, batch), result in zip(task, results, strict=True):
                    pair.n_waiting -= 1
                    self._take(pair, batch, result)
                    if not pair.n_waiting:
                        self._go_on(pair)
                self._fill()
        finally:
            reporter.stop()
            rmtree(notes, ignore_errors=True)
        if n_left := self._n_pending + len(self._active) + len(self._quarantine):
            raise RuntimeError(f"{n_left} pairs were left over though nothing ran any more")
        folder.remove_strays()  # of workers that died: complete and incomplete files

    def _fill(self) -> None:
        """Begin pairs while the window has room, and submit batches that fit into the memory."""
        if not self._is_alone:
            while (
                self._n_pending
                and sum(map(self._weight, self._active.values())) < self._window()
            ):
                self._n_pending -= 1
                self._begin(_Pair(next(self._pending)))
            if not self._n_pending:
                self._submit_bundle()
        self._admit()
        if self._quarantine and not self._active:
            self._is_alone = True
            self._begin(self._quarantine.popleft())
            self._admit()

    def _window(self) -> int:
        """Number of pairs that may be worked on at the same time."""
        return PAIRS_PER_WORKER * self.pool.n_workers

    def _begin(self, pair: _Pair) -> None:
        self._active[pair.plan.pair_id] = pair
        self._go_on(pair)

    def _take(self, pair: _Pair, batch: PairBatch, result: BatchResult | WorkerDied) -> None:
        if isinstance(result, WorkerDied):
            pair.is_lost = True
            if self._is_alone:
                again = "the worker process died, and again when the pair ran alone (out of memory?)"
                failure = JobFailure(pair.plan.ready[0].name, f"{again}: {result.detail}")
                pair.plan = pair.plan.after(failures=[failure])
            return
        pair.plan = pair.plan.after(result.records, result.failures)
        if not batch.objects:
            self._collector.jobs_done(pair.plan.pair_id, result.records)
            return
        pair.scored.append(result.scored)
        pair.n_scored += len(batch.objects)
        n_objects = len(pair.plan.objects or [])
        objects = f"; {pair.plan.pair_id}: {pair.n_scored} of {n_objects} objects"
        self._collector.reporter.advance(0, objects=objects)

    def _go_on(self, pair: _Pair) -> None:
        """Submit the next batches of a pair of which nothing is running."""
        reason = self._why_too_large(pair.plan)
        readers = [job for job in pair.plan.ready if job.scan_sides]
        if reason and not readers:
            failures = [JobFailure(job.name, reason) for job in pair.plan.todo]
            pair.plan = pair.plan.after(failures=failures)
        if not pair.plan.todo:
            self._is_alone = False
            del self._active[pair.plan.pair_id]
            self._collector.pair_done(pair.plan)
        elif self._is_alone:
            self._submit_jobs(pair, pair.plan.ready[:1])
        elif pair.is_lost:
            del self._active[pair.plan.pair_id]
            self._quarantine.append(pair)
        elif reason:
            # the input files may have fewer points than estimated
            self._submit_jobs(pair, readers)
        elif pair.scored:
            rows = tuple(pair.scored)
            pair.scored.clear()
            self._submit_jobs(pair, pair.chain(Grain.OBJECT), rows)
        elif self._is_worth_splitting(pair):
            self._split(pair)
        elif pair.plan.limit is not None or any(job.stage.is_long for job in pair.plan.todo):
            # one that may end its worker, or be interrupted, takes no other pair along
            self._submit_together([pair])
        else:
            self._bundle.append(pair)
            if sum(map(self._weight, self._bundle)) >= 1:
                self._submit_bundle()

    def _is_worth_splitting(self, pair: _Pair) -> bool:
        plan = pair.plan
        largest = costs.object_bytes(plan.largest_object[1])
        has_objects = any(job.stage.grain is Grain.OBJECT for job in pair.plan.todo)
        if has_objects and largest > self._object_share(plan):
            return True  # its objects are admitted one by one
        if self.pool.n_workers == 1:
            return plan.n_points > LONG_PAIR
        is_large = costs.side_seconds(plan.n_points) > WORTH_SPLITTING_S
        return is_large and self._n_pending + len(self._active) <= self._window()

    def _split(self, pair: _Pair) -> None:
        """The next layer of a pair in batches that run at the same time: by side, by object, or by job."""
        sides = [chain for side in SIDES if (chain := pair.chain(Grain.SIDE, side))]
        if sides:
            for chain in sides:
                is_long = pair.plan.n_points > LONG_PAIR
                self._submit_jobs(pair, chain[:1] if is_long else chain)
        elif pair.plan.ready[0].stage.grain is Grain.OBJECT:
            self._submit_objects(pair)
        else:
            for job in pair.plan.ready:
                if job.stage.grain is Grain.PAIR:
                    self._submit_jobs(pair, [job])

    def _submit_jobs(
        self, pair: _Pair, jobs: list[Job], rows: tuple[ObjectRows, ...] = ()
    ) -> None:
        """Some jobs of a pair as one batch."""
        with_objects = any(job.stage.grain is not Grain.SIDE for job in jobs)
        need = pair.plan.bytes_needed(with_objects=with_objects)
        self._submit([(pair, pair.batch(jobs, need, rows=rows))])

    def _submit_bundle(self) -> None:
        """The pairs that wait for company, as one task."""
        if self._bundle:
            pairs = self._bundle
            self._bundle = []
            self._submit_together(pairs)

    def _submit_together(self, pairs: list[_Pair]) -> None:
        """All that is left of some pairs as one task; each stops before a job that may need more than its share."""
        task = []
        for pair in pairs:
            need = costs.pair_bytes(pair.plan.n_points) + self._object_share(pair.plan)
            task.append((pair, pair.batch(pair.plan.todo, need)))
        self._submit(task)

    def _weight(self, pair: _Pair) -> float:
        """The part of a batch that a pair is worth."""
        seconds = 2 * costs.side_seconds(pair.plan.n_points // 2)
        return min(1.0, max(LEAST_WEIGHT, seconds / BUNDLE_S))

    def _submit_objects(self, pair: _Pair) -> None:
        """The stages over a pair's objects: large objects alone, small ones together, largest first."""
        chain = pair.chain(Grain.OBJECT)
        if not pair.plan.objects:
            self._submit_jobs(pair, chain)
            return
        batches: list[list[tuple[int, int]]] = []
        left_s = 0.0
        for number, n_keep in sorted(
            pair.plan.objects, key=lambda entry: (-entry[1], entry[0])
        ):
            if left_s <= 0:
                batches.append([])
                left_s = BATCH_S
            batches[-1].append((number, n_keep))
            left_s -= costs.object_seconds(n_keep)
        for sizes in batches:
            need = costs.pair_bytes(pair.plan.n_points) + costs.object_bytes(sizes[0][1])
            objects = tuple(number for number, _ in sizes)
            self._submit([(pair, pair.batch(chain, need, objects=objects))])

    def _submit(self, task: _Task) -> None:
        """Queue a task for `_admit`."""
        for pair, _ in task:
            pair.n_waiting += 1
        self._waiting.append(task)

    def _admit(self) -> None:
        """Submit queued tasks in their order, as long as those that may run at once fit into the memory."""
        n_workers = self.pool.n_workers
        while self._waiting and len(self._running) < _TASKS_PER_WORKER * n_workers:
            task = self._waiting[0]
            needs = [_most_bytes(queued) for queued in (task, *self._running.values())]
            if self._running and sum(heapq.nlargest(n_workers, needs)) > self._usable():
                return
            self._waiting.popleft()
            batches = [batch for _, batch in task]
            self._running[self.pool.submit(run_batch, batches)] = task

    def _usable(self) -> int:
        """Bytes available to batches, of all workers together."""
        return max(0, self.pool.memory.together - costs.PROCESS_BYTES * self.pool.n_workers)

    def _object_share(self, plan: PairPlan) -> int:
        """Bytes that an object may need for its pair to run as one batch."""
        return max(0, self._usable() // self.pool.n_workers - costs.pair_bytes(plan.n_points))

    def _why_too_large(self, plan: PairPlan) -> str | None:
        """Reason why the rest of a pair does not fit into the memory even if nothing else runs; None if it fits."""
        usable = max(0, self.pool.memory.alone - costs.PROCESS_BYTES)
        need = plan.bytes_needed(with_objects=True)
        if need <= usable:
            return None
        number, n_keep = plan.largest_object
        what = (
            f"object {number} of {n_keep} aligned nodes"
            if n_keep
            else f"{plan.n_points} points"
        )
        return (
            f"{what}: {_gib(need)} of memory may be needed at once, {_gib(usable)} are available "
            f"(machine.memory_gib minus {_gib(costs.PROCESS_BYTES)} for the worker process); a smaller graph.k "
            "makes smaller objects, input.voxel_m, input.include_box or input.max_range_m fewer points"
        )


def _most_bytes(task: _Task) -> int:
    return max(batch.most_bytes for _, batch in task)


def _gib(n_bytes: int) -> str:
    return f"{n_bytes / 2**30:.2g} GiB"
