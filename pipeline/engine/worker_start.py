"""Start of a worker process of a local cluster: its imports, Ctrl-C left to the command, and a limit on memory."""

import gc
import importlib
import resource
import signal
from pathlib import Path
from typing import Any

#: POT brings scikit-learn, which brings most of SciPy.
_MODULES = (
    "distributed.nanny",
    "ot",
    "scipy.signal",
    "sknetwork.clustering",
    "fidpipe.pipeline.engine.worker",
    "fidpipe.stages.causes.estimates",
)

# Searching what is imported for garbage takes a third of the time, and workers would do it again.
gc.disable()
for name in _MODULES:
    importlib.import_module(name)
gc.freeze()
gc.enable()


def dask_setup(worker: Any) -> None:
    """Called by dask in each worker."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if worker.memory_manager.memory_limit:
        limit_memory(worker.memory_manager.memory_limit)


def limit_memory(n_bytes: int) -> None:
    """Limit the bytes that this process may allocate from now on: a file that needs more fails alone."""
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    _, hard = resource.getrlimit(resource.RLIMIT_AS)
    limit = pages * resource.getpagesize() + n_bytes
    resource.setrlimit(
        resource.RLIMIT_AS,
        (limit if hard == resource.RLIM_INFINITY else min(limit, hard), hard),
    )
