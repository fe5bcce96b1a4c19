"""Batches on several processes: on a local dask cluster, or on the cluster behind a scheduler's address.

With `worker_start` the only file that needs dask, and only when a cluster is wanted (`pool` asks it for the memory of
the machine).
"""

from __future__ import annotations

import asyncio
import logging
import os
import queue
from collections.abc import Callable, Iterable
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from time import monotonic
from typing import Any

from ...schemas.errors import RunError
from ..storage.record import library_versions
from . import prefork
from .costs import CostModel
from .pool import (
    SHARE_OF_MEMORY,
    Handle,
    InProcess,
    Memory,
    Pool,
    WorkerDied,
    is_handles,
    machine_memory,
    one_blas_thread,
)

_CONNECT_TIMEOUT_S = 10


_FIRST_WORKER_TIMEOUT_S = 60


_STOP_S = 2.0


_KILL_S = 0.2


_SECONDS_BETWEEN_COUNTS = 1.0


#: One death of a worker ends its tasks (they are tried again alone); a busy event loop is no news; and what was sent is
#: not kept, for it grows with the pairs.
_DASK_SETTINGS = {
    "distributed.scheduler.allowed-failures": 0,
    "distributed.admin.tick.limit": "1h",
    "distributed.admin.low-level-log-length": 0,
}


@dataclass
class _Worker:
    """What a worker process remembers between tasks."""

    limits: Any = field(default=None)


_WORKER = _Worker()


def _in_worker(function: Callable[..., Any], *args: Any) -> Any:
    if _WORKER.limits is None:
        _WORKER.limits = one_blas_thread()
        _WORKER.limits.__enter__()
    return function(*args)


