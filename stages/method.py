"""Steps of the method that several jobs need: cutting the road, partitioning a side, comparing two sides.

The method on one screen is the list of stages in `pipeline/jobs/__init__.py`, and it is what runs.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from ..schemas.errors import StageError
from ..schemas.metric_catalogue import OBJECT_METRICS
from ..schemas.results import Number
from ..schemas.settings import SelectionSettings, Settings
from .arrays import FloatArray, IntArray, Watch, unwatched
from .clean import CleanResult, clean_scan, too_few_left
from .communities import find_communities
from .graph import build_graph
from .ground import MIN_OBJECT_POINTS, GroundResult, remove_ground
from .linalg.subgraph import Edges, Subgraph, adjacency, split_by_community
from .matching import Matching, match_communities, match_reference
from .metrics import Scores, score_object
from .objects import Objects, describe_objects
from .reference import (
    Annotation,
    ReferenceObjects,
    assign_to_reference,
    find_reference_objects,
    visiting_order,
)
from .selection import Selection, select_nodes
from .summary import summarise_pair


def remove_road(
    points: FloatArray,
    settings: Settings,
    side: str,
    *,
    T_real_sim: FloatArray | None = None,
    real_cut: GroundResult | None = None,
    real_points: FloatArray | None = None,
    watch: Watch = unwatched,
) -> tuple[CleanResult, GroundResult]:
    """The measurements of a scan in the real sensor's frame, and which of them are road.

    Parameters
    ----------
    points : (n, 3) float64, metres, in the side's own frame
    settings : of input and ground
    side : "real" or "sim"
    T_real_sim : (3, 4) float64, of the simulated side
    real_cut, real_points : for the simulated side, the real side's cut and its (m, 3) clean points; used if
        `ground.shared` or `ground.peak` require them
    watch : entered around the steps clean and ground

    Raises
    ------
    StageError
        Fewer than 8 points are left.
    """
    ground = settings.ground
    with watch("clean"):
        frame = settings.input.frame_of(side)
        clean = clean_scan(points, settings.input, frame=frame, T_real_sim=T_real_sim)
    n_left = len(clean.points)
    if n_left < MIN_OBJECT_POINTS:
        raise StageError(too_few_left(n_left, MIN_OBJECT_POINTS, clean.dropped, settings.input))
    if ground.shared:
        real_points = None
    elif ground.peak != "real":
        real_cut = None
    with watch("ground"):
        cut = remove_ground(clean.points, ground, real_cut, real_points)
    return clean, cut


def partition(
    points: FloatArray,
    settings: Settings,
    *,
    edges: Edges | None = None,
    reference: ReferenceObjects | None = None,
    annotation: Annotation | None = None,
    watch: Watch = unwatched,
) -> PartitionedScan:
    """The graph of a side's object points, its objects, and their description.

    Parameters
    ----------
    points : (n, 3) float64, metres, at least one
    settings : of the graph, the communities and the pieces
    edges : the graph of these points, where it is known already; such as for another seed of the communities
    reference : of the simulated side, the real side's objects; unused where `communities.objects` is "independent"
    annotation : for the real side, labels and instances of these points, if `communities.reference` uses them
    watch : entered around the steps louvain and describe
    """
    communities = settings.communities
    # "From Point Clouds to Graphs"
    edges = build_graph(points, settings.graph) if edges is None else edges
    # "Object-Level Decomposition via Communities"
    with watch("louvain"):
        if communities.objects == "independent":
            labels = find_communities(len(points), edges, communities)
        elif reference is None:
            labels = find_reference_objects(points, edges, communities, annotation)
        else:
            labels = assign_to_reference(points, reference, communities, settings.pieces.link_m)
    with watch("describe"):
        objects = describe(
            points,
            labels,
            settings,
            0 if reference is None else reference.n_objects,
        )
    return PartitionedScan(points, edges, labels, objects)


def describe(points: FloatArray, labels: IntArray, settings: Settings, n_ids: int = 0) -> Objects:
    """Shape and place of the objects of a side; those of reference objects are independent of the order of rows.

    Parameters
    ----------
    points : (n, 3) float64, metres
    labels : (n,) int32, object of each
    settings : of the communities
    n_ids : for reference objects, the least number of ids
    """
    if settings.communities.objects == "independent":
        return describe_objects(points, labels)
    order = visiting_order(points, seed=0)
    return describe_objects(points[order], labels[order], n_ids)


#: Scores of objects by real id, simulated id and how their nodes were selected.
Memo = dict[tuple[int, int, SelectionSettings], Scores]


def compare(
    real: PartitionedScan,
    sim: PartitionedScan,
    settings: Settings,
    *,
    memo: Memo | None = None,
) -> dict[str, Number]:
    """Match the objects of both sides and score them; returns the summary, see `summarise_pair`.

    Parameters
    ----------
    real, sim : both sides
    settings : of communities, matching and selection
    memo : scores of objects of these two sides, to be taken instead of computing them, and to be added to; give the
        same dictionary to several calls with the same two sides and other settings
    """
    # "Community Matching", Algorithm 1
    matching = match_objects(
        real.objects.centroid,
        sim.objects.centroid,
        real.objects.n_points,
        sim.objects.n_points,
        settings,
    )

    # "Heat-Kernel Node Selection", Algorithm 2, then CDC, r_gap and r_lambda of each object
    memo = {} if memo is None else memo
    unscored = [pair for pair in matching.pairs if (*pair, settings.selection) not in memo]
    real_graphs = real.subgraphs(real_id for real_id, _ in unscored)
    sim_graphs = sim.subgraphs(sim_id for _, sim_id in unscored)
    for real_id, sim_id in unscored:
        _, scores = score(real_graphs[real_id], sim_graphs[sim_id], settings.selection)
        memo[real_id, sim_id, settings.selection] = scores
    objects = [memo[*pair, settings.selection] for pair in matching.pairs]
    columns = {"centroid_distance_m": matching.distance_m}
    for name in OBJECT_METRICS:
        if name not in columns:
            columns[name] = np.array([getattr(scores, name) for scores in objects], np.float64)
    return summarise_pair(
        columns,
        [scores.status for scores in objects],
        real.objects.range_m[matching.real_ids],
        real.objects.range_m[matching.not_found],
        sim.objects.range_m[matching.extra],
    )


def match_objects(
    real: FloatArray,
    sim: FloatArray,
    n_real: IntArray,
    n_sim: IntArray,
    settings: Settings,
) -> Matching:
    """Match the objects of both sides: by centroids, or by ids if the real side determines the objects.

    Parameters
    ----------
    real, sim : (a, 3), (b, 3) float64, metres, centroids by id
    n_real, n_sim : (a,), (b,) int32, points of each
    settings : of communities and matching
    """
    if settings.communities.objects == "reference":
        return match_reference(real, sim, n_real, n_sim, settings.communities.min_points)
    return match_communities(real, sim, settings.matching)


def score(real: Subgraph, sim: Subgraph, settings: SelectionSettings) -> tuple[Selection, Scores]:
    """The aligned nodes that stand for one object on both sides (Algorithm 2), and the scores of the object.

    Parameters
    ----------
    real, sim : the object on both sides, at least one point each
    settings : diffusion time
    """
    nodes = select_nodes(real, sim, settings)
    return nodes, score_object(real, sim, nodes)


def graph_of(points: FloatArray, settings: Settings) -> Subgraph:
    """Points as one object, with the graph that they have without any others.

    Parameters
    ----------
    points : (n, 3) float64, metres
    settings : of the graph
    """
    edges = build_graph(points, settings.graph)
    return Subgraph(np.arange(len(points), dtype=np.int32), points, adjacency(len(points), edges))


@dataclass(frozen=True)
class PartitionedScan:
    """The object points of one side, with their graph and their communities.

    points : (n, 3) float64, metres
    edges : of the graph, by index into the points
    labels : (n,) int32, community of each point
    objects : shape and place of the communities, by id
    """

    points: FloatArray
    edges: Edges
    labels: IntArray
    objects: Objects

    @property
    def reference(self) -> ReferenceObjects:
        """Its objects, by which the other side is partitioned."""
        return ReferenceObjects(self.points, self.labels)

    def subgraphs(self, community_ids: Iterable[int]) -> dict[int, Subgraph]:
        """The induced subgraphs of some communities, by id; their `point_ids` are indices into the points."""
        chosen = list(community_ids)
        if not chosen:
            return {}
        ids = np.arange(len(self.points), dtype=np.int32)
        return split_by_community(ids, self.points, self.edges, self.labels, chosen)
