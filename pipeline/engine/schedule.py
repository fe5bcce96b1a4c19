"""The order of work: which tasks of which pairs are submitted when, and what is done when one ends.

Pairs are started through a bounded window. A pair is one task, and several small ones are one together; only when few
pairs are left for the workers does a pair fall into tasks by side and, largest first, by object. A pair whose worker
died is tried once more with nothing beside it, so that only the guilty one fails. Leaves to others: what fits
into the memory (`admission`), where tasks run (`fanout`), what they cost (`costs`), what is kept (`session`).
"""

from __future__ import annotations

import heapq
import itertools
from collections import deque
from collections.abc import Callable, Iterable, Mapping
from typing import Any

from .costs import largest_object, object_bytes, object_seconds, side_seconds
from .memory import Active, Order, Room, matched_nodes
from .pool import Handle, Pool, WorkerDied
from .runner import OBJECT_STAGES, gather_objects, run_jobs, run_pairs, score_objects
from .task import Failure, Job, PairTask, Report

_SIDE_STAGES = ("ground", "graph", "communities")
_PAIRS_A_WORKER = 2
_FEW_PAIRS_A_WORKER = 2
_FIRST = 1e6  # priority of what others wait for
_WORTH_SPLITTING_S = 1.0
_BATCH_S = 0.5
_BUNDLE_S = 0.5
_LEAST_WEIGHT = 1 / 16


