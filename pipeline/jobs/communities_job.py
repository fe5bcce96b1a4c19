"""Stage communities: the objects of a side, and which point belongs to which."""

from __future__ import annotations

from typing import Any

import numpy as np

from ...schemas.settings import Settings
from ...schemas.tables import TABLES
from ...stages.arrays import IntArray
from ...stages.method import PartitionedScan, partition
from ...stages.objects import majority_labels
from ...stages.reference import Annotation, ReferenceObjects
from ..stage import Columns, Grain, Inputs, JobResult, Stage
from .points_job import (
    ANNOTATED_COLUMNS,
    EDGE_COLUMNS,
    POINT_COLUMNS,
    annotation,
    column,
    graph_edges,
    nulls_for_nan,
    object_points,
)

_MEASURES = (
    *("cx", "cy", "cz", "extent_x", "extent_y", "extent_z"),
    *("linearity", "planarity", "scattering", "range_m"),
)


def make_communities(own: Inputs) -> JobResult:
    """Find the objects of a side and describe each.

    The real side's come from its graph or its annotation; the simulated side's from its own graph, or from the real
    side's objects where the settings say so.
    """
    point_ids, points = object_points(own, own.part)
    noted, reference = annotation(own, own.part), None
    if ("communities", "real") in own.tables:
        labels = column(own.table("communities", "real"), "community_id")
        reference = ReferenceObjects(object_points(own, "real")[1], labels)
    scan = partition(
        points,
        own.settings,
        edges=graph_edges(own, own.part),
        reference=reference,
        annotation=noted,
        watch=own.step,
    )
    return _result(own, point_ids, scan, noted)


def _result(own: Inputs, point_ids: IntArray, scan: PartitionedScan, noted: Annotation) -> JobResult:
    """The object of each point, and a row for each object."""
    objects = scan.objects
    names = [None] * len(point_ids) if noted.labels is None else noted.labels.tolist()
    labels = majority_labels(scan.labels, names, len(objects.n_points))
    both = {"pair_id": own.pair_id, "side": own.part}
    communities = TABLES["communities"].build(both | {"point_id": point_ids, "community_id": scan.labels})
    measures = np.column_stack([objects.centroid, objects.extent, objects.shape, objects.range_m])
    columns: dict[str, Any] = {
        name: nulls_for_nan(values.tolist()) for name, values in zip(_MEASURES, measures.T, strict=True)
    }
    columns |= {"community_id": np.arange(len(objects.n_points), dtype=np.int32), "n_points": objects.n_points}
    described = TABLES["objects"].build(both | columns | {"label": labels})
    return JobResult({"communities": communities, "objects": described})


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
