"""Literal surface pieces: all distances, from one point to the next."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from literal_method import PLACE, Settings, canonical, describe, distances

_MOVED_WITHIN_M = 3.0
_SLACK_M = 0.5
_SLACK = 1 / 3
_ROUNDED_DIGITS = 9


def components(points: NDArray[np.float64], link_m: float) -> list[int]:
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


def pieces(
    points: NDArray[np.float64],
    is_ground: NDArray[np.bool_],
    height_m: NDArray[np.float64],
    others: NDArray[np.float64],
    settings: Settings,
) -> list[tuple[list[int], dict[str, float]]]:
    """Pieces of a side, their points by index and a row of `pieces`; largest first, for equal sizes by x, y, z.

    Parameters
    ----------
    points, is_ground, height_m : (n, 3), (n,), (n,), all clean points of the side
    others : (m, 3) float64, metres, all clean points of the other side
    settings : of the group pieces
    """
    above = np.flatnonzero(~is_ground).tolist()
    uncovered = [i for i in above if distances(others, points[i]).min() > settings["reach_m"]]
    uncovered.sort(key=lambda i: points[i].tolist())
    labels = canonical(components(points[uncovered], settings["link_m"]))
    found = []
    for piece in range(max(labels, default=-1) + 1):
        members = [i for i, label in zip(uncovered, labels, strict=True) if label == piece]
        if len(members) >= settings["min_points"]:
            about = describe(points[members])
            place = {name: about[name] for name in PLACE}
            bearing_deg = math.degrees(math.atan2(about["cy"], about["cx"]))
            low = float(min(height_m[members]))
            found.append(
                (
                    members,
                    place | {"piece_id": piece, "bearing_deg": bearing_deg, "height_m": low},
                )
            )
    return found


def fates(
    missing: Sequence[Mapping[str, Any]], invented: Sequence[Mapping[str, Any]]
) -> list[dict[str, Any]]:
    """Fate of each piece, its partner and move by column of `pieces`: the rows of the real side, then of the other.

    A piece moved if one of the other side is near and of similar size, and each is the other's nearest.

    Parameters
    ----------
    missing, invented : rows of `pieces` of both sides, by id
    """
    apart: dict[tuple[int, int], float] = {}
    for i, a in enumerate(missing):
        for j, b in enumerate(invented):
            distance_m = math.hypot(*(a[f"c{axis}"] - b[f"c{axis}"] for axis in "xyz"))
            sizes = [(a[f"extent_{axis}"], b[f"extent_{axis}"]) for axis in "xyz"]
            is_like = all(
                abs(own - other) <= max(_SLACK_M, _SLACK * max(own, other))
                for own, other in sizes
            )
            if is_like and round(distance_m, _ROUNDED_DIGITS) <= _MOVED_WITHIN_M:
                apart[i, j] = round(distance_m, _ROUNDED_DIGITS)
    ids = [("real", i) for i in range(len(missing))] + [
        ("sim", j) for j in range(len(invented))
    ]
    move: dict[str, float | None] = {f"moved_{axis}_m": None for axis in "xyz"}
    rows: dict[tuple[str, int], dict[str, Any]] = {
        (side, i): {"side": side, "piece_id": i, "fate": "gone", "partner_id": None} | move
        for side, i in ids
    }
    for i, j in apart:
        nearest_sim = min((d, b) for (a, b), d in apart.items() if a == i)[1]
        nearest_real = min((d, a) for (a, b), d in apart.items() if b == j)[1]
        if (nearest_real, nearest_sim) == (i, j):
            move = {
                f"moved_{axis}_m": invented[j][f"c{axis}"] - missing[i][f"c{axis}"]
                for axis in "xyz"
            }
            rows["real", i] |= {"fate": "moved", "partner_id": j} | move
            rows["sim", j] |= {"fate": "moved", "partner_id": i} | move
    return list(rows.values())
