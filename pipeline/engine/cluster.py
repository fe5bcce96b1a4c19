"""Batches on several processes: on a local dask cluster, or on the cluster behind a scheduler's address.

With `worker_start` the only file that needs dask, and only if there is a cluster (`pool` reads the
machine's memory from it).
"""

from __future__ import annotations

import asyncio
import atexit
import hashlib
import logging
import os
import queue
import re
import resource
import socket
from collections.abc import Callable, Iterable, Mapping
from concurrent.futures import CancelledError
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from time import monotonic
from typing import Any

from ...schemas.errors import RunError, StoreError
from ..storage.run_record import LIBRARIES, library_versions
from ..storage.table_files import TableFolder
from . import costs, prefork
from .pool import (
    SHARE_OF_MEMORY,
    Handle,
    Memory,
    Pool,
    WorkerDied,
    machine_memory,
    one_blas_thread,
)

_CONNECT_TIMEOUT_S = 10
_FIRST_WORKER_TIMEOUT_S = 60
_STARTS = 3
_STOP_S = 2.0
_KILL_S = 0.2
_SECONDS_BETWEEN_LOOKS = 1.0
_GIVEN_UP_S = 5.0
_WITHOUT_WORKERS_S = 600.0
_LEAST_ADDRESS_SPACE = 2 * 2**30
_CODE = "code of fidpipe"

#: For a cluster on this machine. A task at which two workers die is given up; `schedule` decides
#: what is tried again. A silent worker is busy in a library, a busy event loop is not reported,
#: logs of messages would grow with the pairs. The rows of the objects of a large pair are a large
#: argument. Workers would profile themselves every 10 ms, and all processes measure the delay of
#: their event loop every 20 ms, the memory of workers every 100 ms, and the system every 500 ms:
#: 1.5 ms of CPU per small pair.
_DASK_SETTINGS = {
    "distributed.scheduler.allowed-failures": 1,
    "distributed.scheduler.worker-ttl": None,
    "distributed.worker.multiprocessing-method": "forkserver",
    "distributed.worker.profile.enabled": False,
    "distributed.worker.memory.monitor-interval": "1s",
    "distributed.admin.system-monitor.interval": "10s",
    "distributed.admin.tick.interval": "1s",
    "distributed.admin.tick.limit": "1h",
    "distributed.admin.low-level-log-length": 0,
    "distributed.admin.large-graph-warning-threshold": "1GB",
}


@dataclass(frozen=True)
class Requirements:
    """Everything that the workers of a scheduler must share with the command.

    versions : see `code_versions`
    tables : of the run
    """

    versions: dict[str, str]
    tables: TableFolder


_CHECKED: list[Requirements] = []  #: that this worker process meets


_limit_threads = cache(one_blas_thread)  # as long as the process lives


def _in_worker(required: Requirements | None, function: Callable[..., Any], *args: Any) -> Any:
    if required is not None and required not in _CHECKED:
        if fault := worker_fault(required):  # it has joined after the first check
            raise RunError(f"a worker on {socket.gethostname()}: {fault}")
        _CHECKED.append(required)
    _limit_threads()
    return function(*args)


