"""Stage communities: the objects of a side, and which point belongs to which."""

from __future__ import annotations

from typing import Any

import numpy as np

from ...schemas.settings import Settings
from ...schemas.tables import COMMUNITIES, OBJECTS
from ...stages.method import partition
from ...stages.objects import majority_labels
from ...stages.reference import ReferenceObjects
from ..stage import Context, Grain, Made, Stage
from .points import ANNOTATED_COLUMNS, EDGE_COLUMNS, annotation, column, graph_edges, nulls_for_nan, object_points

_LIBRARIES = {"scikit-network": ("scikit-network",), "python-louvain": ("python-louvain", "networkx")}
_MEASURES = (
    *("cx", "cy", "cz", "extent_x", "extent_y", "extent_z"),
    *("linearity", "planarity", "scattering", "range_m"),
)


def make_communities(context: Context) -> Made:
    """Finds the objects of a side and describes each.

    The real side's come from its graph or its annotation; the simulated side's from its own graph, or from the real
    side's objects where the settings say so.
    """
    point_ids, points = object_points(context, context.side)
    noted = annotation(context, context.side)
    scan = partition(
        points,
        context.settings,
        edges=graph_edges(context, context.side),
        reference=_real_objects(context) if context.needs_real else None,
        annotation=noted,
        watch=context.step,
    )
    objects = scan.objects
    names = [None] * len(points) if noted.labels is None else noted.labels.tolist()
    labels = majority_labels(scan.labels, names, len(objects.n_points))
    both = {"pair_id": context.pair_id, "side": context.side}
    communities = COMMUNITIES.build(both | {"point_id": point_ids, "community_id": scan.labels})
    measures = np.column_stack([objects.centroid, objects.extent, objects.shape, objects.range_m])
    columns: dict[str, Any] = {
        name: nulls_for_nan(values.tolist()) for name, values in zip(_MEASURES, measures.T, strict=True)
    }
    columns |= {"community_id": np.arange(len(objects.n_points), dtype=np.int32), "n_points": objects.n_points}
    described = OBJECTS.build(both | columns | {"label": labels})
    return Made({"communities": communities, "objects": described})


def _real_objects(context: Context) -> ReferenceObjects:
    """The points of the real side and the object of each."""
    _, points = object_points(context, "real")
    return ReferenceObjects(points, column(context.table("communities", "real", ("community_id",)), "community_id"))


def _is_reference(settings: Settings) -> bool:
    return settings.communities.objects == "reference"


def louvain_libraries(settings: Settings) -> tuple[str, ...]:
    """What finds the communities under given settings."""
    hashing = ("scikit-learn",) if _is_reference(settings) else ()
    return (*_LIBRARIES[settings.communities.backend], *hashing)


STAGE = Stage(
    name="communities",
    takes={"ground": ANNOTATED_COLUMNS, "graph": EDGE_COLUMNS},
    gives=("communities", "objects"),
    settings=("communities", "pieces"),
    grain=Grain.SIDE,
    version=3,
    make=make_communities,
    libraries=louvain_libraries,
    needs_real=_is_reference,
)
