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
_COARSER = 3
_ALL_ARCS_NODES = 100
_SLACK_M = 1e-10  # rounding of dual prices: an arc must promise more than this to be added
_MOST_GAP_M = 1e-9  # a whole assignment may cost this much per node above its proven minimum
_ROUNDING = 1e-12  # and this share of its cost
_ROUNDING_OF_SQUARE = 1e-14  # relative, of a difference of squares
#: A power of two: the difference is exact, and nearer sets do not change.
_OFFSET_STEP_M = 1024.0
_BLOCK_DISTANCES = 2**20

#: Candidates of each node among a third of the nodes, at most 33; few need more rounds, many make rounds slow.
ARCS_PER_NODE = 6

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
    arcs, prices = _candidate_arcs(a, b)
    while True:
        sim_of_real, prices = _solve(a, b, arcs, prices)
        promising = _cheaper_arcs(a, b, prices[0] - _SLACK_M, prices[1])
        more_arcs = _with_new_arcs(arcs, promising)
        if len(more_arcs) == len(arcs):
            _check_certificate(a, b, sim_of_real, prices, promising)
            return sim_of_real
        arcs = more_arcs


def _candidate_arcs(a: FloatArray, b: FloatArray) -> tuple[IndexArray, Prices]:
    """Ascending codes i * n + j of cheap arcs of each node and of a whole assignment, and prices of both sides.

    Prices are those of a third of the nodes of each side, found the same way, carried over to all nodes.
    """
    n = len(a)
    along_a = _curve(a)
    along_b = _curve(b)
    m = n // _COARSER
    chosen = np.linspace(0, n - 1, m).astype(int)
    some_a = a[along_a[chosen]]
    some_b = b[along_b[chosen]]
    arcs = np.arange(m * m)
    prices = (np.zeros(m), np.zeros(m))
    if m > _ALL_ARCS_NODES:
        arcs, prices = _candidate_arcs(some_a, some_b)
    _, (_, price_some_b) = _solve(some_a, some_b, arcs, prices)
    price_a, limit_a = _cheapest(a, some_b, price_some_b)
    price_b, limit_b = _cheapest(b, some_a, price_a[along_a[chosen]])
    arcs = _with_new_arcs(_cheaper_arcs(a, b, limit_a, limit_b), along_a * n + along_b)
    return arcs, (price_a, price_b)


def _cheapest(
    nodes: FloatArray,
    other_nodes: FloatArray,
    price: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Smallest |x_i - y_j| - price_j for each node i, (n,), and the limit below which six are; in single precision.

    Six of a third of the nodes are about eighteen of all.
    """
    x = nodes.astype(np.float32)
    y = other_nodes.astype(np.float32)
    price_y = price.astype(np.float32)
    cheapest = []
    for rows in _blocks(len(x), len(y)):
        cost = x[rows] @ (-2 * y.T)
        cost += (y**2).sum(axis=1)
        cost += (x[rows] ** 2).sum(axis=1)[:, None]
        np.sqrt(np.maximum(cost, 0, out=cost), out=cost)
        cost -= price_y
        few = np.partition(cost, ARCS_PER_NODE, axis=1)[:, : ARCS_PER_NODE + 1]
        cheapest.append([few.min(axis=1), few[:, ARCS_PER_NODE]])
    least, limit = np.concatenate(cheapest, axis=1).astype(float)
    return least, limit


def _cheaper_arcs(
    a: FloatArray,
    b: FloatArray,
    price_a: FloatArray,
    price_b: FloatArray,
) -> IndexArray:
    """Ascending codes of all arcs that cost less than the prices of their ends.

    Where |x - y| < u + v, the matrix product |x|^2 - 2 x y + |y|^2 - (u + v)^2 is negative up to rounding; few other
    arcs come that near.
    """
    n = len(a)
    square_a = (a**2).sum(axis=1)
    square_b = (b**2).sum(axis=1)
    left = np.column_stack([a, price_a, square_a - price_a**2, np.ones(n)])
    right = np.column_stack([-2 * b, -2 * price_b, np.ones(n), square_b - price_b**2]).T
    largest = (square_a + price_a**2).max() + (square_b + price_b**2).max()
    rounding = _ROUNDING_OF_SQUARE * largest
    near = []
    for rows in _blocks(n, n):
        is_near = left[rows] @ right < rounding
        near.append(rows[0] * n + np.flatnonzero(is_near))
    codes = np.concatenate(near)
    i, j = np.divmod(codes, n)
    return codes[_lengths(a[i], b[j]) < price_a[i] + price_b[j]]


def _with_new_arcs(arcs: IndexArray, others: IndexArray) -> IndexArray:
    """Ascending codes of arcs and others."""
    return np.sort(np.concatenate([arcs, np.setdiff1d(others, arcs, assume_unique=True)]))


def _solve(
    a: FloatArray,
    b: FloatArray,
    arcs: IndexArray,
    prices: Prices,
) -> tuple[IndexArray, Prices]:
    """Best assignment along the given arcs, and the dual prices of both sides that prove it.

    Parameters
    ----------
    prices : to start with; the nearer to the dual prices, the faster
    """
    import ot

    n = len(a)
    i, j = np.divmod(arcs, n)
    cost = _lengths(a[i], b[j]) - prices[0][i] - prices[1][j]
    plan, log = ot.emd(
        np.ones(n),
        np.ones(n),
        scipy.sparse.coo_array((cost, (i, j)), (n, n)),
        numItermax=np.iinfo(np.int64).max // 2,
        log=True,
        center_dual=False,
        check_marginals=False,
    )
    if log["warning"]:
        raise StageError(
            f"alignment of {n} nodes: the network simplex failed ({log['warning']})"
        )
    chosen = plan.data > 0.5
    sim_of_real = np.full(n, -1)
    sim_of_real[plan.row[chosen]] = plan.col[chosen]
    return sim_of_real, (prices[0] + log["u"], prices[1] + log["v"])


def _lengths(a: FloatArray, b: FloatArray) -> FloatArray:
    """|a_i - b_i|, (n,)."""
    return np.sqrt(((a - b) ** 2).sum(axis=1))


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
    promising : codes of all arcs that cost less than the prices of their ends, see `_cheaper_arcs`
    """
    n = len(a)
    i, j = np.divmod(promising, n)
    excess_m = prices[0][i] + prices[1][j] - _lengths(a[i], b[j])
    cost_m = float(_lengths(a, b[sim_of_real]).sum())
    least_m = float(prices[0].sum() + prices[1].sum()) - n * float(
        excess_m.max(initial=_SLACK_M)
    )
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
