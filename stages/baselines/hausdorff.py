"""Hausdorff distance: distance of the worst point from the other side."""

from __future__ import annotations

from ...schemas.settings import MetricsSettings
from ..arrays import FloatArray
from ..coverage import nearest_distances
from .interface import Baseline, Baselines


def compare(real: FloatArray, sim: FloatArray, settings: MetricsSettings) -> Baselines:
    """Baseline of `hausdorff`."""
    return (Baseline("hausdorff_m", hausdorff(real, sim)),)


def hausdorff(real: FloatArray, sim: FloatArray) -> float:
    """max(max_x min_y |x - y|, max_y min_x |y - x|) in metres: the worst point (Hausdorff, Mengenlehre, 1914).

    See Huttenlocher, Klanderman and Rucklidge, Comparing images using the Hausdorff distance, IEEE PAMI 1993, eq. 1.

    Parameters
    ----------
    real, sim : (n, 3), (m, 3) float64, metres, not centred, at least one point each

    Examples
    --------
    >>> import numpy as np
    >>> hausdorff(np.array([[0.0, 0, 0], [4, 0, 0]]), np.array([[1.0, 0, 0]]))
    3.0
    """
    to_sim, to_real = nearest_distances(real, sim)
    return float(max(to_sim.max(), to_real.max()))
