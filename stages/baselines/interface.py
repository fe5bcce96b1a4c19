"""Inputs and outputs of a baseline metric.

A baseline is a file with one function `compare`. It takes either two point sets or a matched object, and the settings;
it returns its values, each with its name in the catalogue, and with a reason if it cannot be computed.
"""

from __future__ import annotations

from dataclasses import dataclass

from ...schemas.metric_catalogue import METRIC
from ..arrays import FloatArray
from ..linalg.subgraph import Subgraph
from ..selection import Selection


@dataclass(frozen=True)
class Baseline:
    """One value of a baseline.

    name : as in the table's rows, a column of the catalogue
    value : None if it cannot be computed
    reason : reason for None, or a note about the value
    """

    name: str
    value: float | None
    reason: str | None = None

    @property
    def unit(self) -> str | None:
        """Unit by the catalogue: "m", "m2", or None for a plain number."""
        return METRIC[self.name].unit


Baselines = tuple[Baseline, ...]


@dataclass(frozen=True)
class MatchedObject:
    """One object that both sides have.

    real, sim : points and graph on each side
    selection : aligned nodes
    t : diffusion time of the selection
    """

    real: Subgraph
    sim: Subgraph
    selection: Selection
    t: float

    def aligned_points(self) -> tuple[FloatArray, FloatArray]:
        """Aligned nodes of both sides, (n_keep, 3) each, metres; row i of one belongs to row i of the other."""
        return self.real.points[self.selection.real_nodes], self.sim.points[self.selection.sim_nodes]
