"""The process that the workers of this machine are forked from: it imports once what each of them needs.

It can be started before the command has imported all of that itself, so that both are ready at the same time. Where
there is no such way (Windows) workers start by themselves. Leaves to others: what the workers do (`fanout`).
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from typing import Any

#: What it imports.
PRELOADED = "fidpipe.pipeline.engine.worker_start"

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


@dataclass
class _Server:
    """What this process remembers of it."""

    is_needed: bool = False


_SERVER = _Server()


def start(*, needed: bool = True) -> None:
    """Starts the process, unless it is there; it imports while this one goes on.

    Parameters
    ----------
    needed : whether workers will be forked in any case; else it is done away with at the end if there were none
    """
    if not is_available():
        return
    _SERVER.is_needed |= needed
    from multiprocessing import forkserver

    forkserver.set_forkserver_preload([PRELOADED])
    with _environment(_ENVIRONMENT), ignoring_interrupts():
        forkserver.ensure_running()


def stop() -> None:
    """Ends it and waits for it, so that the seconds of all workers count as those of this command."""
    if not is_available():
        return
    from multiprocessing import forkserver

    server: Any = getattr(forkserver, "_forkserver", None)
    process_id = getattr(server, "_forkserver_pid", None)
    if process_id is None or not hasattr(server, "_stop"):  # there is no public way; it ends with this process
        return
    if not _SERVER.is_needed:
        with suppress(ProcessLookupError):
            os.kill(process_id, signal.SIGTERM)
    server._stop()


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
