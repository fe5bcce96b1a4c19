"""Matching of real and simulated objects: by centroids (paper, Algorithm 1), or by the ids of reference objects."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy

from ..schemas.settings import MatchingSettings
from .arrays import BoolArray, FloatArray, IndexArray, IntArray


@dataclass(frozen=True)
class Matching:
    """Matched and unmatched objects of both sides.

    real_ids, sim_ids : (m,) int32, matched communities, by real id
    distance_m : (m,) float64, distance between their centroids
    not_found : (a,) int32, real communities without a partner
    extra : (b,) int32, simulated communities without a partner
    """

    real_ids: IntArray
    sim_ids: IntArray
    distance_m: FloatArray
    not_found: IntArray
    extra: IntArray


def match_communities(
    real: FloatArray,
    sim: FloatArray,
    settings: MatchingSettings,
) -> Matching:
    """Match communities with centroids nearer than delta.

    greedy : real communities in id order; each is matched with the nearest simulated centroid that is still free (for
        equal distances the smaller id), if it is nearer than delta (Algorithm 1).
    optimal : the largest number of pairs nearer than delta, and among these the smallest total distance.

    Parameters
    ----------
    real, sim : (a, 3), (b, 3) float64, metres, centroids by community id
    settings : delta_m and method

    Examples
    --------
    >>> import numpy as np
    >>> real, sim = np.array([[0.0, 0, 0], [9, 0, 0]]), np.array([[1.0, 0, 0], [30, 0, 0]])
    >>> matching = match_communities(real, sim, MatchingSettings())
    >>> matching.real_ids.tolist(), matching.not_found.tolist(), matching.extra.tolist()
    ([0], [1], [1])
    """
    match = _greedy if settings.method == "greedy" else _optimal
    real_ids, sim_ids = match(real, sim, settings.delta_m).T
    return Matching(
        real_ids=real_ids.astype(np.int32),
        sim_ids=sim_ids.astype(np.int32),
        distance_m=np.linalg.norm(real[real_ids] - sim[sim_ids], axis=1),
        not_found=np.setdiff1d(np.arange(len(real), dtype=np.int32), real_ids),
        extra=np.setdiff1d(np.arange(len(sim), dtype=np.int32), sim_ids),
    )


def match_reference(
    real: FloatArray,
    sim: FloatArray,
    n_real: IntArray,
    n_sim: IntArray,
    min_points: int,
) -> Matching:
    """Match reference objects, whose ids are the same on both sides, if enough of them is simulated.

    A real object is matched with the simulated one of its id, regardless of the distance, if that has at least
    min(min_points, n_real) points; else it is not found. Simulated objects with higher ids are extra.

    Parameters
    ----------
    real, sim : (a, 3), (b, 3) float64, metres, centroids by id, b >= a; NaN without simulated points
    n_real, n_sim : (a,), (b,) int32, points of each object
    min_points : minimum size of a simulated object

    Examples
    --------
    >>> import numpy as np
    >>> places, sizes = np.arange(9.0).reshape(3, 3), np.array([20, 8, 30], dtype=np.int32)
    >>> matching = match_reference(places[:2], places, sizes[:2], sizes, 10)
    >>> matching.real_ids.tolist(), matching.not_found.tolist(), matching.extra.tolist()
    ([0, 1], [], [2])
    """
    ids = np.arange(len(n_sim), dtype=np.int32)
    n_shared = len(n_real)
    is_matched = n_sim[:n_shared] >= np.minimum(min_points, n_real)
    shared = ids[:n_shared]
    matched = shared[is_matched]
    return Matching(
        real_ids=matched,
        sim_ids=matched,
        distance_m=np.linalg.norm(real[matched] - sim[matched], axis=1),
        not_found=shared[~is_matched],
        extra=ids[n_shared:],
    )


def most_pairs(distance_m: FloatArray, is_allowed: BoolArray, most_m: float) -> IndexArray:
    """The largest number of allowed pairs of rows and columns at the smallest total distance, (m, 2), by row.

    Parameters
    ----------
    distance_m : (a, b) float64, metres
    is_allowed : (a, b) bool
    most_m : largest distance that is allowed
    """
    # A forbidden pair costs more than all allowed ones together, so the solution has as few of them as possible.
    forbidden_m = most_m * (min(distance_m.shape) + 1)
    cost = np.where(is_allowed, distance_m, forbidden_m)
    pairs = np.column_stack(scipy.optimize.linear_sum_assignment(cost))
    return pairs[is_allowed[*pairs.T]]


def _greedy(real: FloatArray, sim: FloatArray, delta_m: float) -> IndexArray:
    """Real and simulated ids of Algorithm 1, (m, 2), by real id; one row of distances at a time."""
    is_taken = np.zeros(len(sim), dtype=bool)
    pairs = []
    for real_id, centroid in enumerate(real):
        distance_m = scipy.spatial.distance.cdist([centroid], sim)[0]
        distance_m[is_taken] = np.inf
        sim_id = int(np.argmin(distance_m))
        if distance_m[sim_id] < delta_m:
            pairs.append((real_id, sim_id))
            is_taken[sim_id] = True
    return np.array(pairs, dtype=int).reshape(-1, 2)


def _optimal(real: FloatArray, sim: FloatArray, delta_m: float) -> IndexArray:
    """Real and simulated ids of the most pairs nearer than delta, (m, 2), by real id; see `most_pairs`."""
    distance_m = scipy.spatial.distance.cdist(real, sim)
    return most_pairs(distance_m, distance_m < delta_m, delta_m)
