"""Exact one-to-one assignment of two point sets of equal size with the smallest total distance.

Small sets are solved densely. Large ones by column generation: the assignment among a few candidate arcs per node,
priced by a coarser subsample, is solved exactly by the network simplex; its dual prices show every arc of the full
problem that could still improve it; these are added until none is left. So the result is the optimum of the full
problem, certified by its duals, although most arcs were never part of it. Memory stays at a few arcs per node.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import scipy

from ...schemas.errors import StageError
from ..arrays import FloatArray, IndexArray

_DENSE_NODES = 400  # up to here the dense solver is the faster one
_COARSER = 4
_TIGHT_ARCS_PER_NODE = 16
_SLACK_M = 1e-10  # rounding of dual prices: an arc must promise more than this to be added
_MOST_GAP_M = 1e-9  # a whole assignment may cost this much per node above its proven minimum
_ROUNDING = 1e-12  # and this share of its cost
_OFFSET_STEP_M = 1024.0  # a power of two: the difference is exact, and nearer sets do not change
_BLOCK_DISTANCES = 2**20

#: Initial candidates of each node, at most 400; few need more rounds of additions, many cost memory.
ARCS_PER_NODE = 72

Prices = tuple[FloatArray, FloatArray]


def align_nodes(real: FloatArray, sim: FloatArray) -> IndexArray:
    """Exact permutation p that minimises sum_i |r_i - s_p(i)|, with each side centred on its mean.

    "Hungarian spatial alignment" of the paper (Kuhn 1955). Up to 400 nodes by shortest augmenting paths (Crouse,
    IEEE Trans. AES 2016), above by network simplex on candidate arcs (Bonneel et al., SIGGRAPH Asia 2011), whose
    optimality for all arcs is checked by linear programming duality: u_i + v_j <= |r_i - s_j| everywhere, and
    sum u + sum v = sum_i |r_i - s_p(i)|, within 1e-9 m per node.

    Parameters
    ----------
    real, sim : (n, 3) float64, metres, at least one point each

    Examples
    --------
    >>> import numpy as np
    >>> align_nodes(np.array([[0.0, 0, 0], [1, 0, 0]]), np.array([[6.0, 0, 0], [5, 0, 0]])).tolist()
    [1, 0]
    """
    return assign_nodes(real - real.mean(axis=0), sim - sim.mean(axis=0))


def assign_nodes(a: FloatArray, b: FloatArray) -> IndexArray:
    """Exact permutation p that minimises sum_i |a_i - b_p(i)| for two sets of equal size, without centring.

    Parameters
    ----------
    a, b : (n, 3) float64, metres, at least one point each

    Raises
    ------
    StageError
        The network simplex ends without an assignment, or with one that its prices do not prove to be optimal.
    """
    offset = np.round(b.mean(axis=0) / _OFFSET_STEP_M) * _OFFSET_STEP_M
    # Far from the origin (UTM) single precision would not distinguish the candidates.
    if offset.any():
        a = a - offset
        b = b - offset
    if len(a) <= _DENSE_NODES:
        return scipy.optimize.linear_sum_assignment(scipy.spatial.distance.cdist(a, b))[1]
    arcs = _candidate_arcs(a, b, _coarse_prices(a, b))
    is_first = True
    while True:
        sim_of_real, prices = _solve(a, b, arcs)
        promising = _promising_arcs(a, b, prices)
        better = np.setdiff1d(promising, arcs, assume_unique=True)
        if not len(better):
            _check_certificate(a, b, sim_of_real, prices, promising)
            return sim_of_real
        if is_first:  # most arcs are too expensive; arcs that are wrongly left out are found again
            arcs = _tight_arcs(a, b, arcs, sim_of_real, prices)
            is_first = False
        arcs = np.sort(np.concatenate([arcs, better]), kind="stable")


def _coarse_prices(a: FloatArray, b: FloatArray) -> FloatArray:
    """Prices of b from those of a quarter of the nodes of each side, recursively."""
    n = len(a)
    m = n // _COARSER
    spread = np.linspace(0, n - 1, m).astype(int)
    some_a = a[_curve(a)[spread]]
    some_b = b[_curve(b)[spread]]
    arcs = np.arange(m * m)
    if m > _DENSE_NODES:
        arcs = _candidate_arcs(some_a, some_b, _coarse_prices(some_a, some_b))
    _, (_, price_some_b) = _solve(some_a, some_b, arcs)
    return _least(b, a, _least(a, some_b, price_some_b))


def _candidate_arcs(a: FloatArray, b: FloatArray, price_b: FloatArray) -> IndexArray:
    """Ascending codes i * n + j of the cheapest arcs for each node of either side, and of a whole assignment."""
    n = len(a)
    from_a, price_a = _cheapest(a, b, price_b)
    from_b, _ = _cheapest(b, a, price_a)
    along_curves = scipy.sparse.csr_array((np.ones(n, np.int8), (_curve(a), _curve(b))), (n, n))
    arcs = from_a + from_b.T + along_curves
    arcs.sort_indices()
    return np.repeat(np.arange(n) * n, np.diff(arcs.indptr)) + arcs.indices


def _cheapest(
    nodes: FloatArray,
    other_nodes: FloatArray,
    price: FloatArray,
) -> tuple[scipy.sparse.csr_array, FloatArray]:
    """Cheapest arcs to the other_nodes for each node, (n, n), and the smallest cost, (n,); in single precision."""
    x = nodes.astype(np.float32)
    y = other_nodes.astype(np.float32)
    price_y = price.astype(np.float32)
    ends = []
    counts = [np.zeros(1, dtype=int)]
    least = []
    for rows in _blocks(len(x), len(y)):
        cost = x[rows] @ (-2 * y.T)
        cost += (y**2).sum(axis=1)
        cost += (x[rows] ** 2).sum(axis=1)[:, None]
        np.sqrt(np.maximum(cost, 0, out=cost), out=cost)
        cost -= price_y
        limit = np.partition(cost, ARCS_PER_NODE, axis=1)[:, ARCS_PER_NODE, None]
        is_cheap = cost <= limit
        ends.append(np.flatnonzero(is_cheap) % len(y))
        counts.append(np.count_nonzero(is_cheap, axis=1))
        least.append(cost.min(axis=1))
    starts = np.cumsum(np.concatenate(counts))
    is_arc = np.ones(starts[-1], np.int8)
    arcs = scipy.sparse.csr_array((is_arc, np.concatenate(ends), starts), (len(x), len(y)))
    return arcs, np.concatenate(least).astype(float)


def _least(nodes: FloatArray, other_nodes: FloatArray, price: FloatArray) -> FloatArray:
    """min_j (|x_i - y_j| - price_j) for each node i."""
    least = []
    for rows in _blocks(len(nodes), len(other_nodes)):
        cost = scipy.spatial.distance.cdist(nodes[rows], other_nodes) - price
        least.append(cost.min(axis=1))
    return np.concatenate(least)


def _solve(a: FloatArray, b: FloatArray, arcs: IndexArray) -> tuple[IndexArray, Prices]:
    """Best assignment along the given arcs, and the dual prices of both sides that prove it."""
    import ot

    n = len(a)
    i, j = np.divmod(arcs, n)
    plan, log = ot.emd(
        np.ones(n),
        np.ones(n),
        scipy.sparse.coo_array((_lengths(a[i], b[j]), (i, j)), (n, n)),
        numItermax=np.iinfo(np.int64).max // 2,
        log=True,
        center_dual=False,
        check_marginals=False,
    )
    if log["warning"]:
        raise StageError(f"alignment of {n} nodes: the network simplex failed ({log['warning']})")
    chosen = plan.data > 0.5
    sim_of_real = np.full(n, -1)
    sim_of_real[plan.row[chosen]] = plan.col[chosen]
    return sim_of_real, (log["u"], log["v"])


def _lengths(a: FloatArray, b: FloatArray) -> FloatArray:
    """|a_i - b_i|, (n,)."""
    return np.sqrt(((a - b) ** 2).sum(axis=1))


def _tight_arcs(
    a: FloatArray,
    b: FloatArray,
    arcs: IndexArray,
    sim_of_real: IndexArray,
    prices: Prices,
) -> IndexArray:
    """Arcs with the smallest cost above the prices of their ends, and those of the assignment."""
    n = len(a)
    i, j = np.divmod(arcs, n)
    slack = _lengths(a[i], b[j]) - prices[0][i] - prices[1][j]
    n_tight = min(_TIGHT_ARCS_PER_NODE * n, len(arcs) - 1)
    is_tight = slack <= np.partition(slack, n_tight)[n_tight]
    return arcs[is_tight | (j == sim_of_real[i])]


def _promising_arcs(a: FloatArray, b: FloatArray, prices: Prices) -> IndexArray:
    """Codes of all arcs that cost less than the prices of their ends, and so could improve the solution."""
    n = len(a)
    price_a, price_b = prices
    codes = []
    for rows in _blocks(n, n):
        slack = scipy.spatial.distance.cdist(a[rows], b)
        slack -= price_b
        codes.append(rows[0] * n + np.flatnonzero(slack < (price_a[rows] - _SLACK_M)[:, None]))
    return np.concatenate(codes)


def _check_certificate(
    a: FloatArray,
    b: FloatArray,
    sim_of_real: IndexArray,
    prices: Prices,
    promising: IndexArray,
) -> None:
    """Raise `StageError` unless the prices prove that no assignment is shorter.

    With u_i + v_j <= c_ij + s everywhere, no assignment costs less than sum u + sum v - n s.

    Parameters
    ----------
    promising : codes of all arcs that cost less than the prices of their ends, see `_promising_arcs`
    """
    n = len(a)
    i, j = np.divmod(promising, n)
    excess_m = prices[0][i] + prices[1][j] - _lengths(a[i], b[j])
    cost_m = float(_lengths(a, b[sim_of_real]).sum())
    least_m = float(prices[0].sum() + prices[1].sum()) - n * float(excess_m.max(initial=_SLACK_M))
    is_one_to_one = np.array_equal(np.sort(sim_of_real), np.arange(n))
    if not (is_one_to_one and cost_m - least_m <= n * _MOST_GAP_M + _ROUNDING * cost_m):
        raise StageError(
            f"alignment of {n} nodes: costs {cost_m:.9g} m, "
            f"its dual prices prove {least_m:.9g} m only; "
            "the network simplex of POT ended too early, another version may do better"
        )


def _curve(points: FloatArray) -> IndexArray:
    """Order of points along a space-filling (Morton) curve through their bounding box."""
    size = np.maximum(np.ptp(points, axis=0), np.finfo(float).tiny)
    cell = ((points - points.min(axis=0)) / size * 1023).astype(np.int64)
    code = np.zeros(len(points), dtype=np.int64)
    for bit in range(30):
        code |= ((cell[:, bit % 3] >> bit // 3) & 1) << bit
    return np.argsort(code, kind="stable")


def _blocks(n_rows: int, n_columns: int) -> Iterator[IndexArray]:
    """Row numbers in blocks whose distances to all columns fit the processor's cache."""
    height = max(1, _BLOCK_DISTANCES // n_columns)
    for start in range(0, n_rows, height):
        yield np.arange(start, min(start + height, n_rows))
