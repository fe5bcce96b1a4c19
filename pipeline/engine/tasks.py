"""Plain tasks: a function called with each of many arguments, on one or several processes."""

from __future__ import annotations

import traceback
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import TypeVar, cast

from ...schemas.errors import DiskFullError, FidpipeError
from ..storage.scratch import temporary_space
from .cluster import start_pool
from .pool import Pool, WorkerDied
from .progress import Reporter

_DIED = "the worker process died, and again when the pair ran alone (a crash of a reader, or out of memory?)"
Task = TypeVar("Task")
Result = TypeVar("Result")


def map_tasks(
    function: Callable[[Task], Result],
    tasks: Mapping[str, Task],
    reporter: Reporter,
    *,
    n_workers: int | None = 1,
    memory_gib: float | None = None,
    may_end_workers: bool = False,
    keep: Callable[[Result], object] = lambda _: None,
) -> tuple[dict[str, Result], dict[str, str]]:
    """Call a function with each task; Ctrl-C ends all of them.

    Parameters
    ----------
    function : of a module
    tasks : by name
    reporter : shows progress, and each failure
    n_workers : processes; None for one per core; 1 for this one, unless a task may end it
    memory_gib : memory of all processes together; None for four fifths of the machine's
    may_end_workers : whether a task may end the process that it is in
    keep : called with each result as soon as there is one

    Returns
    -------
    Results, and reasons why other tasks failed, by name.

    Raises
    ------
    DiskFullError
        No space is left.
    """
    results: dict[str, Result] = {}
    failures: dict[str, str] = {}
    if not tasks:
        return results, failures
    if len(tasks) == 1:
        n_workers = 1
    modules = [function.__module__]
    pool = start_pool(n_workers, memory_gib, modules, may_end_workers=may_end_workers)
    reporter.start(len(tasks), len(tasks))
    try:
        for name, result, reason in _outcomes(pool, function, tasks):
            if reason:
                failures[name] = reason
                reporter.fail(f"pair {name}", reason)
            else:
                results[name] = cast(Result, result)
                keep(results[name])
            reporter.advance(1, 1)
    finally:
        reporter.stop()
        pool.close()
    return results, failures


def _outcomes(
    pool: Pool, function: Callable[[Task], Result], tasks: Mapping[str, Task]
) -> Iterator[tuple[str, Result | None, str]]:
    """Name, result and reason of failure of each task; one whose worker died is tried again alone."""
    running = {pool.submit(_call, function, task): name for name, task in tasks.items()}
    lost = []
    while running:
        handle, outcome = pool.next_done()
        name = running.pop(handle)
        if isinstance(outcome, WorkerDied):
            lost.append(name)
        else:
            yield name, *outcome
    for name in lost:
        pool.submit(_call, function, tasks[name])
        _, outcome = pool.next_done()
        if isinstance(outcome, WorkerDied):
            outcome = None, f"{_DIED}: {outcome.detail}"
        yield name, *outcome


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


def _call(function: Callable[[Task], Result], task: Task) -> tuple[Result | None, str]:
    """Call a function; returns its result and "", or None and the reason why it failed."""
    try:
        with temporary_space():
            return function(task), ""
    except DiskFullError:
        raise
    except FidpipeError as error:
        return None, str(error)
    except Exception as error:  # one broken task does not stop the others
        return None, f"internal error: {type(error).__name__}: {error}\n{traceback.format_exc()}"
