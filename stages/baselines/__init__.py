"""Baseline metrics: published distances of point clouds, to put the scores of an object into context.

One file per distance: its mathematics, and a function `compare` that returns names, values and reasons. To add one: its
file, a row here and in the catalogue, a line in the documentation.
"""

from __future__ import annotations

from ...schemas.settings import MetricsSettings
from ..arrays import FloatArray, Watch, unwatched
from ..linalg.subgraph import Subgraph
from ..selection import Selection
from . import chamfer, dcd, emd, f_score, hausdorff, histogram, icp, netlsd, r_h, sliced_wasserstein
from .interface import Baseline, Baselines, MatchedObject

__all__ = ["Baseline", "compare_objects", "compare_points"]

#: Baseline metrics of two point sets by their names in the settings.
OF_POINTS = {
    "chamfer": chamfer.compare,
    "hausdorff": hausdorff.compare,
    "f_score": f_score.compare,
    "dcd": dcd.compare,
    "sliced_wasserstein": sliced_wasserstein.compare,
    "histogram": histogram.compare,
    "icp": icp.compare,
}
#: Those that need the graphs or the aligned nodes of a matched object.
OF_OBJECTS = {"emd": emd.compare, "netlsd": netlsd.compare, "r_h": r_h.compare}


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
    (Baseline(name='hausdorff_m', value=3.0, reason=None),)
    """
    values: list[Baseline] = []
    for name in settings.baselines:
        if name in OF_POINTS:
            with watch(name):
                values += OF_POINTS[name](real, sim, settings)
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
            if name in OF_POINTS:
                values += OF_POINTS[name](real.points, sim.points, settings)
            else:
                values += OF_OBJECTS[name](matched, settings)
    return tuple(values)
