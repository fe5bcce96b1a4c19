import numpy as np
import pytest
from scipy.optimize import linear_sum_assignment
from scipy.spatial.distance import cdist

import literal_method
from fidpipe.schemas.errors import StageError
from fidpipe.stages.linalg import assignment
from fidpipe.stages.linalg.assignment import align_nodes, assign_nodes


def total_distance(real, sim, sim_of_real):
    a = real - real.mean(axis=0)
    b = sim - sim.mean(axis=0)
    return np.linalg.norm(a - b[sim_of_real], axis=1).sum()


def hungarian(real, sim):
    return linear_sum_assignment(cdist(real - real.mean(axis=0), sim - sim.mean(axis=0)))[1]


LARGE = {
    "gaussian": lambda rng, n: (rng.normal(0, 1, (n, 3)), rng.normal(0, 1.3, (n, 3))),
    "clustered": lambda rng, n: (
        rng.normal(0, 0.1, (n, 3)) + 5 * rng.integers(0, 2, (n, 1)),
        rng.normal(2, 2, (n, 3)),
    ),
    "line against plane": lambda rng, n: (
        np.outer(np.linspace(0, 9, n), [1, 0, 0]),
        rng.uniform(0, 9, (n, 3)) * [1, 1, 0],
    ),
    "lopsided": lambda rng, n: (
        rng.normal(0, 0.05, (n, 3)) + 50 * (np.arange(n) < 9)[:, None],
        rng.normal(0, 0.05, (n, 3)) + 50 * (np.arange(n) >= 9)[:, None],
    ),
}


@pytest.mark.parametrize("shape", LARGE)
@pytest.mark.parametrize("n", [7, 401, 900])
def test_an_alignment_is_the_hungarian_one(rng, shape, n):
    real, sim = LARGE[shape](rng, n)
    np.testing.assert_array_equal(align_nodes(real, sim), hungarian(real, sim))


def test_a_large_alignment_of_many_ties_is_as_short_as_the_hungarian_one():
    grid = np.array([[x, y, 0] for x in range(22) for y in range(22)], dtype=float)
    for real, sim in ((grid, grid * 2), (np.zeros((450, 3)), np.ones((450, 3)))):
        sim_of_real = align_nodes(real, sim)
        assert sorted(sim_of_real) == list(range(len(real)))
        assert total_distance(real, sim, sim_of_real) == pytest.approx(
            total_distance(real, sim, hungarian(real, sim))
        )


def test_with_few_candidates_the_missing_ones_are_found_by_their_prices(rng, monkeypatch):
    monkeypatch.setattr(assignment, "ARCS_PER_NODE", 0)
    real, sim = rng.normal(0, 1, (600, 3)), rng.normal(0, 1.3, (600, 3))
    wanted = linear_sum_assignment(cdist(real, sim))[1]
    np.testing.assert_array_equal(assign_nodes(real, sim), wanted)


def exchanged(p, u, v):
    """The assignment but for two nodes."""
    p[[0, -1]] = p[[-1, 0]]
    return p, u, v


@pytest.mark.parametrize("shape", LARGE)
@pytest.mark.parametrize(
    "spoil",
    [
        exchanged,
        lambda p, u, v: (np.where(p == p[0], p[1], p), u, v),  # one node twice
        lambda p, u, v: (p, u - 1e-7, v),  # prices that prove less
        # prices above the cost of an arc: no proof
        lambda p, u, v: (
            p,
            u + np.eye(1, len(u), 7)[0],
            v,
        ),
        lambda p, u, v: (p, u, v * np.nan),
    ],
    ids=["two exchanged", "not one to one", "lower prices", "infeasible prices", "no prices"],
)
def test_what_the_prices_do_not_prove_is_refused(monkeypatch, rng, shape, spoil):
    solve = assignment._solve

    def spoilt(a, b, arcs, prices):
        p, prices = solve(a, b, arcs, prices)
        if len(a) == 401:  # those of fewer nodes prove nothing
            p, *prices = spoil(p, *prices)
        return p, prices

    monkeypatch.setattr(assignment, "_solve", spoilt)
    with pytest.raises(StageError, match="401"):
        assign_nodes(*LARGE[shape](rng, 401))


@pytest.mark.parametrize("n", [8, 60, 400])
def test_the_bound_of_the_literal_oracle_is_the_least_total(rng, n):
    cost = cdist(rng.normal(0, 1, (n, 3)), rng.normal(0.5, 1, (n, 3)))
    rows, columns = linear_sum_assignment(cost)
    assert literal_method.least_total(cost) == pytest.approx(
        cost[rows, columns].sum(), rel=1e-12
    )


def test_coordinates_of_utm_size_cost_no_more_rounds(monkeypatch, rng):
    a, b = rng.uniform(-20, 20, (2, 600, 3))
    utm = np.array([512_345.0, 5_412_345.0, 120.0])
    rounds = []
    solve = assignment._solve
    monkeypatch.setattr(assignment, "_solve", lambda *args: rounds.append(1) or solve(*args))
    near = assignment.assign_nodes(a, b)
    n_near = len(rounds)
    far = assignment.assign_nodes(a + utm, b + utm)
    assert len(rounds) - n_near <= n_near + 1
    np.testing.assert_array_equal(far, near)
