"""Inputs and outputs of a baseline metric.

A baseline is a file with one function `compare`. It takes either two point sets or a matched object, and the settings;
it returns its values, each with name and unit, and with a reason if it cannot be computed.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from ...schemas.settings import MetricsSettings
from ..arrays import FloatArray
from ..linalg.subgraph import Subgraph
from ..selection import Selection


@dataclass(frozen=True)
class Baseline:
    """One value of a baseline.

    name : as in the table's rows
    unit : "m", "m2", or None for a plain number
    value : None if it cannot be computed
    reason : reason for None, or a note about the value
    """

    name: str
    unit: str | None
    value: float | None
    reason: str | None = None


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


@dataclass(frozen=True)
class OfPoints:
    """Baseline of two point sets, (n, 3) and (m, 3) float64, metres, at least one point each."""

    compare: Callable[[FloatArray, FloatArray, MetricsSettings], Baselines]

    def compare_object(self, matched: MatchedObject, settings: MetricsSettings) -> Baselines:
        """Values for one object, from all its points on each side."""
        return self.compare(matched.real.points, matched.sim.points, settings)


@dataclass(frozen=True)
class OfObjects:
    """Baseline that needs the graphs or the aligned nodes of a matched object."""

    compare: Callable[[MatchedObject, MetricsSettings], Baselines]

    def compare_object(self, matched: MatchedObject, settings: MetricsSettings) -> Baselines:
        """Values for one object."""
        return self.compare(matched, settings)
