"""What tasks cost, roughly: seconds, to order them and to guess the time left; bytes, to admit them.

Fitted to runs over 32- and 64-beam scans (`benchmarks/growth.py`). No result depends on these numbers, but that a pair
whose object cannot fit into the memory fails.
"""

from __future__ import annotations

from collections.abc import Iterable

#: What a worker process occupies before it has read anything.
PROCESS_BYTES = 300 * 2**20

_BYTES_A_POINT = 6_000  # a scan's tables, its graph twice, and what Louvain makes of it
_BYTES_A_NODE = 15_000  # an object's arcs, candidates for the alignment


def side_seconds(n_raw: int) -> float:
    """What the stages of one side cost.

    Parameters
    ----------
    n_raw : points of the side's file
    """
    return 0.01 + 3e-5 * n_raw


def object_seconds(n_keep: int) -> float:
    """What selection and scores of one matched object cost.

    Parameters
    ----------
    n_keep : aligned nodes
    """
    return 0.005 + 5e-5 * n_keep + 2e-8 * n_keep**2 + 4e-11 * n_keep**3


def pair_bytes(n_raw: int) -> int:
    """What the tables of a pair occupy while a process works on them.

    Parameters
    ----------
    n_raw : points of both files
    """
    return _BYTES_A_POINT * n_raw


def object_bytes(n_keep: int) -> int:
    """What one object occupies while it is scored: at worst a whole dense matrix.

    Parameters
    ----------
    n_keep : aligned nodes
    """
    return 8 * n_keep**2 + _BYTES_A_NODE * n_keep


def most_workers(memory: int) -> int:
    """How many worker processes may be there, so that at least half of the memory is left for what they make.

    Parameters
    ----------
    memory : bytes that all of them together may occupy
    """
    return max(1, memory // (2 * PROCESS_BYTES))


def largest_object(n_keep: Iterable[tuple[int, int]]) -> tuple[int, int]:
    """Real id and nodes of the object that has the most; (-1, 0) where there is none."""
    return max(n_keep, key=lambda of: of[1], default=(-1, 0))
