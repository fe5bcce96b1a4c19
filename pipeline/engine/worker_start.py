"""What a worker process of a local cluster begins with: all its imports, and Ctrl-C left to the one who started it."""

import signal
from typing import Any

import distributed.nanny
import distributed.worker
import ot
import sklearn.decomposition
import sknetwork.clustering

from . import worker

__all__ = ["distributed", "ot", "sklearn", "sknetwork", "worker"]


def dask_setup(worker: Any) -> None:
    """Called by dask in each worker."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
