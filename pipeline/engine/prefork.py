"""The process that the workers of this machine are forked from: it imports once what each of them needs.

It can be started before the command has imported all of that itself, so that both are ready at the same time. Where
there is no such way (Windows) workers start by themselves.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager

#: What it imports in any case, and what dask calls in each worker.
WORKER_START = "fidpipe.pipeline.engine.worker_start"

#: Of the forked processes: one BLAS thread, and an allocator that keeps blocks of up to 32 MiB instead of giving the
#: pages back and faulting them in again for each array.
_ENVIRONMENT = {
    "OPENBLAS_NUM_THREADS": "1",
    "OMP_NUM_THREADS": "1",
    "MKL_NUM_THREADS": "1",
    "MALLOC_TRIM_THRESHOLD_": str(1 << 30),
    "MALLOC_MMAP_THRESHOLD_": str(1 << 25),
}


def is_available() -> bool:
    """Whether processes can be forked from one that was started for it."""
    return "forkserver" in multiprocessing.get_all_start_methods()


def start(modules: Iterable[str] = ()) -> None:
    """Starts the process, unless it is there; it imports while this one goes on, and ends when this one does.

    Parameters
    ----------
    modules : what it imports besides, by name: those of the jobs
    """
    if not is_available():
        return
    from multiprocessing import forkserver

    forkserver.set_forkserver_preload([WORKER_START, *modules])
    with _environment(_ENVIRONMENT), ignoring_interrupts():
        forkserver.ensure_running()


@contextmanager
def ignoring_interrupts() -> Iterator[None]:
    """Within it Ctrl-C does nothing, and processes that are started inherit that: this one deals with it alone."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


@contextmanager
def _environment(values: Mapping[str, str]) -> Iterator[None]:
    before = {name: os.environ.get(name) for name in values}
    os.environ.update(values)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value
