"""Surface pieces: connected parts of one side's objects where the other side has nothing, and which of them moved.

A lost car is one missing piece even if Louvain puts it into one community with the hedge behind it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy

from ..schemas.results import Number
from ..schemas.settings import PieceSettings
from .arrays import BoolArray, FloatArray, IndexArray, IntArray, azimuths_deg
from .communities import canonical_ids
from .linalg.nearest import search_tree
from .linalg.subgraph import connected_points
from .objects import Objects, describe_objects

#: A missing and an invented piece can be one object that moved if their centroids are at most this far apart ...
MOVED_WITHIN_M = 3.0
#: ... and if their extents differ, along each axis, by at most this or by a third of the larger one.
SIZE_SLACK_M = 0.5
SIZE_SLACK = 1 / 3
_ROUNDED_DIGITS = 9
_ROUNDING_M = 1e-6  #: two distances that differ by less are equal


@dataclass(frozen=True)
class CutScan:
    """All clean points of one side.

    points : (n, 3) float64, metres, in the real sensor's frame
    is_ground : (n,) bool
    height_m : (n,) float64, height above the road of the side
    """

    points: FloatArray
    is_ground: BoolArray
    height_m: FloatArray


@dataclass(frozen=True)
class Pieces:
    """Pieces of one side, by id: by decreasing size, for equal sizes by x, y, z.

    labels : (n,) int32, piece of each clean point, -1 for none
    share : share of the side's object points that are in a piece
    objects : number of points, centroid, extent and range of each piece
    height_m : (c,) float64, height of the lowest point above the road
    partner : (c,) int32, piece of the other side to (or from) which it moved; -1 for none
    moved_m : (c, 3) float64, vector from the real to the simulated piece; NaN for none
    """

    labels: IntArray
    share: float
    objects: Objects
    height_m: FloatArray
    partner: IntArray
    moved_m: FloatArray

    @property
    def bearing_deg(self) -> FloatArray:
        """Direction of the centroid, (c,) float64: 0 ahead, positive to the left, -180 to 180."""
        return azimuths_deg(self.objects.centroid)


def find_pieces(real: CutScan, sim: CutScan, settings: PieceSettings) -> tuple[Pieces, Pieces]:
    """Find missing pieces of the real side and invented pieces of the simulated side.

    A piece is a connected component (points at most link_m apart are linked) of at least min_points of those object
    points p of a side with min_q |p - q| > reach_m over all points q of the other side, ground included. So a strip of
    road that only one side's cut removed is not a piece.

    A missing and an invented piece are one object that *moved* if their centroids are at most 3 m apart, their extents
    differ along each axis by at most max(0.5 m, a third of the larger), and each is the other's nearest such piece (for
    equal distances the smaller id). These are definitions of fidpipe.

    Parameters
    ----------
    real, sim : all clean points of both sides, at least one object point each
    settings : reach_m, link_m, min_points
    """
    labels_real = label_pieces(real, sim, settings)
    labels_sim = label_pieces(sim, real, settings)
    missing = _describe(real.points, labels_real)
    invented = _describe(sim.points, labels_sim)
    missing_ids, invented_ids = _match_moved(missing, invented)
    moved_m = invented.centroid[invented_ids] - missing.centroid[missing_ids]
    return (
        _pieces(real, labels_real, missing, missing_ids, invented_ids, moved_m),
        _pieces(sim, labels_sim, invented, invented_ids, missing_ids, moved_m),
    )


def _pieces(
    side: CutScan,
    labels: IntArray,
    objects: Objects,
    ids: IndexArray,
    partner_ids: IndexArray,
    moved_m: FloatArray,
) -> Pieces:
    """Pieces of a side; those of these ids have moved, from or to those of the other side."""
    n = len(objects.n_points)
    partner = np.full(n, -1, np.int32)
    partner[ids] = partner_ids
    moved = np.full((n, 3), np.nan)
    moved[ids] = moved_m
    is_in = labels >= 0
    lowest_m = np.full(n, np.inf)
    np.minimum.at(lowest_m, labels[is_in], side.height_m[is_in])
    share = int(objects.n_points.sum()) / int(np.count_nonzero(~side.is_ground))
    return Pieces(labels, share, objects, lowest_m, partner, moved)


def count_pieces(missing: Pieces, invented: Pieces) -> dict[str, Number]:
    """Number of pieces of both sides and their share of the object points, by column of `pairs`."""
    return {
        "n_missing_pieces": len(missing.partner),
        "n_invented_pieces": len(invented.partner),
        "missing_pieces_share": missing.share,
        "invented_pieces_share": invented.share,
    }


def label_pieces(side: CutScan, other: CutScan, settings: PieceSettings) -> IntArray:
    """Piece of each clean point of a side, (n,) int32, -1 for none."""
    labels = np.full(len(side.points), -1, dtype=np.int32)
    objects = np.flatnonzero(~side.is_ground)
    distance_m, _ = search_tree(other.points).query(side.points[objects])
    uncovered = objects[distance_m > settings.reach_m]
    uncovered = uncovered[np.lexsort(side.points[uncovered].T[::-1])]
    ids = canonical_ids(connected_points(side.points[uncovered], settings.link_m))
    is_large = np.bincount(ids)[ids] >= settings.min_points  # the largest have the first ids
    labels[uncovered[is_large]] = ids[is_large]
    return labels


def _describe(points: FloatArray, labels: IntArray) -> Objects:
    """Size and place of the pieces of a side; independent of row order to the last bit."""
    inside = np.flatnonzero(labels >= 0)
    if not len(inside):
        nothing = np.empty((0, 3))
        return Objects(np.empty(0, dtype=np.int32), nothing, nothing, nothing)
    inside = inside[np.lexsort(points[inside].T[::-1])]
    return describe_objects(points[inside], labels[inside])


def _match_moved(missing: Objects, invented: Objects) -> tuple[IndexArray, IndexArray]:
    """Ids, (m,) and (m,), of missing and invented pieces that are each other's nearest of similar size."""
    tree = scipy.spatial.cKDTree(missing.centroid)
    other = scipy.spatial.cKDTree(invented.centroid)
    near = tree.sparse_distance_matrix(
        other, MOVED_WITHIN_M + _ROUNDING_M, output_type="ndarray"
    )
    i = near["i"]
    j = near["j"]
    apart_m = np.round(near["v"], _ROUNDED_DIGITS)
    a = missing.extent[i]
    b = invented.extent[j]
    slack_m = np.maximum(SIZE_SLACK_M, SIZE_SLACK * np.maximum(a, b))
    is_similar = (np.abs(a - b) <= slack_m).all(axis=1)
    chosen = np.lexsort((j, i, apart_m))
    chosen = chosen[(is_similar & (apart_m <= MOVED_WITHIN_M))[chosen]]
    _, first_of_i = np.unique(i[chosen], return_index=True)
    _, first_of_j = np.unique(j[chosen], return_index=True)
    both = chosen[np.intersect1d(first_of_i, first_of_j)]
    return i[both], j[both]