class DaskPool:
    """Runs tasks on the workers of a dask scheduler.

    Parameters
    ----------
    n_workers : processes of a cluster on this machine
    address : of a scheduler whose workers see the same files; no cluster is started then
    shared_file : a file that every worker must see with the same content
    libraries : versions that every worker must have
    memory : bytes that the worker processes may occupy together; None for what there is
    modules : names of those that the jobs are in, to be imported once for all workers of this machine

    Raises
    ------
    RunError
        The scheduler cannot be reached, or a worker does not see the files or has other library versions.
    """

    def __init__(
        self,
        n_workers: int,
        address: str | None,
        shared_file: Path,
        libraries: dict[str, str],
        memory: int | None = None,
        modules: Iterable[str] = (),
    ) -> None:
        if address is None:
            prefork.start(modules)  # before what is imported here: both take their time
        import dask
        import distributed

        logging.getLogger("distributed").setLevel(logging.CRITICAL)
        dask.config.set(_DASK_SETTINGS)
        if prefork.is_available():
            dask.config.set({"distributed.worker.multiprocessing-method": "forkserver"})
        self._done: queue.SimpleQueue[Any] = queue.SimpleQueue()
        self._handles: dict[str, tuple[Handle, bool]] = {}
        self._killed_worker = distributed.scheduler.KilledWorker
        self._cluster: Any = None
        self._client: Any = None
        self._address, self._given_memory = address, memory
        self._n_workers, self._asked = 1, -_SECONDS_BETWEEN_COUNTS
        try:
            self._start(n_workers, address)
            if address is not None:
                self._check_workers(address, shared_file, libraries)
        except BaseException:
            self.close(now=True)
            raise

    @property
    def n_workers(self) -> int:
        """Threads of all workers that are there now, at least 1; asked of the scheduler once in a while."""
        if monotonic() - self._asked > _SECONDS_BETWEEN_COUNTS:
            self._asked = monotonic()
            self._n_workers = max(1, sum(int(n) for n in self._client.nthreads().values()))
        return self._n_workers

    @property
    def memory(self) -> Memory:
        """See `Pool`."""
        if self._given_memory is not None or self._address is None:
            memory = self._given_memory or machine_memory()
            return Memory(memory, memory)
        limits = [
            int(worker["memory_limit"]) for worker in self._client.scheduler_info(n_workers=-1)["workers"].values()
        ]
        return Memory(int(SHARE_OF_MEMORY * sum(limits)), int(SHARE_OF_MEMORY * min(limits, default=0)))

    @property
    def dashboard(self) -> str:
        """See `Pool`; a cluster on this machine has none."""
        return "" if self._address is None else str(self._client.dashboard_link)

    def submit(self, function: Callable[..., Any], *args: Any, priority: float = 0, keep: bool = False) -> Handle:
        """See `Pool`."""
        passed = [[handle.future for handle in arg] if is_handles(arg) else arg for arg in args]
        future = self._client.submit(_in_worker, function, *passed, pure=False, priority=priority)
        handle = Handle(future)
        self._handles[future.key] = handle, keep
        future.add_done_callback(self._done.put)
        return handle

    def next_done(self) -> tuple[Handle, Any]:
        """See `Pool`."""
        future = self._done.get()
        handle, keep = self._handles.pop(future.key)
        if future.status != "finished":
            error = future.exception() if future.status == "error" else None
            if error is None or isinstance(error, self._killed_worker):
                return handle, WorkerDied(str(error or future.status))
            raise error
        if keep:
            return handle, None
        result = future.result()
        future.release()  # or it would be made again, and its files written again, if the worker that holds it dies
        return handle, result

    def close(self, *, now: bool = False) -> None:
        """See `Pool`."""
        if self._client is not None:
            with suppress(TimeoutError):  # a busy machine; what still runs ends with this process
                self._client.close(timeout=_STOP_S)
        if self._cluster is not None:
            if now:
                self._cluster.sync(self._stop_workers)
            with suppress(TimeoutError):
                self._cluster.close(timeout=_STOP_S)

    def _start(self, n_workers: int, address: str | None) -> None:
        """The cluster and its first worker; Ctrl-C waits while there are processes that nobody could end yet."""
        import distributed

        if address is None:
            with prefork.interrupts_afterwards():
                self._cluster = distributed.LocalCluster(
                    n_workers=n_workers,
                    threads_per_worker=1,
                    processes=True,
                    host="127.0.0.1",
                    dashboard_address=":0",  # any free port, so that runs beside each other do not fight for one
                    scheduler_kwargs={"dashboard": False},
                    memory_limit=self.memory.together,  # of each: one may need what the others leave
                    silence_logs=logging.CRITICAL,
                    preload=[prefork.WORKER_START],
                )
        try:
            self._client = distributed.Client(
                self._cluster or address, timeout=_CONNECT_TIMEOUT_S, set_as_default=False
            )
            self._client.wait_for_workers(1, timeout=_FIRST_WORKER_TIMEOUT_S)
        except (OSError, TimeoutError) as error:
            raise RunError(f"scheduler {address}: no cluster with a worker could be reached ({error})") from error

    async def _stop_workers(self) -> None:
        """Ends the worker processes in the middle of whatever they are doing."""
        closing = (nanny.close(timeout=_KILL_S) for nanny in self._cluster.workers.values())
        await asyncio.gather(*closing, return_exceptions=True)

    def _check_workers(self, address: str, shared_file: Path, libraries: dict[str, str]) -> None:
        content = shared_file.read_bytes()
        for worker, fault in self._client.run(worker_fault, str(shared_file.resolve()), content, libraries).items():
            if fault:
                raise RunError(f"scheduler {address}, worker {worker}: {fault}")


def start_pool(
    n_workers: int | None,
    address: str | None,
    memory_gib: float | None,
    shared_file: Path,
    libraries: dict[str, str],
    modules: Iterable[str] = (),
) -> Pool:
    """A pool in this process for one worker; else a cluster here, or the one behind an address. See `DaskPool`.

    There are no more workers than the memory holds.
    """
    memory = None if memory_gib is None else int(memory_gib * 2**30)
    n_workers = n_workers or cpu_count()
    if address is None and n_workers > 1:
        n_workers = min(n_workers, CostModel().most_workers(memory or machine_memory()))
    if address is None and n_workers == 1:
        return InProcess(memory)
    return DaskPool(n_workers, address, shared_file, libraries, memory, modules)


def worker_fault(path: str, content: bytes, libraries: dict[str, str]) -> str:
    """Why a worker cannot serve a run: it does not see the run's files, or has other versions; "" if it can."""
    try:
        own = Path(path).read_bytes()
    except OSError as error:
        return f"{path} cannot be read there ({error.strerror}); workers must see the same files under the same paths"
    if own != content:
        return f"{path} is another file there; workers must see the same files under the same paths"
    versions = library_versions(libraries)
    other = [
        f"{name} {versions[name]} (here {wanted})" for name, wanted in libraries.items() if versions[name] != wanted
    ]
    return f"other library versions: {', '.join(other)}; install the same ones there" if other else ""


def cpu_count() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