class Schedule:
    """Works off the jobs of many pairs.

    Parameters
    ----------
    pool : where tasks run
    tasks : the pairs, each with jobs to be made; taken one by one as they are begun
    n_raw : points of both files, by pair_id; of just these pairs
    on_report : called with what each task has finished, as soon as it has
    on_objects : called with pair_id and numbers of nodes of objects that are scored
    on_end : called with pair_id and failure (or None) when a pair has ended
    """

    def __init__(
        self,
        pool: Pool,
        tasks: Iterable[PairTask],
        n_raw: Mapping[str, int],
        on_report: Callable[[Report], None],
        on_objects: Callable[[str, tuple[int, ...]], None],
        on_end: Callable[[str, Failure | None], None],
    ) -> None:
        self._pool = pool
        self._pending = iter(tasks)
        self._n_pending = len(n_raw)
        self._n_raw = n_raw
        self._room = Room(pool, n_raw)
        self._on_report = on_report
        self._on_objects = on_objects
        self._on_end = on_end
        self._active: dict[str, Active] = {}
        self._waiting: list[tuple[float, int, Order]] = []
        self._running: dict[Handle, Order] = {}
        self._count = itertools.count()
        self._bundle: list[Active] = []
        self._quarantine: deque[Active] = deque()
        self._alone = False

    def run(self) -> None:
        """Works until every pair has ended."""
        self._fill()
        while self._running:
            handle, outcome = self._pool.next_done()
            order = self._running.pop(handle)
            outcomes = outcome if isinstance(outcome, list) else [outcome] * len(order.pairs)
            for pair, of_pair in zip(order.pairs, outcomes, strict=True):
                pair.n_waiting -= 1
                self._take(pair, of_pair, order.objects)
                if not pair.n_waiting:
                    self._go_on(pair)
            self._fill()
        if n_left := self._n_pending + len(self._active) + len(self._quarantine):
            raise RuntimeError(f"{n_left} pairs were left over though nothing ran any more")

    def _fill(self) -> None:
        if self._alone:
            self._admit()
            return
        window = (_FEW_PAIRS_A_WORKER if self._few_left() else _PAIRS_A_WORKER) * self._pool.n_workers
        while self._n_pending and sum(map(self._weight, self._active.values())) < window:
            self._n_pending -= 1
            pair = Active(next(self._pending))
            self._active[pair.task.pair.pair_id] = pair
            self._go_on(pair)
        if not self._n_pending:
            self._submit_bundle()
        self._admit()
        if self._quarantine and not self._active:
            self._alone = True
            pair = self._quarantine.popleft()
            self._active[pair.task.pair.pair_id] = pair
            self._submit_whole(pair)
            self._submit_bundle()
            self._admit()

    def _take(self, pair: Active, outcome: Any, objects: tuple[int, ...]) -> None:
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
        else:
            self._on_objects(pair.task.pair.pair_id, objects)

    def _go_on(self, pair: Active) -> None:
        """Submits what comes next for a pair of which nothing is running."""
        pair.failure = pair.failure or self._room.too_large(pair)
        if pair.failure or not pair.todo:
            self._end(pair)
        elif pair.suspect and not self._alone:
            pair.scored.clear()
            del self._active[pair.task.pair.pair_id]
            self._quarantine.append(pair)
        elif pair.scored:
            self._submit(Order((pair,), gather_objects, (list(pair.scored),), priority=_FIRST))
            pair.scored.clear()
        elif not self._is_worth_splitting(pair):
            self._submit_whole(pair)
        elif sides := [job for job in pair.todo if job.stage in _SIDE_STAGES]:
            split = not pair.task.settings.ground.shared
            for side in ("real", "sim") if split else ("",):
                if own := [job for job in sides if not split or job.side == side]:
                    self._submit(Order((pair,), run_jobs, (_names(own),), _FIRST, self._room.pair_bytes(pair)))
        elif matching := [job for job in pair.todo if job.stage == "matching"]:
            self._submit(Order((pair,), run_jobs, (_names(matching),), priority=_FIRST))
        elif any(job.stage in OBJECT_STAGES for job in pair.todo):
            self._submit_objects(pair)
        else:
            need = self._room.pair_bytes(pair) + object_bytes(largest_object(matched_nodes(pair.task) or [])[1])
            for job in pair.todo:
                self._submit(Order((pair,), run_jobs, (_names([job]),), need=need))

    def _end(self, pair: Active) -> None:
        self._alone = False
        del self._active[pair.task.pair.pair_id]
        self._on_end(pair.task.pair.pair_id, pair.failure)

    def _is_worth_splitting(self, pair: Active) -> bool:
        n_keep = matched_nodes(pair.task)
        has_objects = any(job.stage in OBJECT_STAGES for job in pair.todo)
        if n_keep and has_objects and object_bytes(largest_object(n_keep)[1]) > self._room.object_share(pair):
            return True  # its objects are admitted one by one
        if self._alone or self._pool.n_workers == 1 or not self._few_left():
            return False
        if any(job.stage in _SIDE_STAGES for job in pair.todo):
            return side_seconds(self._n_raw[pair.task.pair.pair_id]) > _WORTH_SPLITTING_S
        return n_keep is None or sum(object_seconds(n) for _, n in n_keep) > _WORTH_SPLITTING_S

    def _few_left(self) -> bool:
        return self._n_pending + len(self._active) <= _FEW_PAIRS_A_WORKER * self._pool.n_workers

    def _submit_whole(self, pair: Active) -> None:
        """All that is left of a pair in one piece; small pairs wait for others to go with them."""
        self._bundle.append(pair)
        pair.n_waiting += 1
        if sum(map(self._weight, self._bundle)) >= 1 or self._alone:
            self._submit_bundle()

    def _submit_bundle(self) -> None:
        """The pairs that wait for company, as one task; each stops where an object needs more than a worker's share."""
        if not self._bundle:
            return
        pairs, self._bundle = tuple(self._bundle), []
        parts = [(pair.task, _names(pair.todo), self._room.object_share(pair)) for pair in pairs]
        need = max(self._room.pair_bytes(pair) + share for pair, (_, _, share) in zip(pairs, parts, strict=True))
        self._queue(Order(pairs, run_pairs, (parts,), need=need))

    def _weight(self, pair: Active) -> float:
        """The part of a task that a pair is worth."""
        seconds = 2 * side_seconds(self._n_raw[pair.task.pair.pair_id] // 2)
        return min(1.0, max(_LEAST_WEIGHT, seconds / _BUNDLE_S))

    def _submit_objects(self, pair: Active) -> None:
        """Selection and scores of a pair's objects: large ones alone, small ones together, largest first.

        Pairs go one after the other, that of the largest object first: workers keep the tables of the last ones.
        """
        sizes = sorted(matched_nodes(pair.task) or [], key=lambda of: (-of[1], of[0]))
        first = 1000.0 * object_seconds(sizes[0][1]) if sizes else 0.0
        batch: list[tuple[int, int]] = []
        for i, (real_id, n) in enumerate(sizes):
            batch.append((real_id, n))
            seconds = sum(object_seconds(of) for _, of in batch)
            if seconds >= _BATCH_S or i + 1 == len(sizes):
                need = self._room.pair_bytes(pair) + object_bytes(batch[0][1])
                ids, nodes = tuple(of for of, _ in batch), tuple(of for _, of in batch)
                self._submit(Order((pair,), score_objects, (ids,), first + seconds, need, nodes))
                batch = []
        if not sizes:
            self._submit(Order((pair,), gather_objects, ([],), priority=_FIRST))

    def _submit(self, order: Order) -> None:
        """Queues a task of one pair for `_admit`."""
        order.pairs[0].n_waiting += 1
        self._queue(order)

    def _queue(self, order: Order) -> None:
        heapq.heappush(self._waiting, (-order.priority, next(self._count), order))

    def _admit(self) -> None:
        """Hands tasks to the pool, first come first, as long as those that may run at once fit into the memory."""
        while self._waiting:
            order = self._waiting[0][2]
            if not self._room.admits(order, self._running.values()):
                return
            heapq.heappop(self._waiting)
            keep = order.function is score_objects
            first = () if order.function is run_pairs else (order.pairs[0].task,)
            handle = self._pool.submit(order.function, *first, *order.arguments, priority=order.priority, keep=keep)
            self._running[handle] = order
            if keep:
                order.pairs[0].scored.append(handle)


def _names(jobs: Iterable[Job]) -> tuple[tuple[str, str], ...]:
    return tuple((job.stage, job.side) for job in jobs)
