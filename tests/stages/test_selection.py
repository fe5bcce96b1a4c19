import numpy as np

import textbook
from fidpipe.schemas.settings import GraphSettings, SelectionSettings
from fidpipe.stages.graph import build_graph
from fidpipe.stages.linalg.subgraph import Subgraph, adjacency
from fidpipe.stages.literal import method
from fidpipe.stages.selection import select_nodes


def subgraph(points, k=6):
    edges = build_graph(points, GraphSettings(k=k))
    return Subgraph(np.arange(len(points), dtype=np.int32), points, adjacency(len(points), edges))


def test_the_most_influential_nodes_are_kept(rng):
    real, sim = subgraph(rng.normal(0, 1, (50, 3))), subgraph(rng.normal(0, 1, (35, 3)))
    chosen = select_nodes(real, sim, SelectionSettings())
    scores = np.round(method.influence(method.laplacian(real.adjacency.toarray()), 1.0), 9)
    assert chosen.real_nodes.tolist() == textbook.most_influential(scores.tolist(), 35)
    np.testing.assert_array_equal(chosen.real_influence, scores[chosen.real_nodes])
    assert sorted(chosen.sim_nodes.tolist()) == list(range(35))


def test_ties_in_influence_go_by_point_id():
    # In a regular ring every node has the same influence.
    angle = 2 * np.pi * np.arange(12) / 12
    ring = subgraph(np.column_stack([np.cos(angle), np.sin(angle), np.zeros(12)]), k=2)
    small = subgraph(np.random.default_rng(0).normal(0, 1, (5, 3)), k=2)
    assert select_nodes(ring, small, SelectionSettings()).real_nodes.tolist() == [0, 1, 2, 3, 4]
