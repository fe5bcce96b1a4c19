"""Baseline metrics: published distances of point clouds, to put the scores of an object into context.

One file per distance: its mathematics, and a function `compare` that returns names, units and reasons. To add one: its
file, a row in `BASELINES`, its name among the settings, a line in the documentation.
"""

from __future__ import annotations

from ...schemas.settings import BaselineName, MetricsSettings
from ..arrays import FloatArray, Watch, unwatched
from ..linalg.subgraph import Subgraph
from ..selection import Selection
from . import chamfer, dcd, emd, f_score, hausdorff, histogram, icp, netlsd, r_h, sliced_wasserstein
from .interface import Baseline, Baselines, MatchedObject, OfObjects, OfPoints

__all__ = ["BASELINES", "Baseline", "compare_objects", "compare_points"]

#: Baseline metrics by their names in the settings.
BASELINES: dict[BaselineName, OfPoints | OfObjects] = {
    "chamfer": OfPoints(chamfer.compare),
    "hausdorff": OfPoints(hausdorff.compare),
    "f_score": OfPoints(f_score.compare),
    "dcd": OfPoints(dcd.compare),
    "emd": OfObjects(emd.compare),
    "sliced_wasserstein": OfPoints(sliced_wasserstein.compare),
    "histogram": OfPoints(histogram.compare),
    "icp": OfPoints(icp.compare),
    "netlsd": OfObjects(netlsd.compare),
    "r_h": OfObjects(r_h.compare),
}


def compare_points(
    real: FloatArray, sim: FloatArray, settings: MetricsSettings, *, watch: Watch = unwatched
) -> Baselines:
    """Compute the requested baseline metrics of two point sets, in the order of the settings.

    Parameters
    ----------
    real, sim : (n, 3), (m, 3) float64, metres, in one frame, at least one point each
    settings : names and parameters; those that need a graph are left out
    watch : entered around each baseline

    Examples
    --------
    >>> import numpy as np
    >>> from fidpipe.schemas.settings import MetricsSettings
    >>> points = np.array([[0.0, 0, 0], [1, 0, 0]])
    >>> compare_points(points, points + [0, 0, 3], MetricsSettings(baselines=("hausdorff",)))
    (Baseline(name='hausdorff_m', unit='m', value=3.0, reason=None),)
    """
    values: list[Baseline] = []
    for name in settings.baselines:
        baseline = BASELINES[name]
        if isinstance(baseline, OfPoints):
            with watch(name):
                values += baseline.compare(real, sim, settings)
    return tuple(values)


def compare_objects(
    real: Subgraph,
    sim: Subgraph,
    selection: Selection,
    t: float,
    settings: MetricsSettings,
    *,
    watch: Watch = unwatched,
) -> Baselines:
    """Compute all requested baseline metrics of one matched object, in the order of the settings.

    Parameters
    ----------
    real, sim : one object on both sides, at least one point each
    selection : its aligned nodes
    t : diffusion time of r_H
    settings : names and parameters
    watch : entered around each baseline
    """
    matched = MatchedObject(real, sim, selection, t)
    values: list[Baseline] = []
    for name in settings.baselines:
        with watch(name):
            values += BASELINES[name].compare_object(matched, settings)
    return tuple(values)
