"""Plain tasks: a function called with each of many arguments, on one or several processes."""

from __future__ import annotations

import traceback
from collections.abc import Callable, Iterator, Mapping
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
    may_end_workers: bool = False,
) -> tuple[dict[str, Result], dict[str, str]]:
    """Call a function with each task; Ctrl-C ends all of them.

    Parameters
    ----------
    function : function of a module, which worker processes import
    tasks : arguments of the calls, by name of a pair
    reporter : shows progress, and each failure
    n_workers : number of processes; None for one per core; 1 for this process, unless a task may end it
    may_end_workers : True if a task may end its process, as a reader that crashes does

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
    pool = start_pool(n_workers, None, modules, may_end_workers=may_end_workers)
    try:
        for name, result, reason in reporter.counted(
            _outcomes(pool, function, tasks), len(tasks)
        ):
            if reason:
                failures[name] = reason
                reporter.fail(f"pair {name}", reason)
            else:
                results[name] = cast(Result, result)
    finally:
        pool.close()
    return results, failures


def _outcomes(
    pool: Pool, function: Callable[[Task], Result], tasks: Mapping[str, Task]
) -> Iterator[tuple[str, Result | None, str]]:
    """Name, result and reason of failure of each task, as they end; a task whose worker died is repeated alone."""
    groups = [list(tasks)]
    for group in groups:
        running = {pool.submit(_call, function, tasks[name]): name for name in group}
        for _ in group:
            handle, outcome = pool.next_done()
            name = running[handle]
            if not isinstance(outcome, WorkerDied):
                yield name, *outcome
            elif group is groups[0]:
                groups.append([name])
            else:
                yield name, None, f"{_DIED}: {outcome.detail}"


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
        return (
            None,
            f"internal error: {type(error).__name__}: {error}\n{traceback.format_exc()}",
        )
