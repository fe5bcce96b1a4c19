import numpy as np

from fidpipe.schemas.settings import SelectionSettings
from fidpipe.stages.selection import select_nodes
from scenes import subgraph


def test_ties_in_influence_go_by_point_id():
    # In a regular ring every node has the same influence.
    angle = 2 * np.pi * np.arange(12) / 12
    ring = subgraph(np.column_stack([np.cos(angle), np.sin(angle), np.zeros(12)]), k=2)
    small = subgraph(np.random.default_rng(0).normal(0, 1, (5, 3)), k=2)
    assert select_nodes(ring, small, SelectionSettings()).real_nodes.tolist() == [0, 1, 2, 3, 4]
