"""Literal surface pieces: all distances, from one point to the next."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..arrays import BoolArray, FloatArray
from .literal_method import Description, canonical, describe, distances

_MOVED_WITHIN_M = 3.0
_SIZE_SLACK_M, _SIZE_SLACK = 0.5, 1 / 3
_ROUNDED_DIGITS = 9


def components(points: FloatArray, link_m: float) -> list[int]:
    """Component of each point: number of its first point, from which it is reached by steps of at most the link.

    Parameters
    ----------
    points : (n, 3) float64, metres
    """
    labels = [-1] * len(points)
    for start in range(len(points)):
        todo = [start] if labels[start] < 0 else []
        while todo:
            i = todo.pop()
            labels[i] = start
            near = np.flatnonzero(distances(points, points[i]) <= link_m).tolist()
            for j in near:
                if labels[j] < 0:
                    labels[j] = start
                    todo.append(j)
    return labels


@dataclass(frozen=True)
class Piece:
    """Surface piece: points by index, their description, bearing, and height of the lowest point above the road."""

    members: list[int]
    about: Description
    bearing_deg: float
    height_m: float


def pieces(
    points: FloatArray,
    is_ground: BoolArray,
    height_m: FloatArray,
    others: FloatArray,
    reach_m: float,
    link_m: float,
    min_points: int,
) -> list[Piece]:
    """Pieces of a side, largest first, for equal sizes by x, y, z.

    Parameters
    ----------
    points, is_ground, height_m : (n, 3), (n,), (n,), all clean points of the side
    others : (m, 3) float64, metres, all clean points of the other side
    reach_m, link_m, min_points : as in the settings of pieces
    """
    uncovered = [i for i in np.flatnonzero(~is_ground).tolist() if distances(others, points[i]).min() > reach_m]
    uncovered.sort(key=lambda i: points[i].tolist())
    labels = canonical(components(points[uncovered], link_m))
    found = []
    for piece in range(max(labels, default=-1) + 1):
        members = [i for i, label in zip(uncovered, labels, strict=True) if label == piece]
        if len(members) >= min_points:
            about = describe(points[members])
            bearing = math.degrees(math.atan2(about.centroid[1], about.centroid[0]))
            found.append(Piece(members, about, bearing, float(min(height_m[members]))))
    return found


Place = tuple[Sequence[float], Sequence[float]]  #: centroid and extent, x, y and z


def moved(missing: Sequence[Place], invented: Sequence[Place]) -> dict[int, int]:
    """Invented piece to which each missing one moved, by id: near, of similar size, and each is the other's nearest.

    Parameters
    ----------
    missing, invented : of both sides, by id
    """
    apart: dict[tuple[int, int], float] = {}
    for i, (own, size) in enumerate(missing):
        for j, (other, other_size) in enumerate(invented):
            apart_m = round(math.dist(own, other), _ROUNDED_DIGITS)
            slack = [max(_SIZE_SLACK_M, _SIZE_SLACK * max(a, b)) for a, b in zip(size, other_size, strict=True)]
            is_like = all(abs(a - b) <= s for a, b, s in zip(size, other_size, slack, strict=True))
            if is_like and apart_m <= _MOVED_WITHIN_M:
                apart[i, j] = apart_m
    nearest_sim = {i: min((d, j) for (a, j), d in apart.items() if a == i)[1] for i, _ in apart}
    nearest_real = {j: min((d, i) for (i, b), d in apart.items() if b == j)[1] for _, j in apart}
    return {i: j for i, j in nearest_sim.items() if nearest_real[j] == i}
