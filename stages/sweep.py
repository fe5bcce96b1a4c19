"""The returns of a scan by beam and azimuth, in which order a beam fires."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .arrays import BoolArray, FloatArray, IndexArray, azimuths_deg, level_m, sorted_rows
from .beam_patterns import BeamPattern


@dataclass(frozen=True)
class Sweep:
    """Returns in beams, sorted by beam, then by azimuth.

    beam : (m,) intp, row of the pattern's elevations
    off_deg : (m,) float64, elevation above that of the beam
    azimuth_deg, range_m : (m,) float64; range from the crossing point of the beams
    row : (m,) intp, of the scan
    """

    beam: IndexArray
    off_deg: FloatArray
    azimuth_deg: FloatArray
    range_m: FloatArray
    row: IndexArray

    @property
    def gap_deg(self) -> FloatArray:
        """Azimuth from each return to the next, (m - 1,) float64; NaN if the next is of another beam."""
        is_same_beam = np.diff(self.beam) == 0
        return np.where(is_same_beam, np.diff(self.azimuth_deg), np.nan)

    @property
    def nearer_m(self) -> FloatArray:
        """The smaller range of each return and the next, (m - 1,) float64."""
        return np.minimum(self.range_m[:-1], self.range_m[1:])

    @property
    def apart_m(self) -> FloatArray:
        """Difference of the ranges of each return and the next, (m - 1,) float64."""
        return np.abs(np.diff(self.range_m))

    def first_returns(self, is_later: BoolArray) -> Sweep:
        """The nearest return of each ray.

        Parameters
        ----------
        is_later : (m,) bool, True for returns of the same ray as the one before; see `trust.later_returns`
        """
        ray = np.cumsum(~is_later)
        order = np.lexsort((self.range_m, ray))
        _, first = np.unique(ray[order], return_index=True)
        return self.chosen(np.sort(order[first]))

    def chosen(self, rows: IndexArray | slice) -> Sweep:
        """The returns of these rows, in their order."""
        return Sweep(*(values[rows] for values in vars(self).values()))


def sweep_of(points: FloatArray, pattern: BeamPattern) -> Sweep:
    """The returns of a scan that are in beams."""
    beam, off_deg = pattern.beam_of(points)
    row = np.flatnonzero(beam >= 0)
    points = points[row]
    level = level_m(points) - pattern.focal_m
    sweep = Sweep(
        beam=beam[row],
        off_deg=off_deg[row],
        azimuth_deg=azimuths_deg(points),
        range_m=np.sqrt(level**2 + points[:, 2] ** 2),
        row=row,
    )
    return sweep.chosen(sorted_rows(sweep.beam, sweep.azimuth_deg, sweep.range_m))
