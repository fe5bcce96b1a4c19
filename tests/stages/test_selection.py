import numpy as np
import pytest
from scipy import sparse
from scipy.optimize import linear_sum_assignment
from scipy.spatial.distance import cdist

import literal
from fidpipe.schemas.settings import GraphSettings, SelectionSettings
from fidpipe.stages.communities import adjacency
from fidpipe.stages.graph import build_graph
from fidpipe.stages.linalg.assignment import align_nodes
from fidpipe.stages.linalg.laplacian import Subgraph, normalised_laplacian, split_by_community
from fidpipe.stages.selection import heat_row_sums, select_nodes


def subgraph(points, k=6):
    edges = build_graph(points, GraphSettings(k=k))
    return Subgraph(np.arange(len(points), dtype=np.int32), points, adjacency(len(points), edges))


def test_the_laplacian_agrees_with_its_formula(rng):
    graph = subgraph(rng.normal(0, 1, (40, 3)))
    np.testing.assert_allclose(
        normalised_laplacian(graph.adjacency).toarray(), literal.laplacian(graph.adjacency.toarray()), atol=1e-15
    )


def test_an_isolated_node_has_a_zero_row():
    A = sparse.csr_matrix(np.array([[0.0, 2, 0], [2, 0, 0], [0, 0, 0]]))
    np.testing.assert_array_equal(normalised_laplacian(A).toarray()[2], 0)


@pytest.mark.parametrize("t", [0.1, 1.0, 7.0, 100.0])
def test_the_heat_row_sums_agree_with_the_dense_exponential(rng, t):
    A = subgraph(rng.normal(0, 1, (60, 3))).adjacency.toarray()
    A[0, :] = A[:, 0] = 0  # and one isolated node
    L = normalised_laplacian(sparse.csr_matrix(A))
    np.testing.assert_allclose(heat_row_sums(L, t), literal.scipy.linalg.expm(-t * L.toarray()).sum(axis=1), atol=1e-12)


def test_the_most_influential_nodes_are_kept(rng):
    real, sim = subgraph(rng.normal(0, 1, (50, 3))), subgraph(rng.normal(0, 1, (35, 3)))
    chosen = select_nodes(real, sim, SelectionSettings())
    scores = literal.influence(literal.laplacian(real.adjacency.toarray()), 1.0)
    assert chosen.real_nodes.tolist() == literal.keep(scores.tolist(), 35)
    np.testing.assert_array_equal(chosen.real_influence, scores[chosen.real_nodes])
    assert sorted(chosen.sim_nodes.tolist()) == list(range(35))


def test_ties_in_influence_go_by_point_id():
    # In a regular ring every node has the same influence.
    angle = 2 * np.pi * np.arange(12) / 12
    ring = subgraph(np.column_stack([np.cos(angle), np.sin(angle), np.zeros(12)]), k=2)
    small = subgraph(np.random.default_rng(0).normal(0, 1, (5, 3)), k=2)
    assert select_nodes(ring, small, SelectionSettings()).real_nodes.tolist() == [0, 1, 2, 3, 4]


@pytest.mark.parametrize("seed", range(8))
def test_the_alignment_is_the_best_of_all(seed):
    rng = np.random.default_rng(seed)
    real, sim = rng.normal(0, 1, (7, 3)), rng.normal(5, 1, (7, 3))
    total, best = literal.align(real, sim)
    found = align_nodes(real, sim)
    assert total_distance(real, sim, found) == pytest.approx(total)
    assert found.tolist() == list(best)


def total_distance(real, sim, sim_of_real):
    a, b = real - real.mean(axis=0), sim - sim.mean(axis=0)
    return np.linalg.norm(a - b[sim_of_real], axis=1).sum()


def hungarian(real, sim):
    return linear_sum_assignment(cdist(real - real.mean(axis=0), sim - sim.mean(axis=0)))[1]


LARGE = {
    "gaussian": lambda rng, n: (rng.normal(0, 1, (n, 3)), rng.normal(0, 1.3, (n, 3))),
    "clustered": lambda rng, n: (rng.normal(0, 0.1, (n, 3)) + 5 * rng.integers(0, 2, (n, 1)), rng.normal(2, 2, (n, 3))),
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
@pytest.mark.parametrize("n", [401, 900])
def test_a_large_alignment_is_the_hungarian_one(rng, shape, n):
    real, sim = LARGE[shape](rng, n)
    np.testing.assert_array_equal(align_nodes(real, sim), hungarian(real, sim))


def test_a_large_alignment_of_many_ties_is_as_short_as_the_hungarian_one():
    grid = np.array([[x, y, 0] for x in range(22) for y in range(22)], dtype=float)
    for real, sim in ((grid, grid * 2), (np.zeros((450, 3)), np.ones((450, 3)))):
        found = align_nodes(real, sim)
        assert sorted(found) == list(range(len(real)))
        assert total_distance(real, sim, found) == pytest.approx(total_distance(real, sim, hungarian(real, sim)))


def test_with_few_candidates_the_missing_ones_are_found_by_their_prices(rng, monkeypatch):
    monkeypatch.setattr("fidpipe.stages.linalg.assignment._ARCS_A_NODE", 2)
    real, sim = rng.normal(0, 1, (600, 3)), rng.normal(0, 1.3, (600, 3))
    np.testing.assert_array_equal(align_nodes(real, sim), hungarian(real, sim))


def test_the_alignment_undoes_a_shuffle_and_a_shift(rng):
    points, order = rng.normal(0, 1, (80, 3)), rng.permutation(80)
    np.testing.assert_array_equal(order[align_nodes(points, (points + [30, -4, 2])[order])], np.arange(80))


def test_a_subgraph_has_the_edges_among_its_own_points(rng):
    points = rng.normal(0, 1, (60, 3))
    edges = build_graph(points, GraphSettings(k=7))
    labels = rng.integers(0, 3, 60).astype(np.int32)
    ids = np.arange(60, dtype=np.int32) * 2 + 5
    A = adjacency(60, edges).toarray()
    for community, graph in split_by_community(ids, points, edges, labels, [0, 2]).items():
        members = np.flatnonzero(labels == community)
        np.testing.assert_array_equal(graph.point_ids, ids[members])
        np.testing.assert_array_equal(graph.adjacency.toarray(), A[np.ix_(members, members)])
