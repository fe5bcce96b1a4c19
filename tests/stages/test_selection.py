import numpy as np

from fidpipe.schemas.settings import GraphSettings, SelectionSettings
from fidpipe.stages.graph import build_graph
from fidpipe.stages.linalg.subgraph import Subgraph, adjacency
from fidpipe.stages.selection import select_nodes


def subgraph(points, k=6):
    edges = build_graph(points, GraphSettings(k=k))
    return Subgraph(np.arange(len(points), dtype=np.int32), points, adjacency(len(points), edges))


def test_ties_in_influence_go_by_point_id():
    # In a regular ring every node has the same influence.
    angle = 2 * np.pi * np.arange(12) / 12
    ring = subgraph(np.column_stack([np.cos(angle), np.sin(angle), np.zeros(12)]), k=2)
    small = subgraph(np.random.default_rng(0).normal(0, 1, (5, 3)), k=2)
    assert select_nodes(ring, small, SelectionSettings()).real_nodes.tolist() == [0, 1, 2, 3, 4]
