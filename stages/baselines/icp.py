"""Registration error of two point sets after iterative closest points (ICP)."""

from __future__ import annotations

from importlib.util import find_spec

import numpy as np
import scipy

from ...schemas.settings import MetricsSettings
from ..arrays import FloatArray
from .interface import Baseline, Baselines

MIN_POINTS = 11  # the library warns of fewer
_ITERATIONS = 100


def compare(real: FloatArray, sim: FloatArray, settings: MetricsSettings) -> Baselines:
    """Register the simulated points to the real ones by point-to-point ICP: fitness and RMSE.

    Besl and McKay, A method for registration of 3-D shapes, IEEE PAMI 1992, with correspondences up to
    `icp_distance_m` only; small_gicp's implementation (Koide, small_gicp: efficient and parallel algorithms for point
    cloud registration, JOSS 2024), started from the identity, one thread. With T the resulting motion and
    d_y = min_x |x - T y|: fitness = share of y with d_y <= icp_distance_m, rmse = root mean d_y^2 over these, which are
    the definitions of Open3D's `evaluate_registration` (Zhou, Park and Koltun 2018).

    Both are None without the library (an extra) or with too few points, the RMSE also without correspondences.

    Parameters
    ----------
    real, sim : (n, 3), (m, 3) float64, metres
    """
    n_fewest, reason = min(len(real), len(sim)), None
    if not can_register():
        reason = 'small_gicp is not installed; pip install "fidpipe[icp]"'
    elif n_fewest < MIN_POINTS:
        reason = f"{n_fewest} points on a side, at least {MIN_POINTS} are needed for ICP"
    if reason:
        return (Baseline("icp_fitness", None, reason), Baseline("icp_rmse_m", None, reason))
    import small_gicp

    centre = real.mean(axis=0)  # rounding of the normal equations grows with the distance from the origin
    target, source = real - centre, sim - centre
    result = small_gicp.align(
        small_gicp.PointCloud(target),
        small_gicp.PointCloud(source),
        registration_type="ICP",
        max_correspondence_distance=settings.icp_distance_m,
        num_threads=1,
        max_iterations=_ITERATIONS,
    )
    T_real_sim: FloatArray = result.T_target_source
    apart, _ = scipy.spatial.cKDTree(target).query(source @ T_real_sim[:3, :3].T + T_real_sim[:3, 3])
    near = apart[apart <= settings.icp_distance_m]
    reason = None if result.converged else "ICP had not converged"
    fitness = Baseline("icp_fitness", len(near) / len(apart), reason)
    if not len(near):
        return fitness, Baseline("icp_rmse_m", None, f"no points within {settings.icp_distance_m:g} m of each other")
    return fitness, Baseline("icp_rmse_m", float(np.sqrt(np.mean(near**2))), reason)


def can_register() -> bool:
    """True if small_gicp (an extra) is installed."""
    return find_spec("small_gicp") is not None
