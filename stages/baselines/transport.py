"""Distances between two point sets as the least cost of moving one onto the other: earth mover's, sliced Wasserstein.

Leaves to others: which point sets (`baselines`), how an exact assignment is found (`alignment`).
"""

from __future__ import annotations

import numpy as np

from ..arrays import FloatArray
from ..linalg.assignment import assign_nodes

_SEED = 0
_DIRECTIONS_AT_ONCE = 10  # bounds the memory: all points are projected on each


def earth_movers(a: FloatArray, b: FloatArray) -> float:
    """min_p mean_i |a_i - b_p(i)| over all one-to-one assignments p, in metres; exact, of two sets of equal size.

    The earth mover's distance (Rubner, Tomasi and Guibas, The earth mover's distance as a metric for image retrieval,
    IJCV 2000) of points of equal weight; the paper's equation "d_EMD" is the sum, this is the mean. Solved as an
    assignment: see `alignment.assign_nodes`, whose large problems go through POT's network simplex.

    Parameters
    ----------
    a, b : (n, 3) float64, metres, as they lie; at least one point
    """
    return aligned_distance(a, b[assign_nodes(a, b)])


def aligned_distance(a: FloatArray, b: FloatArray) -> float:
    """mean_i |a_i - b_i| in metres, of rows that are assigned already.

    Parameters
    ----------
    a, b : (n, 3) float64, metres, at least one point
    """
    return float(np.linalg.norm(a - b, axis=1).mean())


def sliced_wasserstein(real: FloatArray, sim: FloatArray, n_projections: int) -> float:
    """The mean over random directions u of W1(u . real, u . sim), in metres; sets of any sizes, in n log n.

    The earth mover's distance of points on a line needs only sorting; its mean over the sphere of directions is the
    sliced Wasserstein distance of order 1 (Rabin, Peyre, Delon and Bernot, Wasserstein barycenter and its application
    to texture mixing, SSVM 2011; Bonneel, Rabin, Peyre and Pfister, JMIV 2015), here by Monte Carlo over directions
    that a fixed seed gives. It is at most the earth mover's distance: a shift by v costs |v| there, |v| / 2 here.
    POT's implementation.

    Parameters
    ----------
    real, sim : (n, 3), (m, 3) float64, metres, at least one point each; every point of a side weighs the same
    n_projections : number of directions
    """
    import ot

    directions = np.random.default_rng(_SEED).standard_normal((n_projections, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    total = 0.0
    for start in range(0, n_projections, _DIRECTIONS_AT_ONCE):
        some = directions[start : start + _DIRECTIONS_AT_ONCE].T
        total += len(some.T) * float(ot.sliced_wasserstein_distance(real, sim, projections=some, p=1))
    return total / n_projections
