"""What moved between the simulated scans of two runs: the second is fitted to the first, pair by pair.

Both show the same place, mostly from the same model, so this is far more accurate than the difference of their
displacements against the real scan, and distinguishes errors of the range from those of the position.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ...stages.arrays import BoolArray, FloatArray, IntArray
from ...stages.diagnose.motion import PARAMETERS, fit_displacement
from ...stages.statistics.comparison import Difference, paired_difference
from .causes import DISPLACEMENTS
from .finished import FinishedRun

#: Pairs that are fitted, evenly over all (60 ms each).
MOST_PAIRS = 40
_OF_RANGES = frozenset(("range scale", "range bias"))


@dataclass(frozen=True)
class MovedWorld:
    """Displacement of the simulated scans of one run against those of another.

    changes : by parameter, those beyond the accuracy of the estimate, the largest first; without values before and
        after
    """

    changes: dict[str, Difference]

    @property
    def ranges_alone(self) -> bool:
        """True if ranges became longer or shorter, and nothing else moved."""
        return bool(self.changes) and self.changes.keys() <= _OF_RANGES


def find_moved(base: FinishedRun, other: FinishedRun, names: Sequence[str], blocks: IntArray) -> MovedWorld | None:
    """What moved; None if more than half of the pairs have too little surface in common.

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
    changes = {}
    for name, own in zip(PARAMETERS, values.T, strict=True):
        found = paired_difference(np.zeros(len(own)), own, blocks[rows])
        size, accuracy = abs(found.difference or 0.0), DISPLACEMENTS[name][1]
        reach = 0.0 if found.low is None or found.high is None else (found.high - found.low) / 2
        if size > max(reach, accuracy):
            changes[name] = (size / accuracy, found)
    return MovedWorld(
        {
            name: Difference(own.n_pairs, own.n_blocks, None, None, own.difference, own.std, own.low, own.high)
            for name, (_, own) in sorted(changes.items(), key=lambda item: -item[1][0])
        }
    )


def _displacement(base: FinishedRun, other: FinishedRun, name: str) -> FloatArray:
    """(11,) of `PARAMETERS`; NaN without enough surface in common."""
    if base.record.inputs[name]["sim"] == other.record.inputs[name]["sim"]:
        return np.zeros(len(PARAMETERS))
    (first, is_ground), (second, _) = (_clean_points(run, name) for run in (base, other))
    found = fit_displacement(first, second, is_ground)
    return np.full(len(PARAMETERS), np.nan) if found is None else found.values


def _clean_points(run: FinishedRun, name: str) -> tuple[FloatArray, BoolArray]:
    table = run.read_table("ground", name, "sim", ["x", "y", "z", "is_ground"])
    points = np.column_stack([table[axis] for axis in "xyz"]).astype(np.float64)
    return points, table["is_ground"].to_numpy()
