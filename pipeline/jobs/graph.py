"""Stage graph: the edges among the object points of a side."""

from __future__ import annotations

from ...schemas.tables import GRAPH
from ...stages.graph import build_graph
from ..stage import Context, Grain, Made, Stage
from .points import POINT_COLUMNS, object_points


def make_graph(context: Context) -> Made:
    """Joins near object points; an edge names its points by their ids."""
    point_ids, points = object_points(context, context.side)
    with context.step("graph"):
        edges = build_graph(points, context.settings.graph)
    rows = GRAPH.build(
        {
            "pair_id": context.pair_id,
            "side": context.side,
            "src": point_ids[edges.src],
            "dst": point_ids[edges.dst],
            "length_m": edges.length_m,
        },
        len(edges.src),
    )
    return Made({"graph": rows}, {"n_edges": len(edges.src)})


STAGE = Stage(
    name="graph",
    takes={"ground": POINT_COLUMNS},
    gives=("graph",),
    settings=("graph",),
    grain=Grain.SIDE,
    version=1,
    make=make_graph,
)
