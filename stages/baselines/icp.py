"""Registration error of two point sets after iterative closest points (ICP)."""

from __future__ import annotations

from dataclasses import dataclass
from importlib.util import find_spec

import numpy as np
import scipy

from ...schemas.settings import MetricsSettings
from ..arrays import FloatArray
from .interface import Baseline, Baselines

MIN_POINTS = 11  # the library warns of fewer
_ITERATIONS = 100


@dataclass(frozen=True)
class Registration:
    """The result of ICP.

    fitness : share of the simulated points that have a correspondence after the motion, 0 to 1
    rmse_m : root mean square distance of the correspondences, metres; None without correspondences
    has_converged : the motion no longer changed
    """

    fitness: float
    rmse_m: float | None
    has_converged: bool


def compare(real: FloatArray, sim: FloatArray, settings: MetricsSettings) -> Baselines:
    """Baselines of fitness and RMSE of `register`; None without the library (an extra) or with too few points."""
    n_fewest = min(len(real), len(sim))
    reason = None
    if not can_register():
        reason = 'small_gicp is not installed; pip install "fidpipe[icp]"'
    elif n_fewest < MIN_POINTS:
        reason = f"{n_fewest} points on a side, at least {MIN_POINTS} are needed for ICP"
    if reason:
        return (Baseline("icp_fitness", None, None, reason), Baseline("icp_rmse_m", "m", None, reason))
    result = register(real, sim, settings.icp_distance_m)
    if not result.has_converged:
        reason = "ICP had not converged"
    nothing_near = f"no points within {settings.icp_distance_m:g} m of each other"
    return (
        Baseline("icp_fitness", None, result.fitness, reason),
        Baseline("icp_rmse_m", "m", result.rmse_m, nothing_near if result.rmse_m is None else reason),
    )


def can_register() -> bool:
    """True if small_gicp (an extra) is installed."""
    return find_spec("small_gicp") is not None


def register(real: FloatArray, sim: FloatArray, distance_m: float) -> Registration:
    """Register the simulated points to the real ones by point-to-point ICP, and return fitness and RMSE.

    Besl and McKay, A method for registration of 3-D shapes, IEEE PAMI 1992, with correspondences up to `distance_m`
    only; small_gicp's implementation (Koide, small_gicp: efficient and parallel algorithms for point cloud
    registration, JOSS 2024), started from the identity, one thread. With T the resulting motion and
    d_y = min_x |x - T y|: fitness = share of y with d_y <= distance_m, rmse = root mean d_y^2 over these, which are
    the definitions of Open3D's `evaluate_registration` (Zhou, Park and Koltun 2018).

    Parameters
    ----------
    real, sim : (n, 3), (m, 3) float64, metres, at least 11 points each
    distance_m : maximum distance of a correspondence
    """
    import small_gicp

    centre = real.mean(axis=0)  # rounding of the normal equations grows with the distance from the origin
    target, source = real - centre, sim - centre
    result = small_gicp.align(
        small_gicp.PointCloud(target),
        small_gicp.PointCloud(source),
        registration_type="ICP",
        max_correspondence_distance=distance_m,
        num_threads=1,
        max_iterations=_ITERATIONS,
    )
    T_real_sim: FloatArray = result.T_target_source
    apart, _ = scipy.spatial.cKDTree(target).query(source @ T_real_sim[:3, :3].T + T_real_sim[:3, 3])
    near = apart[apart <= distance_m]
    return Registration(
        fitness=len(near) / len(apart),
        rmse_m=float(np.sqrt(np.mean(near**2))) if len(near) else None,
        has_converged=bool(result.converged),
    )
