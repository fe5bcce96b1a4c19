"""The distances that others use for point clouds, beside which the scores of an object are to be judged.

Decides which of them apply to two point sets and which to two matched objects, what each is called and in which unit,
and when one cannot be computed. Leaves the mathematics to `nearest`, `transport`, `pairwise`, `registration` and
`diffusion`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ...schemas.settings import BaselineName, MetricsSettings
from ..arrays import FloatArray, Watch, unwatched
from ..linalg.laplacian import Subgraph, induced_laplacian, normalised_laplacian
from ..metrics import IDENTICAL_CHANGE, MIN_NODES
from ..selection import Selection
from .diffusion import diffusion_change, heat_trace_distance
from .histogram import histogram_distance
from .icp import MIN_POINTS, can_register, register
from .nearest import chamfer, density_aware_chamfer, f_score, hausdorff
from .transport import aligned_distance, earth_movers, sliced_wasserstein


@dataclass(frozen=True)
class Baseline:
    """One number.

    name : of the table's row
    unit : "m", "m2", or None for a plain number
    value : None where it cannot be computed
    reason : why not, or what is to be known of the value
    """

    name: str
    unit: str | None
    value: float | None
    reason: str | None = None


def compare_points(
    real: FloatArray, sim: FloatArray, settings: MetricsSettings, *, watch: Watch = unwatched
) -> tuple[Baseline, ...]:
    """Those wanted baselines that need nothing but two point sets, in their order.

    Parameters
    ----------
    real, sim : (n, 3), (m, 3) float64, metres, in one frame, at least one point each
    settings : which, and their parameters
    watch : entered around each baseline

    Examples
    --------
    >>> import numpy as np
    >>> from fidpipe.schemas.settings import MetricsSettings
    >>> points = np.array([[0.0, 0, 0], [1, 0, 0]])
    >>> compare_points(points, points + [0, 0, 3], MetricsSettings(baselines=("hausdorff",)))
    (Baseline(name='hausdorff_m', unit='m', value=3.0, reason=None),)
    """
    found: list[Baseline] = []
    for name in settings.baselines:
        if name in _OF_POINTS:
            with watch(name):
                found += _OF_POINTS[name](real, sim, settings)
    return tuple(found)


def compare_objects(
    real: Subgraph,
    sim: Subgraph,
    selection: Selection,
    t: float,
    settings: MetricsSettings,
    *,
    watch: Watch = unwatched,
) -> tuple[Baseline, ...]:
    """All wanted baselines of one matched object, in their order.

    Parameters
    ----------
    real, sim : one object on both sides
    selection : its aligned nodes
    t : diffusion time of r_H
    settings : which, and their parameters
    watch : entered around each baseline
    """
    found: list[Baseline] = []
    for name in settings.baselines:
        with watch(name):
            if name in _OF_POINTS:
                found += _OF_POINTS[name](real.points, sim.points, settings)
            elif name == "emd":
                found += _emd(real, sim, selection)
            elif name == "netlsd":
                found.append(_netlsd(real, sim, settings))
            else:
                found.append(_r_h(real, sim, selection, t))
    return tuple(found)


def _chamfer(real: FloatArray, sim: FloatArray, settings: MetricsSettings) -> list[Baseline]:
    found = chamfer(real, sim)
    return [
        Baseline("chamfer_mean_m", "m", found.mean_m),
        Baseline("chamfer_squared_m2", "m2", found.squared_m2),
        Baseline("chamfer_one_way_sum_m", "m", found.one_way_sum_m),
    ]


def _hausdorff(real: FloatArray, sim: FloatArray, settings: MetricsSettings) -> list[Baseline]:
    return [Baseline("hausdorff_m", "m", hausdorff(real, sim))]


def _f_score(real: FloatArray, sim: FloatArray, settings: MetricsSettings) -> list[Baseline]:
    return [Baseline("f_score", None, f_score(real, sim, settings.f_score_distance_m))]


def _dcd(real: FloatArray, sim: FloatArray, settings: MetricsSettings) -> list[Baseline]:
    found = density_aware_chamfer(real, sim, settings.dcd_alpha)
    if found is None:
        return [Baseline("dcd", None, None, "the real points have no extent to scale by")]
    n_real, n_sim = len(real), len(sim)
    cut = f"{n_real} real and {n_sim} simulated points: {found.n_cut} of {n_real + n_sim} count weights cut at 1"
    return [Baseline("dcd", None, found.dcd, cut if found.n_cut else None)]


def _sliced_wasserstein(real: FloatArray, sim: FloatArray, settings: MetricsSettings) -> list[Baseline]:
    return [Baseline("sliced_wasserstein_m", "m", sliced_wasserstein(real, sim, settings.projections))]


def _histogram(real: FloatArray, sim: FloatArray, settings: MetricsSettings) -> list[Baseline]:
    found = histogram_distance(real, sim, settings.histogram_points, settings.histogram_bins, settings.histogram_order)
    reason = "a side has no two points apart from each other" if found is None else None
    return [Baseline("histogram", None, found, reason)]


def _icp(real: FloatArray, sim: FloatArray, settings: MetricsSettings) -> list[Baseline]:
    n_fewest = min(len(real), len(sim))
    reason = None
    if not can_register():
        reason = 'small_gicp is not installed; pip install ".[icp]"'
    elif n_fewest < MIN_POINTS:
        reason = f"{n_fewest} points on a side, at least {MIN_POINTS} are needed for ICP"
    if reason:
        return [Baseline("icp_fitness", None, None, reason), Baseline("icp_rmse_m", "m", None, reason)]
    found = register(real, sim, settings.icp_distance_m)
    if not found.has_converged:
        reason = "ICP had not converged"
    of_rmse = reason if found.rmse_m is not None else f"no points within {settings.icp_distance_m:g} m of each other"
    return [Baseline("icp_fitness", None, found.fitness, reason), Baseline("icp_rmse_m", "m", found.rmse_m, of_rmse)]


def _emd(real: Subgraph, sim: Subgraph, selection: Selection) -> list[Baseline]:
    a, b = real.points[selection.real_nodes], sim.points[selection.sim_nodes]
    return [
        Baseline("emd_mean_m", "m", earth_movers(a, b)),
        # the alignment is the optimal assignment of the centred nodes, so that nothing need be solved again
        Baseline("emd_centred_mean_m", "m", aligned_distance(a - a.mean(axis=0), b - b.mean(axis=0))),
    ]


def _netlsd(real: Subgraph, sim: Subgraph, settings: MetricsSettings) -> Baseline:
    n_most = max(len(real.points), len(sim.points))
    if n_most > settings.heat_max_nodes:
        reason = f"{n_most} points, metrics.heat_max_nodes allows {settings.heat_max_nodes}"
        return Baseline("netlsd", None, None, reason)
    times = np.geomspace(settings.heat_time_min, settings.heat_time_max, settings.heat_times)
    laplacians = normalised_laplacian(real.adjacency), normalised_laplacian(sim.adjacency)
    return Baseline("netlsd", None, heat_trace_distance(*laplacians, times))


def _r_h(real: Subgraph, sim: Subgraph, selection: Selection, t: float) -> Baseline:
    n_keep = len(selection.real_nodes)
    if n_keep < MIN_NODES:
        return Baseline("r_h", None, None, f"{n_keep} aligned nodes, at least {MIN_NODES} are needed")
    laplacians = induced_laplacian(real, selection.real_nodes), induced_laplacian(sim, selection.sim_nodes)
    return Baseline("r_h", None, diffusion_change(*laplacians, t, IDENTICAL_CHANGE))


_OF_POINTS: dict[BaselineName, Callable[[FloatArray, FloatArray, MetricsSettings], list[Baseline]]] = {
    "chamfer": _chamfer,
    "hausdorff": _hausdorff,
    "f_score": _f_score,
    "dcd": _dcd,
    "sliced_wasserstein": _sliced_wasserstein,
    "histogram": _histogram,
    "icp": _icp,
}
