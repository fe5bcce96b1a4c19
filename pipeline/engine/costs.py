"""The cost model of tasks, rough: seconds, to order and to bundle them; bytes, to admit them.

Fitted to runs over 32- and 64-beam scans (`benchmarks/growth.py`). No result depends on these
numbers, but that a pair whose object cannot fit into the memory fails.
"""

from __future__ import annotations

PROCESS_BYTES = 300 * 2**20  #: what a worker process occupies before it has read anything
BYTES_PER_POINT = 3_500  #: a scan's tables, its graph twice, and what Louvain makes of it
BYTES_PER_NODE = 15_000  #: an object's arcs, the candidates for its alignment


def side_seconds(n_raw: int) -> float:
    """Seconds of the stages of one side, whose file has `n_raw` points."""
    return 0.01 + 3e-5 * n_raw


def pair_seconds(n_raw: int) -> float:
    """Seconds of a large pair, at least; both files have `n_raw` points in all (measured up to 600,000)."""
    return 5e-4 * n_raw


def object_seconds(n_keep: int) -> float:
    """Seconds of selection and scores of one matched object with `n_keep` aligned nodes."""
    return 0.005 + 5e-5 * n_keep + 2e-8 * n_keep**2 + 4e-11 * n_keep**3


def pair_bytes(n_raw: int) -> int:
    """Bytes of the tables of a pair while a process works on them; both files have `n_raw` points in all."""
    return BYTES_PER_POINT * n_raw


def object_bytes(n_keep: int) -> int:
    """Bytes of one object with `n_keep` aligned nodes while it is scored: at worst a dense matrix."""
    return 8 * n_keep**2 + BYTES_PER_NODE * n_keep


def most_workers(memory: int) -> int:
    """Number of worker processes that may share a memory, at least half of which is left for results."""
    return max(1, memory // (2 * PROCESS_BYTES))
