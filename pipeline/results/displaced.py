"""Displacement between the simulated scans of two runs: the second is fitted to the first, pair by pair.

Both show the same place, mostly from the same model, so this is far more accurate than the difference of their
displacements against the real scan, and distinguishes errors of the range from those of the position.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...schemas.cause_catalogue import CAUSES
from ...stages.arrays import FloatArray, IntArray
from ...stages.displacement import PARAMETERS, fit_displacement
from ...stages.statistics.comparison import Difference, paired_difference
from .finished import FinishedRun

#: Pairs that are fitted, evenly over all (60 ms each).
MOST_PAIRS = 40
#: Nothing moved noticeably within this many times the accuracy of the estimate.
_STILL = 2.0
_OF_RANGES = frozenset(("range scale", "range bias"))


@dataclass(frozen=True)
class MovedWorld:
    """Displacement of the simulated scans of one run against those of another.

    measured : by parameter, without values before and after
    """

    measured: dict[str, Difference]

    @property
    def changes(self) -> dict[str, Difference]:
        """Those that moved by more than their half interval and the accuracy of the estimate, the largest first."""
        ratio = {name: own.size / CAUSES[name].resolution for name, own in self.measured.items()}
        beyond = [name for name, own in self.measured.items() if ratio[name] > 1 and own.size > (own.half_width or 0.0)]
        return {name: self.measured[name] for name in sorted(beyond, key=lambda name: -ratio[name])}

    @property
    def ranges_alone(self) -> bool:
        """True if ranges became longer or shorter, and the intervals exclude that anything else moved noticeably."""
        others = self.measured.keys() - _OF_RANGES
        is_still = all(self._most(name) <= _STILL * CAUSES[name].resolution for name in others)
        return is_still and bool(self.changes.keys() & _OF_RANGES)

    def allows(self, name: str, change: float) -> bool:
        """True if the interval of a parameter reaches a change that was estimated in another way."""
        return self._most(name) >= abs(change)

    def _most(self, name: str) -> float:
        """The larger end of the interval of a parameter, regardless of its sign."""
        return self.measured[name].size + (self.measured[name].half_width or 0.0)


def find_moved(base: FinishedRun, other: FinishedRun, names: Sequence[str], blocks: IntArray) -> MovedWorld | None:
    """The displacement; None if at least half of the pairs have too little surface in common.

    Parameters
    ----------
    names, blocks : (n,) pairs, and the block of each

    Raises
    ------
    RunError
        A table is damaged or gone.
    """
    rows = np.linspace(0, len(names) - 1, min(len(names), MOST_PAIRS)).astype(np.intp)
    values = np.array([_displacement(base, other, names[i]) for i in rows]).reshape(-1, len(PARAMETERS))
    if 2 * np.isnan(values).any(axis=1).sum() >= len(values):
        return None
    found = [paired_difference(np.zeros(len(own)), own, blocks[rows]) for own in values.T]
    measured = (replace(own, before=None, after=None) for own in found)
    return MovedWorld(dict(zip(PARAMETERS, measured, strict=True)))


def _displacement(base: FinishedRun, other: FinishedRun, name: str) -> FloatArray:
    """(11,) of `PARAMETERS`; NaN without enough surface in common."""
    if base.record.inputs[name]["sim"] == other.record.inputs[name]["sim"]:
        return np.zeros(len(PARAMETERS))
    columns = ["x", "y", "z", "is_ground"]
    tables = [run.read_table("ground", name, "sim", columns) for run in (base, other)]
    first, second = (np.column_stack([table[axis] for axis in "xyz"]).astype(np.float64) for table in tables)
    found = fit_displacement(first, second, tables[0]["is_ground"].to_numpy())
    return np.full(len(PARAMETERS), np.nan) if found is None else found.values
