"""Reference objects: the real side defines the objects of both sides (`communities.objects = "reference"`).

The real side is partitioned independently of the simulation, and each simulated point is assigned to the nearest real
object. So two simulators are compared by the same objects, and missing simulated points cannot split a real object.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..schemas.errors import StageError
from ..schemas.settings import CommunitySettings
from .arrays import FloatArray, IndexArray, IntArray
from .communities import canonical_ids, find_communities
from .linalg.nearest import nearest_points
from .linalg.subgraph import Edges, connected_nodes, connected_points

#: Sources of the annotations that the settings may request.
_SOURCES = {
    "labels": "a column label, or a .label file next to the scan",
    "instances": "a column instance, or the upper 16 bits of a .label file next to the scan",
}


@dataclass(frozen=True)
class Annotation:
    """Annotation of the object points of a side in the input.

    labels : (n,) class of each point, None for points without a class; or None
    instances : (n,) int32, instance of each point, 0 for none; or None
    """

    labels: NDArray[np.object_] | None = None
    instances: IntArray | None = None


@dataclass(frozen=True)
class ReferenceObjects:
    """Objects of the real side.

    points : (m, 3) float64, metres, object points, at least one
    labels : (m,) int32, object of each point, ids from 0 without gaps; -1 for none
    """

    points: FloatArray
    labels: IntArray

    @property
    def n_objects(self) -> int:
        """Number of objects."""
        return int(self.labels.max()) + 1


def find_reference_objects(
    points: FloatArray,
    edges: Edges,
    settings: CommunitySettings,
    annotation: Annotation,
) -> IntArray:
    """Object of each point of the real side, (n,) int32, -1 for none; independent of row order.

    louvain : communities, nodes visited in the order of `visiting_order` (python-louvain uses another random order)
    labels : connected components of one label; points are connected by edges of the graph of at most reach_m. A
        component of fewer than min_points points is merged into the nearest larger component of its label, if any
    instances : points of one label and one instance; points without an instance form components as above

    With labels and instances, points of the classes in `leave_out` belong to no object, -1. Ids are by size descending,
    for equal sizes by the first point in visiting order.

    Parameters
    ----------
    points : (n, 3) float64, metres, at least one
    edges : edges of their graph
    settings : reference, leave_out, seed, backend, reach_m, min_points
    annotation : of the same points, as the reference labels or instances requires it

    Raises
    ------
    StageError
        The settings request labels or instances that the real side does not have, or all its classes are left out.
    """
    order = visiting_order(points, settings.seed)
    if settings.reference == "louvain":
        return find_communities(len(points), edges, settings, order=order)
    if getattr(annotation, settings.reference) is None:
        raise StageError(
            f'the real scan has no {settings.reference}, which communities.reference = "{settings.reference}" needs: '
            f"{_SOURCES[settings.reference]}; or set communities.reference=louvain"
        )
    names = [""] * len(points)
    if annotation.labels is not None:
        names = ["unlabelled" if label is None else str(label) for label in annotation.labels]
    _, classes = np.unique(names, return_inverse=True)
    instances = np.zeros(len(points), dtype=np.int32)
    if settings.reference == "instances" and annotation.instances is not None:
        instances = annotation.instances
    codes = instances * (classes.max() + 1) + classes
    components = _components(len(points), edges, codes, settings.reach_m)
    components = _merge_small(points, components, codes, settings.min_points)
    objects = canonical_ids(np.where(instances > 0, len(points) + codes, components), order)
    kept = np.array([name.lower() not in settings.leave_out for name in names])
    if not kept.any():
        raise StageError(
            "communities.leave_out excludes the classes of all object points of the real side "
            f"({', '.join(sorted(set(names)))}); exclude fewer classes"
        )
    objects[~kept] = -1
    objects[kept] = np.unique(objects[kept], return_inverse=True)[1]
    return objects


def assign_to_reference(
    points: FloatArray,
    reference: ReferenceObjects,
    settings: CommunitySettings,
    link_m: float,
) -> IntArray:
    """Object of each point of the simulated side: the ids of real objects, then those of extra ones.

    A point with its nearest real point (for equal distances the first by x, y, z) at most reach_m away belongs to the
    object of that point, or like it to none (-1). Points out of reach form connected components, as surface pieces do:
    points at most link_m apart are linked. Components of at least min_points become separate objects; points of smaller
    ones go to the object of their nearest real point.

    Parameters
    ----------
    points : (n, 3) float64, metres, simulated, at least one
    reference : points and objects of the real side
    settings : reach_m, min_points, seed
    link_m : setting pieces.link_m
    """
    nearest, distance_m = nearest_points(reference.points, points)
    labels = reference.labels[nearest].astype(np.int32)
    outside = np.flatnonzero(distance_m > settings.reach_m)
    if len(outside):
        order = visiting_order(points[outside], settings.seed)
        groups = canonical_ids(connected_points(points[outside], link_m), order)
        # The largest groups have the first ids.
        is_object = (np.bincount(groups) >= settings.min_points)[groups]
        labels[outside[is_object]] = reference.n_objects + groups[is_object]
    return labels


def visiting_order(points: FloatArray, seed: int) -> IntArray:
    """Indices of the points ordered by a hash of their coordinates and the seed, (n,) int32.

    Moving, adding or removing points does not change the order of the others; neither does the order of rows.

    Parameters
    ----------
    points : (n, 3) float64, metres, all different
    seed : seed of the hash
    """
    from sklearn.utils import murmurhash3_32

    bits = np.ascontiguousarray(points + 0.0).view(np.int32)  # -0.0 becomes 0.0
    hashed = np.zeros(len(points), dtype=np.int32)
    for column in bits.T:
        hashed = murmurhash3_32(column ^ hashed, seed=seed)
    order: IntArray = np.argsort(hashed).astype(np.int32)
    hashed_in_order = hashed[order]
    is_tied = np.isin(hashed_in_order, hashed_in_order[1:][np.diff(hashed_in_order) == 0])
    tied = order[is_tied]
    order[is_tied] = tied[np.lexsort((*points[tied].T, hashed[tied]))]
    return order


def _components(n_nodes: int, edges: Edges, codes: IndexArray, reach_m: float) -> IndexArray:
    """Connected components of points with the same code, (n,), connected by edges of at most the reach."""
    kept = (codes[edges.src] == codes[edges.dst]) & (edges.length_m <= np.float32(reach_m))
    return connected_nodes(n_nodes, edges.src[kept], edges.dst[kept])


def _merge_small(
    points: FloatArray,
    components: IndexArray,
    codes: IndexArray,
    min_points: int,
) -> IndexArray:
    """Merge small components, (n,), into the nearest larger component of the same code, if any."""
    merged = components.copy()
    is_large = np.bincount(components)[components] >= min_points
    for code in np.unique(codes[~is_large]):
        is_code = codes == code
        large = np.flatnonzero(is_code & is_large)
        small = np.flatnonzero(is_code & ~is_large)
        if len(large):
            nearest, distance_m = nearest_points(points[large], points[small])
            by_distance = np.lexsort((*points[small].T[::-1], distance_m))
            small = small[by_distance]
            _, first, of_small = np.unique(
                components[small],
                return_index=True,
                return_inverse=True,
            )
            closest = large[nearest[by_distance[first]]]
            merged[small] = components[closest][of_small]
    return merged
