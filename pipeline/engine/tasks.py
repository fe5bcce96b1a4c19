"""Plain tasks: a function called with each of many arguments, on one or several processes."""

from __future__ import annotations

import traceback
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TypeVar

from ...schemas.errors import DiskFullError, FidpipeError
from .cluster import start_pool
from .pool import WorkerDied
from .progress import Reporter

_TRIES = 3
Task = TypeVar("Task")


def map_tasks(
    function: Callable[[Task], object], tasks: Mapping[str, Task], reporter: Reporter, *, n_workers: int = 1
) -> dict[str, str]:
    """Call a function with each task; Ctrl-C ends all of them.

    Parameters
    ----------
    function : of a module; what it returns is dropped
    tasks : by name
    reporter : shows progress, and each failure
    n_workers : processes; 1 for this one

    Returns
    -------
    Why some tasks failed, by name.

    Raises
    ------
    DiskFullError
        No space is left.
    """
    if not tasks:
        return {}
    failures: dict[str, str] = {}
    deaths: Counter[str] = Counter()
    pool = start_pool(n_workers, None, None, Path(), {}, [function.__module__])
    reporter.start(len(tasks), len(tasks))
    try:
        running = {pool.submit(_reason_of_failure, function, task): name for name, task in tasks.items()}
        while running:
            handle, reason = pool.next_done()
            name = running.pop(handle)
            if isinstance(reason, WorkerDied):
                deaths[name] += 1
                if deaths[name] < _TRIES:
                    running[pool.submit(_reason_of_failure, function, tasks[name])] = name
                    continue
                reason = f"its worker process died {_TRIES} times ({reason.detail})"
            if reason:
                failures[name] = reason
                reporter.fail(f"pair {name}", reason)
            reporter.advance(1, 1)
    finally:
        reporter.stop()
        pool.close(now=True)
    return failures


@contextmanager
def counting(reporter: Reporter) -> Iterator[Callable[[int, int], None]]:
    """A function that shows how many pairs are done, of how many."""

    def pair_done(n_done: int, n_pairs: int) -> None:
        if n_done == 1:
            reporter.start(n_pairs, n_pairs)
        reporter.advance(1, 1)

    try:
        yield pair_done
    finally:
        reporter.stop()


def _reason_of_failure(function: Callable[[Task], object], task: Task) -> str:
    """Call a function; gives why it failed, or ""."""
    try:
        function(task)
    except DiskFullError:
        raise
    except FidpipeError as error:
        return str(error)
    except Exception as error:  # one broken task does not stop the others
        return f"internal error: {type(error).__name__}: {error}\n{traceback.format_exc()}"
    return ""