class DaskPool(Pool):
    """A pool on the workers of a dask scheduler.

    Parameters
    ----------
    n_workers : processes of a cluster on this machine
    memory : bytes that the worker processes may occupy together; None for the default
    modules : names of the modules of the jobs, to be imported once for all workers of this machine
    may_end_workers : True if tasks may end their process, so that something must restart it
    address : of a scheduler; no cluster is started then
    required : of its workers

    Raises
    ------
    RunError
        The scheduler cannot be reached, or a worker does not meet the requirements, or lacks a
        limit.
    """

    def __init__(
        self,
        n_workers: int,
        memory: int | None = None,
        modules: Iterable[str] = (),
        *,
        may_end_workers: bool = False,
        address: str | None = None,
        required: Requirements | None = None,
    ) -> None:
        if address is None:
            prefork.start(modules)  # before dask is imported, so that both run at the same time
        super().__init__(memory)
        self._done: queue.SimpleQueue[Any] = queue.SimpleQueue()
        self._ended: list[Any] = []
        self._cluster: Any = None
        self._client: Any = None
        self._address = address
        self._memory_there = Memory(0, 0)
        self._may_end_workers = may_end_workers
        self._required = required
        self._workers: dict[str, dict[str, Any]] = {}
        self._looked = -_SECONDS_BETWEEN_LOOKS
        self._had_workers = monotonic()
        self._dead_since: dict[Any, float] = {}
        try:
            self._start(n_workers)
            if required is not None:
                self._workers_now()
                self._check_workers()
        except BaseException:
            self.close()
            raise

    @property
    def n_workers(self) -> int:
        """Threads of all current workers, at least 1."""
        return max(1, sum(worker["nthreads"] for worker in self._workers_now().values()))

    @property
    def memory(self) -> Memory:
        """See `Pool`: of the current workers."""
        if self._memory is not None or self._address is None:
            return super().memory
        limits = [worker["memory_limit"] for worker in self._workers_now().values()]
        if limits:  # while all are gone, those that come again are taken to be like them
            self._memory_there = Memory(
                int(SHARE_OF_MEMORY * sum(limits)), int(SHARE_OF_MEMORY * min(limits))
            )
        return self._memory_there

    def submit(self, function: Callable[..., Any], *args: Any) -> Handle:
        """See `Pool`."""
        future = self._client.submit(_in_worker, self._required, function, *args, pure=False)
        future.add_done_callback(self._done.put)
        return future

    def next_done(self) -> tuple[Handle, Any]:
        """See `Pool`."""
        from distributed.scheduler import KilledWorker

        future = self._next_future()
        try:
            result = future.result()
        except KilledWorker as error:
            n_deaths = error.allowed_failures + 1
            return future, WorkerDied(
                f"{n_deaths} workers each time, the last one {error.last_worker.address}"
            )
        except CancelledError as error:
            raise RunError(
                self._lost("the connection is lost, or it gave up a task")
            ) from error
        future.release()  # or it would be repeated, and its files written again, if the worker that holds it dies
        return future, result

    def close(self) -> None:
        """See `Pool`."""
        if self._client is not None:
            with suppress(TimeoutError):
                # a busy machine; what still runs ends with this process
                self._client.close(timeout=_STOP_S)
        if self._cluster is not None:
            self._cluster.sync(_end, self._cluster.workers.values())
            with suppress(TimeoutError):
                self._cluster.close(timeout=_STOP_S)

    def _start(self, n_workers: int) -> None:
        """Connect to the scheduler, or start a cluster, and wait for the first worker."""
        import dask
        import distributed

        # dask sets the level of its client separately; asyncio reports workers that were ended
        # while they started
        for name in ("distributed", "distributed.client", "asyncio"):
            logging.getLogger(name).setLevel(logging.CRITICAL)
        dask.config.set(_DASK_SETTINGS)
        if self._address is None:
            self._start_cluster(n_workers)
        else:
            _check_address(self._address)
        try:
            self._client = distributed.Client(
                self._cluster or self._address, timeout=_CONNECT_TIMEOUT_S, set_as_default=False
            )
            _task = self._client.submit(os.getpid)  # adaptive clusters start workers for tasks
            self._client.wait_for_workers(1, timeout=_FIRST_WORKER_TIMEOUT_S)
        except (OSError, TimeoutError) as error:
            raise RunError(
                self._lost(f"no cluster with a worker could be reached ({error})")
            ) from error

    def _start_cluster(self, n_workers: int) -> None:
        """Start a cluster on this machine; it is restarted if a worker is killed during the start.

        Raises
        ------
        RunError
            That happens each time.
        """
        import distributed

        for _ in range(_STARTS):
            try:
                with prefork.interrupts_afterwards():
                    self._cluster = distributed.LocalCluster(
                        n_workers=n_workers,
                        threads_per_worker=1,
                        processes=True,
                        host="127.0.0.1",
                        dashboard_address="127.0.0.1:0",  # no other machine may ask it; any free port
                        scheduler_kwargs={"dashboard": False},
                        memory_limit=self.memory.together,  # of each: one may need what the others leave
                        silence_logs=logging.CRITICAL,
                        preload=[prefork.WORKER_START],
                    )
                return
            except RuntimeError as error:
                fault = error
            except BaseException:
                if self._cluster is None:
                    prefork.kill_workers()
                    # it asserts that all of it was there
                    atexit.unregister(distributed.deploy.spec.close_clusters)
                raise
        raise RunError(
            f"no cluster could be started here in {_STARTS} tries ({fault}; was a worker killed, or is memory or "
            "ulimit short?); run the same command again, or with --workers 1"
        ) from fault

    def _next_future(self) -> Any:
        """The next task that has ended; dask repeats one whose result was lost with its worker.

        Raises
        ------
        RunError
            The scheduler is lost, or has had no worker for a long time.
        """
        while True:
            self._look_after_workers()
            with suppress(queue.Empty):
                self._ended.append(self._done.get(timeout=_SECONDS_BETWEEN_LOOKS))
            for i, future in enumerate(self._ended):
                if future.done():
                    return self._ended.pop(i)
            if self._workers_now():
                self._had_workers = monotonic()
            elif monotonic() - self._had_workers > _WITHOUT_WORKERS_S:
                raise RunError(self._lost(f"no worker for {_WITHOUT_WORKERS_S:.0f} s"))

    def _look_after_workers(self) -> None:
        """Restart local workers that died while they started, which dask gives up."""
        if self._cluster is None:
            return
        now = monotonic()
        for name, nanny in list(self._cluster.workers.items()):
            if nanny.is_alive():
                self._dead_since.pop(name, None)
            elif now - self._dead_since.setdefault(name, now) > _GIVEN_UP_S:
                del self._dead_since[name]
                self._cluster.workers.pop(name, None)
                self._cluster.sync(_end, [nanny])
        if len(self._cluster.workers) < len(self._cluster.worker_spec):
            self._cluster.scale(len(self._cluster.worker_spec))  # starts the missing ones

    def _workers_now(self) -> dict[str, dict[str, Any]]:
        """The scheduler's description of its workers, by address; renewed every second."""
        if monotonic() - self._looked > _SECONDS_BETWEEN_LOOKS:
            try:
                self._workers = self._client.scheduler_info(n_workers=-1)["workers"]
            except (OSError, TimeoutError) as error:
                raise RunError(self._lost("the connection is lost")) from error
            self._looked = monotonic()
            for name, worker in self._workers.items():
                if self._address is not None and (fault := self._limit_fault(worker)):
                    raise RunError(f"scheduler {self._address}, worker {name}: {fault}")
        return self._workers

    def _limit_fault(self, worker: Mapping[str, Any]) -> str:
        """Missing limit or nanny of a worker, which may have joined late; "" if it has all."""
        if self._memory is None and not worker["memory_limit"]:
            return (
                "has no memory limit; start it with --memory-limit, or set the limit of all workers together: "
                "--set machine.memory_gib=NUMBER"
            )
        if self._may_end_workers and not (worker["nanny"] and worker["nthreads"] == 1):
            return "a pair that exceeds its time ends its worker process; start it with a nanny and --nthreads 1"
        return ""

    def _lost(self, fault: str) -> str:
        return f"scheduler {self._address or 'here'}: {fault}; run the same command again: it resumes where it stopped"

    def _check_workers(self) -> None:
        """Raise `RunError` if a run could not be completed on a worker."""
        checks = self._client.run(_in_worker, self._required, str, on_error="return")
        for fault in checks.values():
            if isinstance(fault, RunError):  # not one that has just ended
                raise fault


