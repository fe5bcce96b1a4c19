"""Decides which kept node of one side is which of the other: a minimum-distance one-to-one assignment.

Leaves to others: which nodes are kept (`selection`), what is compared after the alignment (`metrics`).

Small objects are solved densely. Large ones by column generation: the assignment among a few candidate arcs a node,
priced by a coarser subsample, is solved exactly by the network simplex; its dual prices show every arc of the full
problem that could still improve it; these are added until there is none. The result is therefore the optimum of the
full problem, certified by its duals, though most arcs were never part of it. Memory stays at a few arcs a node.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from scipy import sparse
from scipy.optimize import linear_sum_assignment
from scipy.spatial.distance import cdist

from ..schemas.errors import StageError
from .arrays import FloatArray, IndexArray

_DENSE_NODES = 400  # up to here the dense solver is the faster one
_COARSER = 4
_ARCS_A_NODE = 24
_SLACK_M = 1e-10  # rounding of dual prices: an arc must promise more than this to be added
_BLOCK_DISTANCES = 2**20

Prices = tuple[FloatArray, FloatArray]


def align_nodes(real: FloatArray, sim: FloatArray) -> IndexArray:
    """The permutation p that minimises sum_i |r_i - s_p(i)|, both sides centred on their own mean; exact.

    "Hungarian spatial alignment" of the paper (Kuhn 1955). Up to 400 nodes by shortest augmenting paths (Crouse,
    IEEE Trans. AES 2016), above by network simplex on candidate arcs (Bonneel et al., SIGGRAPH Asia 2011), whose
    optimality for all arcs is checked by linear programming duality: u_i + v_j <= |r_i - s_j| everywhere.

    Parameters
    ----------
    real, sim : (n, 3) float64, metres

    Examples
    --------
    >>> import numpy as np
    >>> align_nodes(np.array([[0.0, 0, 0], [1, 0, 0]]), np.array([[6.0, 0, 0], [5, 0, 0]])).tolist()
    [1, 0]
    """
    a, b = real - real.mean(axis=0), sim - sim.mean(axis=0)
    if len(a) <= _DENSE_NODES:
        sim_of_real: IndexArray = linear_sum_assignment(cdist(a, b))[1]
        return sim_of_real
    prices = _coarse_prices(a, b)
    arcs, prices = _candidate_arcs(a, b, prices[1], _ARCS_A_NODE)
    arcs_a_node = _ARCS_A_NODE
    while True:
        solution = _solve(a, b, arcs, prices)
        if solution is None:  # no perfect matching among the candidates
            arcs_a_node *= 2
            arcs = np.union1d(arcs, _candidate_arcs(a, b, prices[1], arcs_a_node)[0])
            continue
        sim_of_real, prices = solution
        better = _promising_arcs(a, b, prices)
        if not len(better):
            return sim_of_real
        arcs = np.union1d(arcs, better)


def _coarse_prices(a: FloatArray, b: FloatArray) -> Prices:
    """Dual prices of a quarter of the nodes of each side, spread to all; of a quarter of those first, and so on."""
    n = len(a)
    m = max(2, n // _COARSER)
    some_a, some_b = a[_spread(a, m)], b[_spread(b, m)]
    if m <= _DENSE_NODES:
        arcs, start = np.arange(m * m), (np.zeros(m), np.zeros(m))
    else:
        arcs, start = _candidate_arcs(some_a, some_b, _coarse_prices(some_a, some_b)[1], _ARCS_A_NODE)
    solution = _solve(some_a, some_b, arcs, start)
    of_some_b = start[1] if solution is None else solution[1][1]
    of_a = np.concatenate([(cdist(a[rows], some_b) - of_some_b).min(axis=1) for rows in _blocks(n, m)])
    of_b = np.concatenate([(cdist(b[rows], a) - of_a).min(axis=1) for rows in _blocks(n, n)])
    return of_a, of_b


def _candidate_arcs(a: FloatArray, b: FloatArray, of_b: FloatArray, arcs_a_node: int) -> tuple[IndexArray, Prices]:
    """The cheapest arcs of each node of both sides under given prices of b, as codes i * n + j; and all prices."""
    n = len(a)
    k = min(arcs_a_node, n - 1)
    codes, of_a = [], np.empty(n)
    for rows in _blocks(n, n):
        cost = cdist(a[rows], b) - of_b
        cheapest = np.argpartition(cost, k, axis=1)[:, :k]
        of_a[rows] = np.take_along_axis(cost, cheapest, axis=1).min(axis=1)
        codes.append((rows[:, None] * n + cheapest).ravel())
    for columns in _blocks(n, n):
        cost = cdist(b[columns], a) - of_a
        cheapest = np.argpartition(cost, k, axis=1)[:, :k]
        codes.append((cheapest * n + columns[:, None]).ravel())
    return np.unique(np.concatenate(codes)), (of_a, of_b)


def _solve(a: FloatArray, b: FloatArray, arcs: IndexArray, start: Prices) -> tuple[IndexArray, Prices] | None:
    """The best assignment along the given arcs and its dual prices; None if there is no perfect one."""
    import warnings

    import ot

    n = len(a)
    i, j = np.divmod(arcs, n)
    cost = np.linalg.norm(a[i] - b[j], axis=1)
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="Problem infeasible")
        plan, log = ot.emd(
            np.ones(n),
            np.ones(n),
            sparse.coo_matrix((cost, (i, j)), (n, n)),
            numItermax=np.iinfo(np.int64).max // 2,
            log=True,
            center_dual=False,
            check_marginals=False,
            potentials_init=start,
        )
    chosen = plan.data > 0.5
    if np.count_nonzero(chosen) != n:
        if log["warning"] is None:
            raise StageError(
                f"alignment of {n} nodes: the network simplex gave no assignment; please report this object"
            )
        return None
    sim_of_real = np.empty(n, dtype=np.intp)
    sim_of_real[plan.row[chosen]] = plan.col[chosen]
    return sim_of_real, (log["u"], log["v"])


def _promising_arcs(a: FloatArray, b: FloatArray, prices: Prices) -> IndexArray:
    """Codes of all arcs that cost less than the prices of their ends: those that the solution must be tried with."""
    n = len(a)
    of_a, of_b = prices
    codes = []
    for rows in _blocks(n, n):
        slack = cdist(a[rows], b) - of_b
        i, j = np.nonzero(slack < (of_a[rows] - _SLACK_M)[:, None])
        codes.append(rows[i] * n + j)
    return np.concatenate(codes)


def _spread(points: FloatArray, m: int) -> IndexArray:
    """Indices of m points spread evenly along a space-filling (Morton) curve."""
    low, size = points.min(axis=0), max(float(np.ptp(points, axis=0).max()), np.finfo(float).tiny)
    cell = ((points - low) / size * 1023).astype(np.int64)
    code = np.zeros(len(points), dtype=np.int64)
    for bit in range(10):
        for axis in range(3):
            code |= ((cell[:, axis] >> bit) & 1) << (3 * bit + axis)
    return np.argsort(code, kind="stable")[np.linspace(0, len(points) - 1, m).astype(np.intp)]


def _blocks(n_rows: int, n_columns: int) -> Iterator[IndexArray]:
    """Row numbers in blocks whose distances to all columns fit the processor's cache."""
    height = max(1, _BLOCK_DISTANCES // n_columns)
    for start in range(0, n_rows, height):
        yield np.arange(start, min(start + height, n_rows))
