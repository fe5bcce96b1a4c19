import numpy as np
from scipy import sparse

from fidpipe.schemas.settings import GraphSettings
from fidpipe.stages.graph import build_graph
from fidpipe.stages.linalg.laplacian import induced_laplacian, normalised_laplacian
from fidpipe.stages.linalg.subgraph import adjacency, split_by_community
from fidpipe.stages.literal import literal_method
from scenes import subgraph


def test_an_isolated_node_has_a_zero_row():
    A = sparse.csr_matrix(np.array([[0.0, 2, 0], [2, 0, 0], [0, 0, 0]]))
    np.testing.assert_array_equal(normalised_laplacian(A).toarray()[2], 0)


def test_the_laplacian_of_some_nodes_has_their_order_and_only_the_edges_among_them(rng):
    graph = subgraph(rng.normal(0, 1, (40, 3)))
    nodes = rng.permutation(40)[:25]
    A = graph.adjacency.toarray()[np.ix_(nodes, nodes)]
    np.testing.assert_allclose(induced_laplacian(graph, nodes).toarray(), literal_method.laplacian(A), atol=1e-15)


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
