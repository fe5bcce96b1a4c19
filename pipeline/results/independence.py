"""Independent places: copies and neighbouring frames see the same surroundings, so that they count as one."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from ...stages.arrays import FloatArray, IntArray
from ...stages.statistics.comparison import LEAST_PAIRS, blocks_of
from ..storage.folder import RunFolder

NEEDED = f"needs {LEAST_PAIRS} places"


def find_places(
    store: RunFolder,
    names: Sequence[str],
    hashes: Mapping[str, Mapping[str, str]],
    times_s: Mapping[str, float | None],
) -> IntArray:
    """(n,) place of each scored pair: by time stamps, or without one by comparing the real scans.

    Parameters
    ----------
    hashes : by pair, content hash of its real scan (`real`)
    times_s : by pair, the time of its real scan
    """
    from ...stages.statistics.neighbours import neighbours  # loads scipy

    times = [times_s.get(name) for name in names]
    untimed = [i for i, time_s in enumerate(times) if time_s is None]
    links = neighbours(_object_points(store, names[i]) for i in untimed)
    contents = [hashes[name]["real"] for name in names]
    return blocks_of(contents, times, [(untimed[i], untimed[j]) for i, j in links])


def _object_points(store: RunFolder, pair_id: str) -> FloatArray:
    """(n, 3) the points of the real side without ground, metres."""
    table = store.read_table("ground", pair_id, "real", ["x", "y", "z", "is_ground"])
    points: FloatArray = np.column_stack([table[axis] for axis in "xyz"])
    return points[~table["is_ground"].to_numpy()]


def pairs_and_places(n_pairs: int, n_places: int) -> str:
    """Numbers of pairs and of places, as every command shows them.

    Examples
    --------
    >>> pairs_and_places(5, 1), pairs_and_places(8, 3), pairs_and_places(1, 1)
    ('5 neighbouring frames of one place', '8 pairs of 3 places', '1 pair')
    """
    if n_pairs == 1:
        return "1 pair"
    if n_places == 1:
        return f"{n_pairs} neighbouring frames of one place"
    return f"{n_pairs} pairs of {n_places} places"
