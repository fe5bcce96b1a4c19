"""The pool of tasks within this process, which is also the interface of others.

A pool takes a function and its arguments and returns the outcomes in any order.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import Any

SHARE_OF_MEMORY = 0.8
Handle = Any  #: what names a submitted task; can be hashed


@dataclass(frozen=True)
class WorkerDied:
    """Outcome of a task that the pool has given up, because worker processes died each time it ran."""

    detail: str


@dataclass(frozen=True)
class Memory:
    """Bytes that tasks may occupy: all that run at the same time together, and a single one."""

    together: int
    alone: int


class Pool:
    """A pool that runs each task in this process when its outcome is requested; `DaskPool` runs them elsewhere."""

    def __init__(self, memory: int | None = None) -> None:
        self._memory = memory
        self._waiting: deque[tuple[Handle, Callable[..., Any], tuple[Any, ...]]] = deque()

    @property
    def n_workers(self) -> int:
        """Number of tasks that run at the same time."""
        return 1

    @property
    def memory(self) -> Memory:
        """Memory that the tasks may occupy."""
        memory = self._memory or machine_memory()
        return Memory(memory, memory)

    def submit(self, function: Callable[..., Any], *args: Any) -> Handle:
        """Start a task, after those that were submitted before."""
        handle = object()
        self._waiting.append((handle, function, args))
        return handle

    def next_done(self) -> tuple[Handle, Any]:
        """Wait for a task to end: its result, or `WorkerDied`."""
        handle, function, args = self._waiting.popleft()
        with one_blas_thread():
            return handle, function(*args)

    def close(self) -> None:
        """End the pool, even if tasks are running."""


def one_blas_thread() -> AbstractContextManager[object]:
    """Limit numeric libraries to one thread until the context ends: more are slower, and sums differ."""
    import scipy.linalg  # noqa: F401  (brings the libraries whose threads are to be limited)
    from threadpoolctl import threadpool_limits

    return threadpool_limits(1)


def machine_memory() -> int:
    """Bytes that a run may occupy by default: four fifths of the memory, or of this process's limit."""
    from distributed.system import MEMORY_LIMIT

    return int(SHARE_OF_MEMORY * MEMORY_LIMIT)
