"""Inputs that jobs read from tables: object points, graph by node index, matched objects as subgraphs, kept nodes."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pyarrow as pa

from ...schemas.columns import SIDES, Row
from ...stages.arrays import FloatArray, IntArray
from ...stages.linalg.subgraph import Edges, Subgraph, split_by_community
from ...stages.objects import Objects
from ...stages.pieces import CutScan
from ...stages.reference import Annotation
from ...stages.selection import Selection
from ...stages.sensor_description import SensorDescription
from ..stage import Inputs

#: What `matched_objects` reads, for the declarations of stages that call it.
MATCHED_OBJECTS = ("ground", "graph", "communities", "matching")
_POINT_COLUMNS = ("point_id", "x", "y", "z", "is_ground")


def column(table: pa.Table, name: str) -> Any:
    """A column as an array."""
    return table.column(name).to_numpy()


def object_points(inputs: Inputs, side: str) -> tuple[IntArray, FloatArray]:
    """Ids, (n,) int32, and coordinates, (n, 3) float64 metres, of the points of a side that are not ground."""
    return inputs.memo(points_in, inputs.table("ground", side))


def annotation_in(ground: pa.Table) -> Annotation:
    """Labels and instances of the object points of a side, where the input has them."""
    ground = ground.select(("is_ground", "label", "instance"))
    ground = ground.filter(pa.array(~column(ground, "is_ground")))
    labels, instances = ground.column("label"), ground.column("instance")
    return Annotation(
        None if labels.null_count == len(labels) else labels.to_numpy(zero_copy_only=False),
        None if instances.null_count else instances.to_numpy(),
    )


def matched_objects(inputs: Inputs) -> Iterator[tuple[dict[str, Any], Subgraph, Subgraph]]:
    """The objects that the job is about: each with its row of `matching`, and as a subgraph of both sides.

    For grain OBJECT they are those of its batch, else all.
    """
    matching = inputs.table("matching")
    graphs = []
    for side in SIDES:
        tables = [inputs.table(name, side) for name in ("ground", "graph", "communities")]
        with inputs.step("subgraphs"):
            graphs.append(inputs.memo(_matched_subgraphs, *tables, matching, f"{side}_id"))
    matched = _matched(matching)
    if inputs.objects:
        is_in_batch = np.isin(column(matched, "real_id"), inputs.objects)
        matched = matched.filter(pa.array(is_in_batch))
    for match in matched.to_pylist():
        yield match, graphs[0][match["real_id"]], graphs[1][match["sim_id"]]


def coordinates(table: pa.Table, name: str = "{}") -> FloatArray:
    """The coordinates of points, (n, 3) float64 metres, in columns of these names with the axis in place of {}."""
    return np.column_stack([column(table, name.format(axis)) for axis in "xyz"])


def object_columns(objects: Objects) -> Row:
    """Size and place of objects, by column of a table."""
    columns = {"n_points": objects.n_points, "range_m": objects.range_m}
    return columns | by_axis("c{}", objects.centroid) | by_axis("extent_{}", objects.extent)


def by_axis(name: str, values: FloatArray) -> Row:
    """The columns of (n, 3) values, by names with the axis in place of {}."""
    return {name.format(axis): values[:, i] for i, axis in enumerate("xyz")}


def sensor_of(inputs: Inputs, side: str) -> SensorDescription:
    """The sensor of a side, as stage sensor describes it."""
    return SensorDescription(**inputs.metadata("sensor", side)["sensor"])


def cut_scan(ground: pa.Table) -> CutScan:
    """All clean points of a side, and which of them are ground."""
    return CutScan(coordinates(ground), column(ground, "is_ground"), column(ground, "height_m"))


def points_in(ground: pa.Table) -> tuple[IntArray, FloatArray]:
    """See `object_points`."""
    ground = ground.select(_POINT_COLUMNS)
    ground = ground.filter(pa.array(~column(ground, "is_ground")))
    return column(ground, "point_id"), coordinates(ground)


def edges_in(point_ids: IntArray, graph: pa.Table) -> Edges:
    """The graph of a side by node index, its nodes being the object points in order."""
    index_of = np.zeros(int(point_ids[-1]) + 1, dtype=np.int32)
    index_of[point_ids] = np.arange(len(point_ids), dtype=np.int32)
    src = index_of[column(graph, "src")]
    dst = index_of[column(graph, "dst")]
    return Edges(src, dst, column(graph, "length_m"))


def _matched_subgraphs(
    ground: pa.Table,
    graph: pa.Table,
    communities: pa.Table,
    matching: pa.Table,
    id_column: str,
) -> dict[int, Subgraph]:
    point_ids, points = points_in(ground)
    edges = edges_in(point_ids, graph)
    labels = column(communities, "community_id")
    ids = column(_matched(matching), id_column).tolist()
    return split_by_community(point_ids, points, edges, labels, ids)


def _matched(matching: pa.Table) -> pa.Table:
    return matching.filter(pa.array(column(matching, "status") == "matched"))


def kept_nodes(selection: pa.Table, real_id: int, real: Subgraph, sim: Subgraph) -> Selection:
    """The aligned nodes of one object, as the table `selection` has them."""
    start, end = np.searchsorted(column(selection, "real_id"), [real_id, real_id + 1])
    rows = selection.slice(start, end - start)
    return Selection(
        real_nodes=np.searchsorted(real.point_ids, column(rows, "real_point_id")),
        sim_nodes=np.searchsorted(sim.point_ids, column(rows, "sim_point_id")),
        real_influence=column(rows, "real_influence"),
        sim_influence=column(rows, "sim_influence"),
    )
