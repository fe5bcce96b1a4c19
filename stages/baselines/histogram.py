"""Difference of the histograms of all distances within each point set. Needs no alignment."""

from __future__ import annotations

import numpy as np
import scipy

from ...schemas.settings import MetricsSettings
from ..arrays import FloatArray
from ..reference import visiting_order
from .interface import Baseline, Baselines

_SEED = 0


def compare(real: FloatArray, sim: FloatArray, settings: MetricsSettings) -> Baselines:
    """Baseline of `histogram_distance` with sample, bins and order of the settings."""
    points, bins, order = settings.histogram_points, settings.histogram_bins, settings.histogram_order
    distance = histogram_distance(real, sim, points, bins, order)
    reason = "a side has no two points apart from each other" if distance is None else None
    return (Baseline("histogram", distance, reason),)


def histogram_distance(real: FloatArray, sim: FloatArray, n_points: int, n_bins: int, order: float) -> float | None:
    """(sum_k |h_k(real) - h_k(sim)|^p)^(1/p); None if all points of a side coincide.

    h_k is the share of pairwise distances, divided by the largest distance of the side, in the k-th of equal bins from
    0 to 1: the paper's section "Related Work" after Wallace et al. (Validating simulation environments for automated
    driving systems using 3D object comparison metric, IEEE IV 2022), who compare by the Minkowski distance; the
    histogram itself is the shape distribution D2 of Osada, Funkhouser, Chazelle and Dobkin (Shape distributions, ACM
    TOG 2002). It does not depend on position, rotation and size of the object. Sides of more than `n_points` points are
    represented by a sample of that size, selected by a hash of the coordinates, independent of row order.

    Parameters
    ----------
    real, sim : (n, 3), (m, 3) float64, metres, at least one point each
    n_points : maximum number of points of a side
    n_bins : number of bins
    order : p of the Minkowski distance, at least 1; 2 is the Euclidean one
    """
    samples = [points[visiting_order(points, _SEED)[:n_points]] for points in (real, sim)]
    shares = [_distance_shares(points, n_bins) for points in samples]
    if shares[0] is None or shares[1] is None:
        return None
    return float(np.linalg.norm(shares[0] - shares[1], order))


def _distance_shares(points: FloatArray, n_bins: int) -> FloatArray | None:
    """Share of the pairwise distances in each bin, (n_bins,); None if all points coincide."""
    distance = scipy.spatial.distance.pdist(points)
    largest = distance.max(initial=0.0)
    if largest == 0:
        return None
    counts, _ = np.histogram(distance / largest, bins=n_bins, range=(0.0, 1.0))
    return counts / len(distance)
