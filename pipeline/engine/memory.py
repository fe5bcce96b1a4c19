"""The memory budget: batches that may run at the same time, and pairs that do not fit."""

from __future__ import annotations

import heapq
from collections.abc import Iterable

from .costs import CostModel, largest_object
from .plan import PairPlan
from .pool import Pool


class MemoryBudget:
    """The memory that batches share.

    Parameters
    ----------
    pool : where they run
    costs : what they may need
    """

    def __init__(self, pool: Pool, costs: CostModel) -> None:
        self._pool, self._costs = pool, costs

    @property
    def usable(self) -> int:
        """Bytes available to batches, of all workers together."""
        return max(0, self._pool.memory.together - self._costs.process_bytes * self._pool.n_workers)

    def admits(self, need: int, running: Iterable[int]) -> bool:
        """True if a batch fits next to those that run; a pool accepts more batches than run at once."""
        others = list(running)
        return not others or sum(heapq.nlargest(self._pool.n_workers, [need, *others])) <= self.usable

    def object_share(self, plan: PairPlan) -> int:
        """Bytes that an object may need for its pair to run as one batch."""
        return max(0, self.usable // self._pool.n_workers - self._costs.pair_bytes(plan.n_raw))

    def why_too_large(self, plan: PairPlan) -> str | None:
        """Reason why the rest of a pair does not fit into the memory even if nothing else runs; None if it fits."""
        own = self._costs.pair_bytes(plan.n_raw)
        number, n_keep = largest_object(plan.objects or [])
        usable = max(0, self._pool.memory.alone - self._costs.process_bytes)
        need = own + self._costs.object_bytes(n_keep)
        if need <= usable:
            return None
        what = f"object {number} of {n_keep} aligned nodes" if n_keep else f"{plan.n_raw} points"
        lower = "a smaller graph.k makes smaller objects, " if n_keep else ""
        return (
            f"{what}: {_gib(need)} of memory may be needed at once, {_gib(usable)} are available "
            f"(machine.memory_gib minus {_gib(self._costs.process_bytes)} for the worker process); {lower}"
            "input.include_box or input.max_range_m fewer points"
        )


def _gib(n_bytes: int) -> str:
    return f"{n_bytes / 2**30:.2g} GiB"
