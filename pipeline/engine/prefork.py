"""The process from which the workers of this machine are forked: it imports the libraries once for all of them.

It is started before the command imports the same modules, so that both are ready at the same time.
Without it each worker imports them itself, also one that replaces a dead one: 2.5 s of CPU per
worker.
"""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager

#: What it imports in any case, and what dask calls in each worker.
WORKER_START = "fidpipe.pipeline.engine.worker_start"

#: Of the forked processes: one BLAS thread, and an allocator that keeps blocks of up to 32 MiB
#: instead of giving the pages back and faulting them in again for each array.
_ENVIRONMENT = {
    "OPENBLAS_NUM_THREADS": "1",
    "OMP_NUM_THREADS": "1",
    "MKL_NUM_THREADS": "1",
    "MALLOC_TRIM_THRESHOLD_": str(1 << 30),
    "MALLOC_MMAP_THRESHOLD_": str(1 << 25),
}


def start(modules: Iterable[str] = ()) -> None:
    """Start the process if it is not running; it imports at the same time as this one, and ends with it.

    Parameters
    ----------
    modules : names of further modules to import: those of the jobs
    """
    from multiprocessing import forkserver, resource_tracker

    # It removes what killed workers left and complains about that, after the command's last line.
    words = ",".join(filter(None, [os.environ.get("PYTHONWARNINGS"), "ignore:resource_tracker"]))
    with _environment({"PYTHONWARNINGS": words}):
        resource_tracker.ensure_running()  # the forkserver wants it; starting it would let Ctrl-C through again
    forkserver.set_forkserver_preload([WORKER_START, *modules])
    with _environment(_ENVIRONMENT), _without_interrupts():
        forkserver.ensure_running()


@contextmanager
def interrupts_afterwards() -> Iterator[None]:
    """Context that delays Ctrl-C and SIGTERM until the processes being started can be ended in order."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    came: list[int] = []
    before = {}
    for number in (signal.SIGINT, signal.SIGTERM):
        before[number] = signal.signal(number, lambda number, _: came.append(number))
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
    if came:
        signal.raise_signal(came[0])


@contextmanager
def _without_interrupts() -> Iterator[None]:
    """Processes that are started within it never get Ctrl-C: this one deals with it alone, at the end of the block."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


@contextmanager
def _environment(values: Mapping[str, str]) -> Iterator[None]:
    before = dict(os.environ)
    os.environ.update(values)
    try:
        yield
    finally:
        os.environ.clear()
        os.environ.update(before)
