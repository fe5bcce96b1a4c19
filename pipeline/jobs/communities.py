"""Stage communities: the objects of a side, and which point belongs to which."""

from __future__ import annotations

import numpy as np
import pyarrow.compute as pc

from ...schemas.settings import Settings
from ...schemas.tables import COMMUNITIES, OBJECTS
from ...stages.communities import find_communities
from ...stages.objects import describe_objects, majority_labels
from ..stage import Context, Grain, Made, Stage
from .points import EDGE_COLUMNS, POINT_COLUMNS, graph_edges, object_points

_LIBRARIES = {"scikit-network": ("scikit-network",), "python-louvain": ("python-louvain", "networkx")}


def make_communities(context: Context) -> Made:
    """Finds the communities of a side's graph and describes each as an object."""
    point_ids, points = object_points(context, context.side)
    edges = graph_edges(context, context.side)
    with context.step("louvain"):
        partition = find_communities(len(points), edges, context.settings.communities)
    with context.step("describe"):
        objects = describe_objects(points, partition.labels)
        ground = context.table("ground", columns=("is_ground", "label"))
        names = ground.filter(pc.invert(ground.column("is_ground"))).column("label").to_pylist()
        labels = majority_labels(partition.labels, names)
    both = {"pair_id": context.pair_id, "side": context.side}
    communities = COMMUNITIES.build(both | {"point_id": point_ids, "community_id": partition.labels})
    columns = dict(zip(("cx", "cy", "cz"), objects.centroid.T, strict=True))
    columns |= dict(zip(("extent_x", "extent_y", "extent_z"), objects.extent.T, strict=True))
    columns |= dict(zip(("linearity", "planarity", "scattering"), objects.shape.T, strict=True))
    described = OBJECTS.build(
        both
        | columns
        | {
            "community_id": np.arange(len(objects.n_points), dtype=np.int32),
            "n_points": objects.n_points,
            "range_m": np.linalg.norm(objects.centroid, axis=1),
            "label": labels,
        }
    )
    facts = {"n_communities": len(objects.n_points), "modularity": partition.modularity}
    return Made({"communities": communities, "objects": described}, facts)


def louvain_libraries(settings: Settings) -> tuple[str, ...]:
    """What finds the communities under given settings."""
    return _LIBRARIES[settings.communities.backend]


STAGE = Stage(
    name="communities",
    takes={"ground": (*POINT_COLUMNS, "label"), "graph": EDGE_COLUMNS},
    gives=("communities", "objects"),
    settings=("communities",),
    grain=Grain.SIDE,
    version=2,
    make=make_communities,
    libraries=louvain_libraries,
)
