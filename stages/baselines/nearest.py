"""Distances between two point sets that are made of nearest neighbours: Chamfer, Hausdorff, F-score, DCD.

All take the points as they lie, nothing is centred. Leaves to others: which point sets (`baselines`); the Chamfer
distance of the paper that fidpipe reports for each object (`metrics`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from ..arrays import FloatArray, IndexArray


@dataclass(frozen=True)
class Chamfer:
    """The Chamfer distance in three conventions.

    mean_m : mean over real of the distance to the nearest simulated point, plus the same from simulated to real
    squared_m2 : the same of squared distances
    one_way_sum_m : sum over real points of the distance, not squared, one way
    """

    mean_m: float
    squared_m2: float
    one_way_sum_m: float


@dataclass(frozen=True)
class DensityAware:
    """The published density-aware Chamfer distance, and how many count weights were cut at 1 to keep it in [0, 1]."""

    dcd: float
    n_cut: int


def chamfer(real: FloatArray, sim: FloatArray) -> Chamfer:
    """Chamfer distances, 0 where every point of each side lies upon one of the other.

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
    to_sim, to_real = _both_ways(real, sim)
    return Chamfer(
        mean_m=float(to_sim.mean() + to_real.mean()),
        squared_m2=float((to_sim**2).mean() + (to_real**2).mean()),
        one_way_sum_m=float(to_sim.sum()),
    )


def hausdorff(real: FloatArray, sim: FloatArray) -> float:
    """max(max_x min_y |x - y|, max_y min_x |y - x|) in metres: the one worst point (Hausdorff, Mengenlehre, 1914).

    See Huttenlocher, Klanderman and Rucklidge, Comparing images using the Hausdorff distance, IEEE PAMI 1993, eq. 1.

    Parameters
    ----------
    real, sim : (n, 3), (m, 3) float64, metres, at least one point each
    """
    to_sim, to_real = _both_ways(real, sim)
    return float(max(to_sim.max(), to_real.max()))


def f_score(real: FloatArray, sim: FloatArray, distance_m: float) -> float:
    """2 P R / (P + R), 1 best, 0 where nothing is found (Knapitsch et al., Tanks and Temples, ACM TOG 2017, section 4).

    Precision P is the share of simulated points nearer than `distance_m` to a real one, recall R the share of real
    points nearer than that to a simulated one.

    Parameters
    ----------
    real, sim : (n, 3), (m, 3) float64, metres, at least one point each
    distance_m : points at this distance or farther are not found
    """
    to_sim, to_real = _both_ways(real, sim)
    recall, precision = float(np.mean(to_sim < distance_m)), float(np.mean(to_real < distance_m))
    return 2 * precision * recall / (precision + recall) if precision + recall else 0.0


def density_aware_chamfer(real: FloatArray, sim: FloatArray, alpha: float) -> DensityAware | None:
    """The published density-aware Chamfer distance, 0 to 1; None where the real points have no extent.

    DCD = 1/2 (mean_x (1 - w_x exp(-alpha |x - y'|^2)) + mean_y (1 - w_y exp(-alpha |y - x'|^2))), y' the nearest
    simulated point of x, w_x = (n / m) / (number of real points whose nearest is the same y'), and the other way
    round (Wu, Pan, Zhang, Wang, Liu and Lin, Density-aware Chamfer distance as a comprehensive metric for point cloud
    completion, NeurIPS 2021, section 3). Of equal sizes w is 1 over the count. The squared distance and the factor
    n / m of unequal sizes are those of the authors' code (`calc_dcd`); the article writes |x - y'|. With that factor a
    weight can be above 1, and its term below 0: such weights are cut at 1, and counted.

    alpha = 1000 was chosen by its authors for objects of unit size, so that both sides are scaled by the diagonal of
    the real object's axis-aligned bounding box. This is not the score that the paper calls CDC (`metrics`).

    Parameters
    ----------
    real, sim : (n, 3), (m, 3) float64, metres, at least one point each
    alpha : per squared unit size
    """
    size_m = float(np.linalg.norm(np.ptp(real, axis=0)))
    if size_m == 0:
        return None
    from_real, n_cut_real = _density_aware_one_way(real, sim, alpha / size_m**2)
    from_sim, n_cut_sim = _density_aware_one_way(sim, real, alpha / size_m**2)
    return DensityAware((from_real + from_sim) / 2, n_cut_real + n_cut_sim)


def _density_aware_one_way(x: FloatArray, y: FloatArray, alpha: float) -> tuple[float, int]:
    distance, nearest = cKDTree(y).query(x)
    found: IndexArray = nearest
    weight = len(x) / len(y) / np.bincount(found, minlength=len(y))[found]
    term = 1 - np.minimum(weight, 1.0) * np.exp(-alpha * distance**2)
    return float(term.mean()), int(np.count_nonzero(weight > 1.0))


def _both_ways(real: FloatArray, sim: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Distance of each real point to the nearest simulated one, (n,), and the other way round, (m,); metres."""
    to_sim, _ = cKDTree(sim).query(real)
    to_real, _ = cKDTree(real).query(sim)
    return to_sim, to_real
