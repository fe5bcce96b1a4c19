"""Stage graph: the edges among the object points of a side."""

from __future__ import annotations

from ...stages.graph import build_graph
from ..stage import Grain, Inputs, JobResult, Stage
from .points_job import object_points


def make_graph(inputs: Inputs) -> JobResult:
    """Connect near object points; each edge names its points by their ids."""
    point_ids, points = object_points(inputs, inputs.part)
    with inputs.step("graph"):
        edges = build_graph(points, inputs.settings.graph)
    columns = {
        "src": point_ids[edges.src],
        "dst": point_ids[edges.dst],
        "length_m": edges.length_m,
    }
    return JobResult(inputs.columns("graph", columns), {"n_edges": len(edges.src)})


STAGE = Stage(
    name="graph",
    takes=("ground",),
    gives=("graph",),
    settings=("graph",),
    grain=Grain.SIDE,
    make=make_graph,
)
