"""The process from which the workers of this machine are forked: it imports the libraries once for all of them.

It is started before the command imports the same modules, so that both are ready at the same time.
Without it each worker imports them itself, also one that replaces a dead one: 2.5 s of CPU per
worker.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
from collections.abc import Iterable, Iterator
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

_STOPPING = (signal.SIGINT, signal.SIGTERM)
_LONGEST_WAIT_S = 15.0


def start(modules: Iterable[str] = ()) -> None:
    """Start the process if it is not running; it imports at the same time as this one, and ends with it.

    Parameters
    ----------
    modules : names of further modules to import: those of the jobs
    """
    from multiprocessing import forkserver, resource_tracker

    before = dict(os.environ)
    # the tracker removes what killed workers left and complains about that, after the command's
    # last line
    words = filter(None, [before.get("PYTHONWARNINGS"), "ignore:resource_tracker"])
    os.environ.update(_ENVIRONMENT, PYTHONWARNINGS=",".join(words))
    resource_tracker.ensure_running()  # the forkserver wants it; starting it lets Ctrl-C through
    # processes that are forked never get Ctrl-C: this one deals with it alone, at the end
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        forkserver.set_forkserver_preload([WORKER_START, *modules])
        forkserver.ensure_running()
    finally:
        os.environ.clear()
        os.environ.update(before)
        signal.pthread_sigmask(signal.SIG_SETMASK, mask)


@contextmanager
def interrupts_afterwards() -> Iterator[None]:
    """Context that delays Ctrl-C and SIGTERM until the processes being started can be ended in order.

    The delay is limited to some seconds, because a worker may never be ready.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    came: list[int] = []

    def note(number: int, _: object) -> None:
        came.append(number)
        if len(came) == 1:
            signal.setitimer(signal.ITIMER_REAL, _LONGEST_WAIT_S)

    before = {number: signal.signal(number, note) for number in _STOPPING}
    before[signal.SIGALRM] = signal.signal(signal.SIGALRM, signal.default_int_handler)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        for number, handler in before.items():
            signal.signal(number, handler)
    if came:
        signal.raise_signal(came[0])


def kill_workers() -> None:
    """End the workers of a cluster that never started completely: this process would wait for them at its end."""
    for process in multiprocessing.active_children():
        if process.name.startswith("Dask Worker"):
            process.kill()
