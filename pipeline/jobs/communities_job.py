"""Stage communities: the objects of a side, and which point belongs to which."""

from __future__ import annotations

import numpy as np

from ...schemas.settings import Settings
from ...stages.arrays import IntArray
from ...stages.method import PartitionedScan, partition
from ...stages.objects import majority_labels
from ...stages.reference import Annotation, ReferenceObjects
from ..stage import Columns, Grain, Inputs, JobResult, Stage
from .points_job import (
    ANNOTATED_COLUMNS,
    EDGE_COLUMNS,
    POINT_COLUMNS,
    annotation_in,
    column,
    graph_edges,
    object_columns,
    object_points,
)


def make_communities(inputs: Inputs) -> JobResult:
    """Find the objects of a side and describe each.

    The real side's come from its graph or its annotation; the simulated side's from its inputs
    graph, or from the real side's objects where the settings say so.
    """
    point_ids, points = object_points(inputs, inputs.part)
    noted = annotation_in(inputs.table("ground", inputs.part))
    reference = None
    if ("communities", "real") in inputs.tables:
        labels = column(inputs.table("communities", "real"), "community_id")
        reference = ReferenceObjects(object_points(inputs, "real")[1], labels)
    scan = partition(
        points,
        inputs.settings,
        edges=graph_edges(inputs, inputs.part),
        reference=reference,
        annotation=noted,
        watch=inputs.step,
    )
    return _result(inputs, point_ids, scan, noted)


def _result(
    inputs: Inputs, point_ids: IntArray, scan: PartitionedScan, noted: Annotation
) -> JobResult:
    """The object of each point, and a row for each object."""
    objects = scan.objects
    names = [None] * len(point_ids) if noted.labels is None else noted.labels.tolist()
    labels = majority_labels(scan.labels, names, len(objects.n_points))
    columns = object_columns(objects) | {
        "community_id": np.arange(len(objects.n_points)),
        "label": labels,
    }
    for name, values in zip(("linearity", "planarity", "scattering"), objects.shape.T, strict=True):
        columns[name] = values
    of_points = {"point_id": point_ids, "community_id": scan.labels}
    tables = {
        "communities": inputs.columns("communities", of_points),
        "objects": inputs.columns("objects", columns),
    }
    return JobResult(tables)


def _takes_real(settings: Settings) -> Columns:
    if settings.communities.objects == "independent":
        return {}
    return {"ground": POINT_COLUMNS, "communities": ("community_id",)}


STAGE = Stage(
    name="communities",
    takes={"ground": ANNOTATED_COLUMNS, "graph": EDGE_COLUMNS},
    gives=("communities", "objects"),
    settings=("communities", "pieces"),
    grain=Grain.SIDE,
    version=3,
    make=make_communities,
    libraries=("scikit-network", "python-louvain", "networkx", "scikit-learn"),
    takes_real=_takes_real,
)
