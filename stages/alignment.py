"""Decides which kept node of one side is which of the other: a minimum-distance one-to-one assignment.

Leaves to others: which nodes are kept (`selection`), what is compared after the alignment (`metrics`).
"""

from __future__ import annotations

from scipy.optimize import linear_sum_assignment
from scipy.spatial.distance import cdist

from .arrays import FloatArray, IndexArray


def align_nodes(real: FloatArray, sim: FloatArray) -> IndexArray:
    """The permutation p that minimises sum_i |r_i - s_p(i)|, both sides centred on their own mean; exact.

    "Hungarian spatial alignment" of the paper; Kuhn 1955, solved as in Crouse, IEEE Trans. AES 2016.

    Parameters
    ----------
    real, sim : (n, 3) float64, metres

    Examples
    --------
    >>> import numpy as np
    >>> align_nodes(np.array([[0.0, 0, 0], [1, 0, 0]]), np.array([[6.0, 0, 0], [5, 0, 0]])).tolist()
    [1, 0]
    """
    sim_of_real: IndexArray = linear_sum_assignment(cdist(real - real.mean(axis=0), sim - sim.mean(axis=0)))[1]
    return sim_of_real