def start_pool(
    n_workers: int | None,
    memory_gib: float | None,
    modules: Iterable[str],
    *,
    may_end_workers: bool = False,
    address: str | None = None,
    required: Requirements | None = None,
) -> Pool:
    """A pool in this process for one worker; else a cluster here, or the one behind an address. See `DaskPool`.

    There are no more workers than fit into the memory. Tasks that may end their process never run
    in this one.
    """
    from dask.system import CPU_COUNT

    memory = None if memory_gib is None else int(memory_gib * 2**30)
    n_workers = n_workers or CPU_COUNT
    if address is None:
        n_workers = min(n_workers, costs.most_workers(memory or machine_memory()))
        if n_workers == 1 and not may_end_workers:
            return Pool(memory)
        _check_address_space()
    return DaskPool(
        n_workers,
        memory,
        modules,
        may_end_workers=may_end_workers,
        address=address,
        required=required,
    )


async def _end(nannies: Iterable[Any]) -> None:
    """End worker processes, in the middle of their tasks if they have any."""
    closing = [nanny.close(timeout=_KILL_S) for nanny in nannies]
    await asyncio.gather(*closing, return_exceptions=True)


def _check_address(address: str) -> None:
    """Raise `RunError` if an address is invalid: dask would end with a traceback after 10 s."""
    from distributed.security import Security

    is_valid = re.fullmatch(r"(tcp|tls)://\S+:\d+", address) is not None
    if is_valid and address.startswith("tls"):
        is_valid = Security().get_connection_args("client")["ssl_context"] is not None
    if not is_valid:
        raise RunError(
            f"scheduler {address!r}: expected an address tcp://HOST:PORT, or tls://HOST:PORT and the files of the "
            "certificates in DASK_DISTRIBUTED__COMM__TLS__CA_FILE, ..__CLIENT__CERT and ..__CLIENT__KEY"
        )


