"""The stages from the graph on, on points in memory: an altered scan, or a scan under other settings.

Leaves to others: where the points come from, and which scores are kept (`perturb_jobs`, `ablate_jobs`).
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from ...schemas.settings import Settings
from ...stages.arrays import FloatArray, IntArray
from ...stages.communities import adjacency, find_communities
from ...stages.graph import Edges, build_graph
from ...stages.linalg.laplacian import Subgraph, split_by_community
from ...stages.metrics import Scores, score_object
from ...stages.objects import describe_objects
from ...stages.selection import select_nodes


@dataclass(frozen=True)
class PartitionedScan:
    """Object points with their graph and their communities.

    points : (n, 3) float64, metres
    edges : of the graph
    labels : (n,) int32, community of each point
    centroids : (c, 3) float64, metres, by community id
    """

    points: FloatArray
    edges: Edges
    labels: IntArray
    centroids: FloatArray

    def objects(self, wanted: Iterable[int]) -> dict[int, Subgraph]:
        """The induced subgraphs of some communities."""
        ids = np.arange(len(self.points), dtype=np.int32)
        return split_by_community(ids, self.points, self.edges, self.labels, wanted)


def partition(points: FloatArray, settings: Settings) -> PartitionedScan:
    """The graph of object points and its communities."""
    edges = build_graph(points, settings.graph)
    labels = find_communities(len(points), edges, settings.communities).labels
    return PartitionedScan(points, edges, labels, describe_objects(points, labels).centroid)


def graph_of(points: FloatArray, settings: Settings) -> Subgraph:
    """Points as one object: the graph of these alone."""
    ids = np.arange(len(points), dtype=np.int32)
    return Subgraph(ids, points, adjacency(len(points), build_graph(points, settings.graph)))


def score(real: Subgraph, sim: Subgraph, settings: Settings) -> Scores:
    """The scores of one object on both sides."""
    return score_object(real, sim, select_nodes(real, sim, settings.selection))
