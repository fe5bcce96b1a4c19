"""What each baseline is given and what it gives back.

A baseline is a file with one function `compare`. It takes either two point sets or a matched object, and the settings;
it returns its numbers, each with name and unit, and with a reason where one cannot be computed.
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
    """One number of a baseline.

    name : as in the table's rows
    unit : "m", "m2", or None for a plain number
    value : None where it cannot be computed
    reason : why not, or what is to be known of the value
    """

    name: str
    unit: str | None
    value: float | None
    reason: str | None = None


Baselines = tuple[Baseline, ...]


@dataclass(frozen=True)
class MatchedObject:
    """One object that both sides have.

    real, sim : its points and graph on each side
    selection : its aligned nodes
    t : diffusion time with which they were selected
    """

    real: Subgraph
    sim: Subgraph
    selection: Selection
    t: float

    def aligned_points(self) -> tuple[FloatArray, FloatArray]:
        """The aligned nodes of both sides, (n_keep, 3) each, metres; row i of one belongs to row i of the other."""
        return self.real.points[self.selection.real_nodes], self.sim.points[self.selection.sim_nodes]


@dataclass(frozen=True)
class OfPoints:
    """A baseline that needs nothing but two point sets, (n, 3) and (m, 3) float64, metres, at least one point each."""

    compare: Callable[[FloatArray, FloatArray, MetricsSettings], Baselines]

    def compare_object(self, matched: MatchedObject, settings: MetricsSettings) -> Baselines:
        """Its numbers for one object: those of all points of the object on either side."""
        return self.compare(matched.real.points, matched.sim.points, settings)


@dataclass(frozen=True)
class OfObjects:
    """A baseline that needs the graphs or the aligned nodes of a matched object."""

    compare: Callable[[MatchedObject, MetricsSettings], Baselines]

    def compare_object(self, matched: MatchedObject, settings: MetricsSettings) -> Baselines:
        """Its numbers for one object."""
        return self.compare(matched, settings)