def _check_address_space() -> None:
    """Raise `RunError` if dask's threads cannot start under the limit on address space; dask would wait for them.

    Tried with two workers: at 1 GB two of three runs never ended, at 2 GiB all did; without a limit
    the command takes 1.8 GB.
    """
    limit, _ = resource.getrlimit(resource.RLIMIT_AS)
    if limit != resource.RLIM_INFINITY and limit < _LEAST_ADDRESS_SPACE:
        raise RunError(
            f"ulimit -v allows {limit / 2**30:.1f} GiB of address space per process; at least "
            f"{_LEAST_ADDRESS_SPACE / 2**30:.0f} are needed for worker processes; raise it, or use --workers 1"
        )


def worker_fault(required: Requirements) -> str:
    """Reason why a worker cannot serve a run: other versions, code or files; "" if it can."""
    others = []
    for name, version in code_versions(required.versions).items():
        if version != required.versions.get(name, version):
            others.append(f"{name} {version} (here {required.versions[name]})")
    if others:
        return f"other versions: {', '.join(others)}; install the same ones there"
    try:
        required.tables.check_token()
    except StoreError as error:
        return f"there, {error}; each worker needs credentials in its environment"
    except (OSError, RunError):
        return (
            f"{required.tables.folder} there is not the folder of this run; workers must see the same "
            "files under the same paths, or give the dataset and --out by URL"
        )
    return ""


def code_versions(libraries: Iterable[str]) -> dict[str, str]:
    """Versions of fidpipe and of its libraries, of other libraries, and a hash of fidpipe's code."""
    names = ("fidpipe", *LIBRARIES, *libraries)
    return library_versions(names) | {_CODE: code_hash()}


@cache
def code_hash() -> str:
    """A hash of fidpipe's own code and data: two checkouts of one version may differ."""
    root = Path(__file__).parents[2]
    digest = hashlib.sha256()
    for folder in ("pipeline", "schemas", "stages"):
        for path in sorted((root / folder).rglob("*.*")):
            if path.suffix in (".py", ".csv", ".toml"):
                name = path.relative_to(root).as_posix()
                digest.update(name.encode() + b"\0" + path.read_bytes())
    return digest.hexdigest()[:8]
