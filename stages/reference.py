"""Decides what one object is on both sides, where the real side fixes the objects: `communities.objects = "reference"`.

The real side is divided as if there were no simulation, and each simulated point belongs to the real object at which it
lies. So two simulators are judged by the same objects, and what a simulation lacks cannot divide a real object anew.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from ..schemas.errors import StageError
from ..schemas.settings import CommunitySettings
from .arrays import FloatArray, IndexArray, IntArray
from .communities import canonical_ids, find_communities
from .linalg.subgraph import Edges, connected_pieces, connected_points

#: Where a scan has what the settings may ask for.
_WHERE = {
    "labels": "a column label, or a .label file beside the scan",
    "instances": "a column instance, or the upper 16 bits of a .label file beside the scan",
}
_SLACK = 1e-9  # relative; the tree's distances may differ from ours in the last bits


@dataclass(frozen=True)
class Annotation:
    """What the input says of the object points of a side.

    labels : (n,) class of each point, None where it has none; or None
    instances : (n,) int32, thing of each point, 0 for none; or None
    """

    labels: NDArray[np.object_] | None = None
    instances: IntArray | None = None


@dataclass(frozen=True)
class ReferenceObjects:
    """What the real side says about which objects there are.

    points : (m, 3) float64, metres, its object points, at least one
    labels : (m,) int32, object of each, ids from 0 without gaps; -1 for none
    """

    points: FloatArray
    labels: IntArray

    @property
    def n_objects(self) -> int:
        """How many there are."""
        return int(self.labels.max()) + 1


def find_reference_objects(
    points: FloatArray, edges: Edges, settings: CommunitySettings, annotation: Annotation | None = None
) -> IntArray:
    """The object of each point of the real side, (n,) int32, -1 for none; it does not depend on the order of rows.

    louvain : communities, nodes visited in the order of `visiting_order` (python-louvain draws an order of its own)
    labels : connected pieces of one label; points are connected by edges of the graph that are at most reach_m long.
        One of fewer than min_points points goes to the nearest larger piece of its label, if there is one
    instances : points of one label and one instance; those without an instance fall into pieces as above

    Of labels and instances, points of the classes in `leave_out` belong to no object, -1. Ids are by size descending,
    of equal sizes by first point in visiting order.

    Parameters
    ----------
    points : (n, 3) float64, metres, at least one
    edges : of their graph
    settings : reference, leave_out, seed, backend, reach_m, min_points
    annotation : of the same points; needed for labels and instances

    Raises
    ------
    StageError
        The real side has no labels or instances, and the settings ask for them; or all its classes are left out.
    """
    order = visiting_order(points, settings.seed)
    if settings.reference == "louvain":
        return find_communities(len(points), edges, settings, order=order).labels
    annotation = annotation or Annotation()
    wanted = getattr(annotation, settings.reference)
    if wanted is None:
        raise StageError(
            f'the real scan has no {settings.reference}, which communities.reference = "{settings.reference}" needs: '
            f"{_WHERE[settings.reference]}; or set communities.reference=louvain"
        )
    own = () if annotation.labels is None else annotation.labels
    names = ["unlabelled" if label is None else str(label) for label in own]
    classes = np.unique(names, return_inverse=True)[1].ravel() if names else np.zeros(len(points), dtype=np.intp)
    things = annotation.instances if settings.reference == "instances" else None
    things = np.zeros(len(points), dtype=np.int32) if things is None else things
    codes = np.unique(np.column_stack([classes, things]), axis=0, return_inverse=True)[1].ravel()
    pieces = _without_crumbs(points, _pieces(len(points), edges, codes, settings.reach_m), codes, settings.min_points)
    objects = canonical_ids(np.where(things > 0, len(points) + codes, pieces), order)
    kept = np.array([name.lower() not in settings.leave_out for name in names] or [True] * len(points))
    if not kept.any():
        raise StageError(
            "all object points of the real side are of classes that communities.leave_out names "
            f"({', '.join(sorted(set(names)))}); name fewer"
        )
    objects[~kept] = -1
    objects[kept] = np.unique(objects[kept], return_inverse=True)[1].ravel()
    return objects


def assign_to_reference(
    points: FloatArray, reference: ReferenceObjects, settings: CommunitySettings, link_m: float
) -> IntArray:
    """The object of each point of the simulated side: real ones by their ids, then those far from any.

    A point belongs to the object of its nearest real point (of equally near ones the first by x, y, z), or to none (-1)
    like that point, if that is at most reach_m away. Those out of reach form connected components, as surface pieces
    do: points at most link_m apart are linked. Components of at least min_points become objects of their own, points of
    smaller ones go to the object of their nearest real point.

    Parameters
    ----------
    points : (n, 3) float64, metres, simulated, at least one
    reference : points and objects of the real side
    settings : reach_m, min_points, seed
    link_m : of the settings `pieces`
    """
    nearest, distance_m = nearest_points(reference.points, points)
    labels = reference.labels[nearest].astype(np.int32)
    outside = np.flatnonzero(distance_m > settings.reach_m)
    if len(outside):
        order = visiting_order(points[outside], settings.seed)
        groups = canonical_ids(connected_points(points[outside], link_m), order)
        is_object = (np.bincount(groups) >= settings.min_points)[groups]  # the largest groups have the first ids
        labels[outside[is_object]] = reference.n_objects + groups[is_object]
    return labels


def visiting_order(points: FloatArray, seed: int) -> IntArray:
    """The points in the order of a hash of their coordinates and the seed, (n,) int32.

    Moving, adding or losing points leaves the order of the others as it is, and so does the order of rows.

    Parameters
    ----------
    points : (n, 3) float64, metres, all different
    seed : another one gives another order
    """
    from sklearn.utils import murmurhash3_32

    words = np.ascontiguousarray(points + 0.0).view(np.int32)  # -0.0 becomes 0.0
    hashed = np.zeros(len(points), dtype=np.int32)
    for column in words.T:
        hashed = murmurhash3_32(column ^ hashed, seed=seed)
    order: IntArray = np.argsort(hashed).astype(np.int32)
    if np.any(hashed[order[1:]] == hashed[order[:-1]]):
        order = np.lexsort((*points.T, hashed)).astype(np.int32)
    return order


def _pieces(n_nodes: int, edges: Edges, codes: IndexArray, reach_m: float) -> IndexArray:
    """The connected pieces of points of one code, (n,), joined by edges that are no longer than the reach."""
    joins = (codes[edges.src] == codes[edges.dst]) & (edges.length_m <= np.float32(reach_m))
    return connected_pieces(n_nodes, Edges(edges.src[joins], edges.dst[joins], edges.length_m[joins]))


def _without_crumbs(points: FloatArray, pieces: IndexArray, codes: IndexArray, min_points: int) -> IndexArray:
    """The pieces, (n,), those of fewer points joined to the nearest larger one of the same code, if there is one."""
    joined = pieces.copy()
    is_large = np.bincount(pieces)[pieces] >= min_points
    for code in np.unique(codes[~is_large]):
        large, small = (np.flatnonzero((codes == code) & chosen) for chosen in (is_large, ~is_large))
        if len(large):
            ids, of_small = np.unique(pieces[small], return_inverse=True)
            nearest, distance_m = nearest_points(points[large], points[small])
            closest = np.lexsort((*points[small].T[::-1], distance_m, of_small))
            place = np.searchsorted(of_small[closest], np.arange(len(ids)))
            joined[small] = pieces[large[nearest[closest[place]]]][of_small]
    return joined


def nearest_points(reference: FloatArray, points: FloatArray) -> tuple[IndexArray, FloatArray]:
    """Index and distance of each point's nearest reference point, (n,), of equally near ones the first by x, y, z."""
    tree = cKDTree(reference)
    distance_m, nearest = tree.query(points, k=min(2, len(reference)))
    if len(reference) == 1:
        return nearest, distance_m
    for i in np.flatnonzero(distance_m[:, 1] <= distance_m[:, 0] * (1 + _SLACK)):
        ball = np.array(tree.query_ball_point(points[i], distance_m[i, 0] * (1 + _SLACK)))
        squared = ((reference[ball] - points[i]) ** 2).sum(axis=1)
        nearest[i, 0] = ball[np.lexsort((*reference[ball].T[::-1], squared))[0]]
    return nearest[:, 0], distance_m[:, 0]
