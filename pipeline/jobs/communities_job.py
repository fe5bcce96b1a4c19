"""Stage communities: the objects of a side, and which point belongs to which."""

from __future__ import annotations

import numpy as np

from ...schemas.columns import Row
from ...schemas.settings import Settings
from ...stages.arrays import IntArray
from ...stages.communities import find_communities
from ...stages.objects import Objects, describe_objects, majority_labels
from ...stages.reference import (
    Annotation,
    ReferenceObjects,
    assign_to_reference,
    find_reference_objects,
    visiting_order,
)
from ..stage import Grain, Inputs, JobResult, Stage
from .points_job import (
    annotation_in,
    column,
    edges_in,
    object_columns,
    object_points,
)


def make_communities(inputs: Inputs) -> JobResult:
    """Find the objects of a side and describe each.

    Those of the real side come from its graph or its annotation; those of the simulated side from
    its graph, or from the real side's objects where the settings say so.
    """
    point_ids, points = object_points(inputs, inputs.part)
    noted = annotation_in(inputs.table("ground", inputs.part))
    reference = None
    if ("communities", "real") in inputs.tables:
        labels = column(inputs.table("communities", "real"), "community_id")
        reference = ReferenceObjects(object_points(inputs, "real")[1], labels)
    settings = inputs.settings.communities
    edges = edges_in(point_ids, inputs.table("graph", inputs.part))
    with inputs.step("louvain"):
        if settings.objects == "independent":
            labels = find_communities(len(points), edges, settings)
        elif reference is None:
            labels = find_reference_objects(points, edges, settings, noted)
        else:
            link_m = inputs.settings.pieces.link_m
            labels = assign_to_reference(points, reference, settings, link_m)
    with inputs.step("describe"):
        if settings.objects == "independent":
            objects = describe_objects(points, labels)
        else:  # independent of the order of rows
            order = visiting_order(points, seed=0)
            n_ids = reference.n_objects if reference else 0
            objects = describe_objects(points[order], labels[order], n_ids)
    of_points = {"point_id": point_ids, "community_id": labels}
    tables = inputs.columns("communities", of_points)
    return JobResult(tables | inputs.columns("objects", _columns(objects, labels, noted)))


def _columns(objects: Objects, community: IntArray, noted: Annotation) -> Row:
    """One row per object."""
    names = [None] * len(community) if noted.labels is None else noted.labels.tolist()
    columns = object_columns(objects) | {
        "community_id": np.arange(len(objects.n_points)),
        "label": majority_labels(community, names, len(objects.n_points)),
    }
    shape = zip(("linearity", "planarity", "scattering"), objects.shape.T, strict=True)
    return columns | dict(shape)


def _takes_real(settings: Settings) -> tuple[str, ...]:
    is_independent = settings.communities.objects == "independent"
    return () if is_independent else ("ground", "communities")


STAGE = Stage(
    name="communities",
    takes=("ground", "graph"),
    gives=("communities", "objects"),
    settings=("communities", "pieces"),
    grain=Grain.SIDE,
    version=3,
    make=make_communities,
    libraries=("scikit-network", "python-louvain", "networkx", "scikit-learn"),
    takes_real=_takes_real,
)
