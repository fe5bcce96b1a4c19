"""The Chamfer distance in three conventions: the mean distance to the nearest point of the other side."""

from __future__ import annotations

from ...schemas.settings import MetricsSettings
from ..arrays import FloatArray
from ..coverage import nearest_distances
from .interface import Baseline, Baselines


def compare(real: FloatArray, sim: FloatArray, settings: MetricsSettings) -> Baselines:
    """Chamfer distances without centring, 0 if each point of a side coincides with one of the other.

    chamfer_mean_m = mean_x min_y |x - y| + mean_y min_x |y - x|, x real, y simulated.
    chamfer_squared_m2: the same with |.|^2, the form of Fan, Su and Guibas (A point set generation network for 3D
    object reconstruction from a single image, CVPR 2017) and of Achlioptas et al. (Learning representations and
    generative models for 3D point clouds, ICML 2018), with means in place of their sums.
    chamfer_one_way_sum_m = sum_x min_y |x - y|: as the paper writes it (section "Related Work"), it grows with the
    number of real points and does not see invented ones.

    Parameters
    ----------
    real, sim : (n, 3), (m, 3) float64, metres, at least one point each

    Examples
    --------
    >>> import numpy as np
    >>> found = compare(np.array([[0.0, 0, 0], [4, 0, 0]]), np.array([[1.0, 0, 0]]), MetricsSettings())
    >>> [baseline.value for baseline in found]
    [3.0, 6.0, 4.0]
    """
    to_sim, to_real = nearest_distances(real, sim)
    return (
        Baseline("chamfer_mean_m", float(to_sim.mean() + to_real.mean())),
        Baseline("chamfer_squared_m2", float((to_sim**2).mean() + (to_real**2).mean())),
        Baseline("chamfer_one_way_sum_m", float(to_sim.sum())),
    )
