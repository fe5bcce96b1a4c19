"""The earth mover's distance of the aligned nodes: the least mean way of moving one side onto the other."""

from __future__ import annotations

import numpy as np

from ...schemas.settings import MetricsSettings
from ..arrays import FloatArray
from ..linalg.assignment import assign_nodes
from .interface import Baseline, Baselines, MatchedObject


def compare(matched: MatchedObject, settings: MetricsSettings) -> Baselines:
    """The distance of the aligned nodes as they lie, and with both sides centred on their own mean."""
    real, sim = matched.aligned_points()
    # The alignment is the optimal assignment of the centred nodes, so that nothing need be solved again for these.
    centred_m = aligned_distance(real - real.mean(axis=0), sim - sim.mean(axis=0))
    return (
        Baseline("emd_mean_m", "m", earth_movers(real, sim)),
        Baseline("emd_centred_mean_m", "m", centred_m),
    )


def earth_movers(a: FloatArray, b: FloatArray) -> float:
    """min_p mean_i |a_i - b_p(i)| over all one-to-one assignments p, in metres; exact, of two sets of equal size.

    The earth mover's distance (Rubner, Tomasi and Guibas, The earth mover's distance as a metric for image retrieval,
    IJCV 2000) of points of equal weight; the paper's equation "d_EMD" is the sum, this is the mean. Solved as an
    assignment: see `linalg.assignment.assign_nodes`, whose large problems go through POT's network simplex.

    Parameters
    ----------
    a, b : (n, 3) float64, metres, as they lie; at least one point

    Examples
    --------
    >>> earth_movers(np.array([[0.0, 0, 0], [1, 0, 0]]), np.array([[1.0, 0, 2], [0, 0, 2]]))
    2.0
    """
    return aligned_distance(a, b[assign_nodes(a, b)])


def aligned_distance(a: FloatArray, b: FloatArray) -> float:
    """mean_i |a_i - b_i| in metres, of rows that are assigned already.

    Parameters
    ----------
    a, b : (n, 3) float64, metres, at least one point
    """
    return float(np.linalg.norm(a - b, axis=1).mean())
