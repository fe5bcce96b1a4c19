"""Agreement of a model's predictions on both sides of a pair: classes of points, and boxes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .arrays import BoolArray, FloatArray, IndexArray
from .matching import most_pairs

#: Boxes of one class are the same if their centres are at most this far apart.
SAME_WITHIN_M = 2.0


@dataclass(frozen=True)
class Boxes:
    """Detections of one side.

    names : (m,) class of each
    centre : (m, 3) metres, in the real sensor's frame
    size : (m, 3) length, width and height, metres
    yaw : (m,) direction of the length, radians, 0 along x, counter-clockwise
    """

    names: NDArray[np.str_]
    centre: FloatArray
    size: FloatArray
    yaw: FloatArray


def match_detections(real: Boxes, sim: Boxes) -> IndexArray:
    """The simulated box of each real box, (m,); -1 for none.

    One to one, of equal classes, with horizontal distances of the centres of at most 2 m, as in the
    detection benchmark of nuScenes (Caesar et al., CVPR 2020); as many as possible at the least
    total distance.
    """
    offset = real.centre[:, None, :2] - sim.centre[None, :, :2]
    distance_m = np.hypot(offset[..., 0], offset[..., 1])
    is_one_class = real.names[:, None] == sim.names[None, :]
    is_same = is_one_class & (distance_m <= SAME_WITHIN_M)
    rows, columns = most_pairs(distance_m, is_same, SAME_WITHIN_M).T
    partner = np.full(len(real.names), -1)
    partner[rows] = columns
    return partner


def inside(points: FloatArray, boxes: Boxes, number: int) -> BoolArray:
    """True for the points inside a box, (n,)."""
    offset = points - boxes.centre[number]
    c = np.cos(boxes.yaw[number])
    s = np.sin(boxes.yaw[number])
    along = offset[:, 0] * c + offset[:, 1] * s
    across = offset[:, 1] * c - offset[:, 0] * s
    local = np.column_stack([along, across, offset[:, 2]])
    return np.all(np.abs(local) <= boxes.size[number] / 2, axis=1)


def lost_auc(scores: FloatArray, is_lost: BoolArray) -> float | None:
    """Probability that a lost object has a larger score than one that is kept; ties count half.

    None if no object, or every object, is lost.

    Examples
    --------
    >>> lost_auc(np.array([0.1, 0.4, 0.2]), np.array([False, True, False]))
    1.0
    """
    from sklearn.metrics import roc_auc_score

    if is_lost.all() or not is_lost.any():
        return None
    return float(roc_auc_score(is_lost, scores))


def jackknife_interval(
    scores: FloatArray,
    is_lost: BoolArray,
    scan_of: IndexArray,
) -> tuple[float, float] | None:
    """95 % interval of `lost_auc` by leaving out one scan at a time; None for fewer than three.

    se^2 = (k - 1) / k sum (a_i - mean a)^2, a_i without scan i (Efron 1979), k scans.
    """
    auc = lost_auc(scores, is_lost)
    without = []
    for scan in np.unique(scan_of):
        is_in = scan_of != scan
        value = lost_auc(scores[is_in], is_lost[is_in])
        if value is not None:
            without.append(value)
    k = len(without)
    if auc is None or k < 3:
        return None
    values = np.array(without)
    scatter = np.square(values - values.mean()).sum()
    se = float(np.sqrt((k - 1) / k * scatter))
    return max(auc - 1.96 * se, 0.0), min(auc + 1.96 * se, 1.0)
