"""Which tasks may run at once: what each may occupy of the memory, and what cannot fit at all.

Leaves to others: what a pair or an object needs (`costs`), the order of tasks (`schedule`).
"""

from __future__ import annotations

import heapq
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

from .costs import PROCESS_BYTES, largest_object, object_bytes, pair_bytes
from .pool import Handle, Pool
from .task import Failure, Job, ObjectScores, PairTask, Report


@dataclass
class Active:
    """A pair that is being worked on."""

    task: PairTask
    failure: Failure | None = None
    suspect: bool = False
    n_waiting: int = 0
    scored: list[Handle] = field(default_factory=list)

    @property
    def todo(self) -> list[Job]:
        """Its jobs that are not done."""
        return [job for job in self.task.jobs if not job.stored]


@dataclass(frozen=True)
class Order:
    """A task that waits for memory, or runs.

    pairs : whose task it is; several only of `run_pairs`
    need : bytes that it may occupy
    objects : for a batch of objects, their nodes; the scores stay where they are made
    """

    pairs: tuple[Active, ...]
    function: Callable[..., Report | list[Report] | ObjectScores | Failure]
    arguments: tuple[Any, ...]
    priority: float = 0.0
    need: int = 0
    objects: tuple[int, ...] = ()


class Room:
    """The memory that tasks share.

    Parameters
    ----------
    pool : where tasks run
    n_raw : points of both files, by pair_id
    """

    def __init__(self, pool: Pool, n_raw: Mapping[str, int]) -> None:
        self._pool = pool
        self._n_raw = n_raw
        self._memory = pool.memory

    @property
    def usable(self) -> int:
        """Bytes for what tasks make, of all workers together."""
        return max(0, self._memory.together - PROCESS_BYTES * self._pool.n_workers)

    def admits(self, order: Order, running: Iterable[Order]) -> bool:
        """Whether a task fits beside those that run; a pool takes more tasks than run at once."""
        beside = [of.need for of in running]
        return not beside or sum(heapq.nlargest(self._pool.n_workers, [order.need, *beside])) <= self.usable

    def pair_bytes(self, pair: Active) -> int:
        """What the tables of a pair occupy."""
        return pair_bytes(self._n_raw[pair.task.pair.pair_id])

    def object_share(self, pair: Active) -> int:
        """Bytes that an object may need for its pair to run as one task."""
        return max(0, self.usable // self._pool.n_workers - self.pair_bytes(pair))

    def too_large(self, pair: Active) -> Failure | None:
        """The failure of a pair that does not fit into the memory even when nothing runs beside it."""
        own = self.pair_bytes(pair)
        real_id, n = largest_object(matched_nodes(pair.task) or [])
        usable = max(0, self._memory.alone - PROCESS_BYTES)
        if not pair.todo or own + object_bytes(n) <= usable:
            return None
        what = f"object {real_id} of {n} aligned nodes" if n else f"{self._n_raw[pair.task.pair.pair_id]} points"
        lower = "a smaller graph.k makes smaller objects, " if n else ""
        job = pair.todo[0]
        reason = (
            f"{what}: {_gib(own + object_bytes(n))} of memory may be needed at once, {_gib(usable)} are there for "
            f"it (machine.memory_gib, less {_gib(PROCESS_BYTES)} for the worker process); {lower}input.include_box or "
            "input.max_range_m fewer points"
        )
        return Failure(job.stage, job.side, reason)


def matched_nodes(task: PairTask) -> list[tuple[int, int]] | None:
    """Real id and nodes of each matched object, where the matching is done."""
    job = next(job for job in task.jobs if job.stage == "matching")
    return [(real_id, n) for real_id, n in job.facts["n_keep"]] if job.stored else None


def _gib(n_bytes: int) -> str:
    return f"{n_bytes / 2**30:.2g} GiB"
