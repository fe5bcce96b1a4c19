"""Recognition of scans of the same place by the overlap of their object points, also if the sensor has moved."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

from ..arrays import FloatArray

#: Two scans show the same place from this overlap on. Measured: ten frames within 12 m 0.60 and more, a parked sensor
#: 0.70 and more; scans of different places, recorded or generated, 0.31 at most (`docs/compare.md`).
SAME_PLACE = 0.45
_CELL_M = 1.0
_REACH_M = 50.0
_CELLS = int(2 * _REACH_M / _CELL_M)
_PADDED = 2 * _CELLS  #: of small prime factors, as a fast Fourier transform needs


@dataclass(frozen=True)
class PlaceMap:
    """Occupied cells of 1 m within 50 m of a scan.

    spectrum : Fourier transform of the map (1 occupied, 0 free)
    n_occupied : number of occupied cells
    """

    spectrum: NDArray[np.complex64]
    n_occupied: int


def map_place(points: FloatArray) -> PlaceMap:
    """The map of a scan.

    Parameters
    ----------
    points : (n, 3) float64, metres, object points (without ground), sensor at the origin, z up
    """
    cells = np.floor((points[:, :2] + _REACH_M) / _CELL_M).astype(np.int64)
    cells = cells[((cells >= 0) & (cells < _CELLS)).all(axis=1)]
    occupied = np.zeros((_CELLS, _CELLS), dtype=np.float32)
    occupied[cells[:, 0], cells[:, 1]] = 1.0
    spectrum = scipy.fft.rfft2(occupied, (_PADDED, _PADDED))
    return PlaceMap(spectrum, int(occupied.sum()))


def overlap(a: PlaceMap, b: PlaceMap) -> float:
    """Largest number of cells occupied in both maps over all translations, over the geometric mean of their numbers.

    1 for the same scan; a rotation of some degrees lowers it.
    """
    if not a.n_occupied or not b.n_occupied:
        return 0.0
    shared = scipy.fft.irfft2(a.spectrum * np.conj(b.spectrum), (_PADDED, _PADDED)).max()
    return float(shared / np.sqrt(a.n_occupied * b.n_occupied))


def neighbours(scans: Iterable[FloatArray], window: int = 5) -> list[tuple[int, int]]:
    """Index pairs of scans of the same place, each compared with the `window` scans before it.

    Parameters
    ----------
    scans : object points of each, as in `map_place`, neighbouring frames next to each other
    """
    pairs: list[tuple[int, int]] = []
    recent: deque[tuple[int, PlaceMap]] = deque(maxlen=window)
    for i, points in enumerate(scans):
        place = map_place(points)
        pairs += [(j, i) for j, other in recent if overlap(place, other) >= SAME_PLACE]
        recent.append((i, place))
    return pairs
