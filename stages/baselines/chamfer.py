"""The Chamfer distance in three conventions: the mean distance to the nearest point of the other side."""

from __future__ import annotations

from dataclasses import dataclass

from ...schemas.settings import MetricsSettings
from ..arrays import FloatArray
from ..coverage import nearest_distances
from .interface import Baseline, Baselines


@dataclass(frozen=True)
class Chamfer:
    """The Chamfer distance in three conventions.

    mean_m : mean distance of real points to the nearest simulated point, plus that of simulated to real points
    squared_m2 : as mean_m, of squared distances
    one_way_sum_m : sum over real points of the distance to the nearest simulated point
    """

    mean_m: float
    squared_m2: float
    one_way_sum_m: float


def compare(real: FloatArray, sim: FloatArray, settings: MetricsSettings) -> Baselines:
    """Baselines of the three conventions of `chamfer`."""
    distance = chamfer(real, sim)
    return (
        Baseline("chamfer_mean_m", "m", distance.mean_m),
        Baseline("chamfer_squared_m2", "m2", distance.squared_m2),
        Baseline("chamfer_one_way_sum_m", "m", distance.one_way_sum_m),
    )


def chamfer(real: FloatArray, sim: FloatArray) -> Chamfer:
    """Chamfer distances without centring, 0 if each point of a side coincides with one of the other.

    mean_m = mean_x min_y |x - y| + mean_y min_x |y - x|, x real, y simulated.
    squared_m2: the same with |.|^2, the form of Fan, Su and Guibas (A point set generation network for 3D object
    reconstruction from a single image, CVPR 2017) and of Achlioptas et al. (Learning representations and generative
    models for 3D point clouds, ICML 2018), with means in place of their sums.
    one_way_sum_m = sum_x min_y |x - y|: as the paper writes it (section "Related Work"), it grows with the number of
    real points and does not see invented ones.

    Parameters
    ----------
    real, sim : (n, 3), (m, 3) float64, metres, at least one point each

    Examples
    --------
    >>> import numpy as np
    >>> chamfer(np.array([[0.0, 0, 0], [4, 0, 0]]), np.array([[1.0, 0, 0]]))
    Chamfer(mean_m=3.0, squared_m2=6.0, one_way_sum_m=4.0)
    """
    to_sim, to_real = nearest_distances(real, sim)
    return Chamfer(
        mean_m=float(to_sim.mean() + to_real.mean()),
        squared_m2=float((to_sim**2).mean() + (to_real**2).mean()),
        one_way_sum_m=float(to_sim.sum()),
    )
