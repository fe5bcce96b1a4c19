"""Literal baseline metrics: all distances, dense matrices, other libraries."""

from __future__ import annotations

import math
from collections import Counter

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment
from scipy.spatial.distance import cdist

from literal_method import distances, nearest_distances
from literal_surfaces import visiting_order


def of_points(
    real: NDArray[np.float64], sim: NDArray[np.float64], settings: dict[str, float]
) -> dict[str, float | None]:
    """Baseline metrics of two point sets by name; without ICP, whose result depends on the implementation.

    Parameters
    ----------
    real, sim : (n, 3), (m, 3) float64, metres
    settings : settings of the group metrics
    """
    to_sim, to_real = nearest_distances(real, sim), nearest_distances(sim, real)
    recall = sum(d < settings["f_score_distance_m"] for d in to_sim.tolist()) / len(real)
    precision = sum(d < settings["f_score_distance_m"] for d in to_real.tolist()) / len(sim)
    return {
        "chamfer_mean_m": math.fsum(to_sim) / len(to_sim) + math.fsum(to_real) / len(to_real),
        "chamfer_squared_m2": math.fsum(to_sim**2) / len(to_sim)
        + math.fsum(to_real**2) / len(to_real),
        "chamfer_one_way_sum_m": math.fsum(to_sim),
        "hausdorff_m": max(*to_sim.tolist(), *to_real.tolist()),
        "f_score": 2 * precision * recall / (precision + recall) if precision + recall else 0.0,
        "dcd": dcd(real, sim, settings["dcd_alpha"]),
        "histogram": histogram(real, sim, settings),
    }


def dcd(real: NDArray[np.float64], sim: NDArray[np.float64], alpha: float) -> float | None:
    """The published density-aware Chamfer distance, on the scale of the real object; None if it has no extent.

    Parameters
    ----------
    real, sim : (n, 3), (m, 3) float64, metres
    """
    size_m = math.hypot(*(real.max(axis=0) - real.min(axis=0)))
    if size_m == 0:
        return None

    def one_way(xs: NDArray[np.float64], ys: NDArray[np.float64]) -> float:
        ys = np.array(sorted(ys.tolist()))  # for equal distances the first by x, y, z
        nearest = [int(distances(ys, x).argmin()) for x in xs]
        count = Counter(nearest)
        terms = []
        for x, j in zip(xs, nearest, strict=True):
            weight = min(1.0, len(xs) / len(ys) / count[j])
            terms.append(1 - weight * math.exp(-alpha * (math.dist(x, ys[j]) / size_m) ** 2))
        return math.fsum(terms) / len(terms)

    return (one_way(real, sim) + one_way(sim, real)) / 2


def histogram(
    real: NDArray[np.float64], sim: NDArray[np.float64], settings: dict[str, float]
) -> float | None:
    """Minkowski distance of two histograms of pairwise distances; None if all points of a side coincide.

    Parameters
    ----------
    real, sim : (n, 3), (m, 3) float64, metres
    """
    shares = []
    for points in (real, sim):
        some = points[visiting_order(points)[: int(settings["histogram_points"])]]
        apart = cdist(some, some)[np.triu_indices(len(some), 1)]
        if not len(apart) or apart.max() == 0:
            return None
        bins = np.histogram(apart / apart.max(), int(settings["histogram_bins"]), (0, 1))[0]
        shares.append(bins / len(apart))
    order = settings["histogram_order"]
    return float((abs(shares[0] - shares[1]) ** order).sum() ** (1 / order))


def assignment_mean(a: NDArray[np.float64], b: NDArray[np.float64]) -> float:
    """Mean distance of the best one-to-one assignment, metres: the earth mover's distance of sets of equal size.

    Parameters
    ----------
    a, b : (n, 3) float64, metres
    """
    cost = cdist(a, b)
    return float(cost[linear_sum_assignment(cost)].mean())
