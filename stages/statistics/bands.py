"""Bands of range, and an even choice of places."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

#: Edges of the range bands, metres; the last band has no end.
BAND_EDGES_M = (0.0, 10.0, 20.0, 30.0, 50.0)
BAND_NAMES = (
    *(f"{low:.0f} to {high:.0f} m" for low, high in pairwise(BAND_EDGES_M)),
    f"over {BAND_EDGES_M[-1]:.0f} m",
)


def evenly(n: int, most: int) -> list[int]:
    """Places of at most `most` of n things, evenly over their order, the first and the last among them.

    Examples
    --------
    >>> evenly(9, 3), evenly(2, 3), evenly(0, 3)
    ([0, 4, 8], [0, 1], [])
    """
    places: list[int] = np.linspace(0, n - 1, min(n, most)).astype(int).tolist()
    return places
