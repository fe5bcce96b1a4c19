"""Nearest points of one set to those of another, independent of the order of rows."""

from __future__ import annotations

import numpy as np
import scipy

from ..arrays import FloatArray, IndexArray

_LEAF_SIZE = 20  # points; single neighbours are found a sixth faster than with ten, of which SciPy builds trees
_SLACK = 1e-9  # relative; the tree's distances may differ from ours in the last bits


def search_tree(points: FloatArray) -> scipy.spatial.cKDTree:
    """Search tree of points that is fast to build and to search for nearest points."""
    return scipy.spatial.cKDTree(points, leafsize=_LEAF_SIZE, balanced_tree=False)


def nearest_points(reference: FloatArray, points: FloatArray) -> tuple[IndexArray, FloatArray]:
    """Index and distance of each point's nearest reference point, (n,); for equal distances the first by x, y, z."""
    tree = search_tree(reference)
    distance_m, nearest = tree.query(points, k=min(2, len(reference)))
    if len(reference) == 1:
        return nearest, distance_m
    for i in np.flatnonzero(distance_m[:, 1] <= distance_m[:, 0] * (1 + _SLACK)):
        ball = np.array(tree.query_ball_point(points[i], distance_m[i, 0] * (1 + _SLACK)))
        squared = ((reference[ball] - points[i]) ** 2).sum(axis=1)
        nearest[i, 0] = ball[np.lexsort((*reference[ball].T[::-1], squared))[0]]
    return nearest[:, 0], distance_m[:, 0]
