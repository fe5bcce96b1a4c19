"""Stage graph: the edges among the object points of a side."""

from __future__ import annotations

from ...schemas.tables import TABLES
from ...stages.arrays import IntArray
from ...stages.graph import build_graph
from ...stages.linalg.subgraph import Edges
from ..stage import Grain, Inputs, JobResult, Stage
from .points_job import POINT_COLUMNS, object_points


def make_graph(own: Inputs) -> JobResult:
    """Connect near object points."""
    point_ids, points = object_points(own, own.part)
    with own.step("graph"):
        edges = build_graph(points, own.settings.graph)
    return graph_result(own.pair_id, own.part, point_ids, edges)


def graph_result(pair_id: str, side: str, point_ids: IntArray, edges: Edges) -> JobResult:
    """The edges; each names its points by their ids."""
    columns = {"src": point_ids[edges.src], "dst": point_ids[edges.dst], "length_m": edges.length_m}
    rows = TABLES["graph"].build({"pair_id": pair_id, "side": side} | columns, len(edges.src))
    return JobResult({"graph": rows}, {"n_edges": len(edges.src)})


STAGE = Stage(
    name="graph",
    takes={"ground": POINT_COLUMNS},
    gives=("graph",),
    settings=("graph",),
    grain=Grain.SIDE,
    version=1,
    make=make_graph,
)
