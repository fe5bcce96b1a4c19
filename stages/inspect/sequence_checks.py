"""Checks of the scans of a side as a sequence: static, late or empty sides, and hits on the ego vehicle."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.spatial import cKDTree

from ..arrays import FloatArray, level_m
from ..frame_search import ground_height
from ..linalg.subgraph import connected_points
from ..surfels import voxel_ids
from ..thinning import shares_voxel

_NEAREST_M = 3.0
_FARTHEST_M = 40.0
_VOXEL_M = 0.5
_ABOVE_GROUND_M = 0.5
_SAMPLED_POINTS = 800
_MIN_SAMPLED = 50
_MAX_MISFIT_M = 1.0

_STILL_M = 0.15  # misfit of scans of one place, including a dense one with noise of 10 cm
_MOVING_M = 0.25

MAX_FRAMES_LATE = 3
_MIN_GAIN_M = 0.05
_MIN_GAIN = 0.15
_MIN_COMPARISONS = 3
_AGREEING = 0.8

_EMPTY = 0.05

_EGO_M = 5.0
_AROUND_M = 6.5
_EGO_GROUND_M = 0.35
_SAME_PLACE_M = 0.1
_LINK_M = 0.5
_MIN_SCANS = 3  # of two, half a metre apart in a narrow yard, surfaces that the motion slides along seem to stay
_MIN_SHARE = 0.002
_MIN_NEAR = 20


class SequenceScan:
    """Points of a scan for comparisons: all points within 40 m, and a sample of those above the ground.

    points : (n, 3) float64, metres, the real sensor's frame, z up, finite; those nearer than 3 m
        are left out
    """

    def __init__(self, points: FloatArray) -> None:
        level = level_m(points)
        points = points[(level > _NEAREST_M) & (level < _FARTHEST_M)]
        thinned = points[~shares_voxel(points, _VOXEL_M)]
        self.ground_m = ground_height(thinned)
        above = thinned[thinned[:, 2] > self.ground_m + _ABOVE_GROUND_M]
        order = np.random.default_rng(0).permutation(len(above))
        self.sample: FloatArray = above[order[:_SAMPLED_POINTS]]
        self.tree = cKDTree(points, balanced_tree=False, compact_nodes=False)

    def misfit_m(self, other: SequenceScan) -> float:
        """Mean distance between the points above the ground of two scans, limited to 1 m; NaN for too few points.

        0 for the same scan; on recordings about 0.03 for a static sensor, 0.4 for one 0.8 m ahead.
        """
        means = []
        for scan, sample in ((self, other.sample), (other, self.sample)):
            if len(sample) >= _MIN_SAMPLED:
                apart_m, _ = scan.tree.query(sample, distance_upper_bound=_MAX_MISFIT_M)
                means.append(np.minimum(apart_m, _MAX_MISFIT_M).mean())
        return float(np.mean(means or [np.nan]))


@dataclass(frozen=True)
class TimeOffset:
    """Time offset between the sides, in frames.

    frames : number of frames by which the simulated side is late; negative if it is early
    misfit_m, as_paired_m : mean misfit of the real scans with shifted simulated scans, and with
        those of their pairs
    """

    frames: int
    misfit_m: float
    as_paired_m: float


@dataclass(frozen=True)
class EgoHits:
    """Returns from the ego vehicle.

    share : share of the points, mean over the scans
    low, high : corners of their box, metres, the scan's own frame but z up
    others_in_box : share of other points in the box
    """

    share: float
    low: FloatArray
    high: FloatArray
    others_in_box: float


def find_time_offset(
    sequences: Sequence[tuple[Sequence[SequenceScan], Sequence[SequenceScan]]],
) -> TimeOffset | None:
    """Find by how many frames the simulated side is late, if scans of other pairs fit clearly better; else None.

    The misfit m(i, j) of real scan i and simulated scan j is compared with m(i, i), for j = i + k
    and |k| <= 3. The k of the largest mean gain m(i, i) - m(i, i + k) is late by k if that is at
    least 0.05 m and 15 % of m(i, i), and positive in 80 % of at least three comparisons. A
    simulated sensor that is mounted ahead by the distance of one frame has the same effect; static
    sensors have no offset.

    Parameters
    ----------
    sequences : of each stretch of neighbouring frames, the real and the simulated scans in order of
        time
    """
    misfits: dict[
        int, list[tuple[float, float]]
    ] = {}  # as paired and shifted, by number of frames
    for real, sim in sequences:
        paired = [a.misfit_m(b) for a, b in zip(real, sim, strict=True)]
        for i, scan in enumerate(real):
            for j in range(max(0, i - MAX_FRAMES_LATE), min(len(sim), i + MAX_FRAMES_LATE + 1)):
                if j != i:
                    misfits.setdefault(j - i, []).append((paired[i], scan.misfit_m(sim[j])))
    clear = []
    for late in sorted(misfits):
        both = np.array(misfits[late])
        both = both[np.isfinite(both).all(axis=1)]
        if len(both) < _MIN_COMPARISONS:
            continue
        as_paired_m, misfit_m = both.mean(axis=0).tolist()
        gain_m = as_paired_m - misfit_m
        is_large = gain_m > max(_MIN_GAIN_M, _MIN_GAIN * as_paired_m)
        if is_large and np.mean(both[:, 1] < both[:, 0]) >= _AGREEING:
            clear.append(TimeOffset(late, misfit_m, as_paired_m))
    return max(clear, key=lambda offset: offset.as_paired_m - offset.misfit_m, default=None)


def moved_m(sequences: Sequence[Sequence[SequenceScan]]) -> float:
    """Median misfit of neighbouring scans of a side: its change from frame to frame; NaN without comparisons.

    Parameters
    ----------
    sequences : the scans of each stretch of neighbouring frames, in order of time
    """
    misfits = []
    for scans in sequences:
        misfits += [a.misfit_m(b) for a, b in pairwise(scans)]
    finite = [misfit for misfit in misfits if np.isfinite(misfit)]
    return float(np.median(finite)) if finite else float("nan")


def is_moving(side_moved_m: float) -> bool:
    """True if the scans of a side differ enough from frame to frame (`moved_m`) for a moving sensor."""
    return side_moved_m > _MOVING_M


def is_static(side_moved_m: float, other_moved_m: float) -> bool:
    """True if the scans of a side are equal except for noise while those of the other side differ.

    Parameters
    ----------
    side_moved_m, other_moved_m : see `moved_m`
    """
    is_still = side_moved_m < min(_STILL_M, other_moved_m / 2.5)
    return is_still and is_moving(other_moved_m)


def is_nearly_empty(n_points: float, n_others: float) -> bool:
    """True if the median scan of a side has less than a twentieth of the points of that of the other side."""
    return n_points < _EMPTY * n_others


def find_ego_hits(scans: Sequence[FloatArray], ground_m: float) -> EgoHits | None:
    """Find returns near a moving sensor that do not move relative to it, and so are from the ego vehicle; or None.

    They are within 5 m, at least 0.35 m above or below the ground, have a return within 0.1 m in 80
    % of the other scans, and are not linked (0.5 m) to static points beyond 5 m, as a wall along
    the road is. They are reported if they are at least 0.2 % of the points. One or two scans are
    not enough.

    Parameters
    ----------
    scans : (n, 3) float64 each, metres, their own frame, z up, finite; of a moving sensor, see
        `is_moving`
    ground_m : z of the ground
    """
    if len(scans) < _MIN_SCANS:
        return None
    near = []
    for points in scans:
        is_around = level_m(points) < _AROUND_M
        near.append(points[is_around & (np.abs(points[:, 2] - ground_m) > _EGO_GROUND_M)])
    trees = [cKDTree(points) for points in near]
    hits = []
    for i, points in enumerate(near):
        hits.append(_staying(points, [*trees[:i], *trees[i + 1 :]]))
    n_points = np.array([max(len(points), 1) for points in scans])
    n_hits = np.array([len(points) for points in hits])
    share = float(np.mean(n_hits / n_points))
    all_hits = np.concatenate(hits)
    if share < _MIN_SHARE or len(all_hits) < _MIN_NEAR:
        return None
    low = np.floor(10 * all_hits.min(axis=0)) / 10
    high = np.ceil(10 * all_hits.max(axis=0)) / 10
    n_in_box = []
    for points in scans:
        is_in_box = ((points >= low) & (points <= high)).all(axis=1)
        n_in_box.append(is_in_box.sum())
    others = float(np.mean((np.array(n_in_box) - n_hits) / n_points))
    return EgoHits(share, low, high, max(others, 0.0))


def _staying(points: FloatArray, others: Sequence[cKDTree]) -> FloatArray:
    """Near points of a scan that most other scans have too, and that belong to no component beyond 5 m."""
    n_seen = np.zeros(len(points))
    for other in others:
        if other.n:
            apart_m, _ = other.query(points, distance_upper_bound=_SAME_PLACE_M)
            n_seen += np.isfinite(apart_m)
    points = points[n_seen >= _AGREEING * len(others)]
    if not len(points):
        return points
    _, first, cell = np.unique(
        voxel_ids(points, _LINK_M / 2),
        return_index=True,
        return_inverse=True,
    )
    component = connected_points(points[first], _LINK_M)[cell]
    reach = np.zeros(component.max() + 1)
    np.maximum.at(reach, component, level_m(points))
    return points[reach[component] < _EGO_M]
