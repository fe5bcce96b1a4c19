"""Literal coverage, displacement and roughness of surfaces: all distances, one plane and one point at a time."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from sklearn.utils import murmurhash3_32

from literal_method import distances

_NEIGHBOURS = 20
_MIN_PLANARITY = 0.1
_REACH_M = 1.0
_MIN_POINTS = 10
_MIN_SHARE = 0.05
_MAX_LEANING = 0.01
_MIN_STEP_M = 1e-3
_MAX_STEPS = 20


def visiting_order(points: NDArray[np.float64], seed: int = 0) -> list[int]:
    """Indices of the points by a hash of their coordinates, number by number; for equal hashes by z, y, x.

    Parameters
    ----------
    points : (n, 3) float64, metres
    """
    hashes = []
    for words in np.ascontiguousarray(points + 0.0).view(np.int32).tolist():
        value = 0
        for word in words:
            value = int(murmurhash3_32(word ^ value, seed=seed))
        hashes.append(value)
    return sorted(range(len(points)), key=lambda i: (hashes[i], *points[i][::-1].tolist()))


@dataclass(frozen=True)
class Plane:
    """Plane through the points around a place.

    point, normal : (3,) place, and unit normal of either sign
    roughness_m : standard deviation of the points from the plane
    is_plane : the points determine a plane
    is_tied : another point is as near as the last of them, so that the choice is not unique
    """

    point: NDArray[np.float64]
    normal: NDArray[np.float64]
    roughness_m: float
    is_plane: bool
    is_tied: bool


def local_plane(points: NDArray[np.float64], place: NDArray[np.float64]) -> Plane:
    """Plane through the 20 points nearest to a place.

    Parameters
    ----------
    points, place : (n, 3), (3,) float64, metres, n at least 20
    """
    apart = distances(points, place)
    nearest = np.argpartition(apart, min(_NEIGHBOURS, len(apart) - 1))[: _NEIGHBOURS + 1]
    by_distance = sorted(nearest.tolist(), key=lambda i: apart[i])
    near = points[by_distance[:_NEIGHBOURS]]
    last = apart[by_distance[_NEIGHBOURS - 1 :]]
    centred = near - near.mean(axis=0)
    _, sizes, axes = np.linalg.svd(centred)
    l1, l2, l3 = sizes**2
    residuals = centred @ axes[2]
    return Plane(
        place,
        axes[2],
        math.sqrt(sum(residuals**2) / (_NEIGHBOURS - 3)),
        bool(l1 > 0 and l2 - l3 >= _MIN_PLANARITY * l1),
        len(last) == 2 and bool(last[1] <= last[0] * (1 + 1e-9)),
    )


def offset(planes: Iterable[Plane], sim: NDArray[np.float64]) -> dict[str, float | None]:
    """Translation of the simulated surface against some real planes, point to plane, by least squares.

    By column of `surface`; values that are not observable are None.

    Parameters
    ----------
    planes : planes of real points
    sim : (m, 3) float64, metres
    """
    own = [plane for plane in planes if plane.is_plane]
    t = np.zeros(3)
    is_seen = np.zeros(3, dtype=bool)
    axes = np.eye(3)
    n_points = 0
    for _ in range(_MAX_STEPS):
        squares = np.zeros((3, 3))
        targets = np.zeros(3)
        n_points = 0
        for plane in own:
            apart = distances(sim, plane.point + t)
            i = int(apart.argmin())
            if apart[i] <= _REACH_M:
                squares += np.outer(plane.normal, plane.normal)
                targets += plane.normal * (plane.normal @ (sim[i] - plane.point))
                n_points += 1
        sizes, axes = np.linalg.eigh(squares)
        is_seen = (sizes >= _MIN_SHARE * n_points) & (n_points >= _MIN_POINTS)
        before = t
        t = np.zeros(3)
        for i in np.flatnonzero(is_seen).tolist():
            t = t + axes[:, i] * (axes[:, i] @ targets) / sizes[i]
        if max(abs(t - before)) <= _MIN_STEP_M:
            break
    row: dict[str, float | None] = {"n_points": n_points, "n_directions": int(is_seen.sum())}
    for a, axis in enumerate("xyz"):
        leaning = sum(axes[a, i] ** 2 for i in range(3) if not is_seen[i])
        row[f"shift_{axis}_m"] = float(t[a]) if leaning <= _MAX_LEANING else None
    return row | {"shift_m": math.hypot(*t) if is_seen.any() else None}


def area_between(real: Sequence[float], sim: Sequence[float]) -> float:
    """Area between two empirical distribution functions, step by step."""
    a, b = np.array(real), np.array(sim)
    steps = sorted([*a.tolist(), *b.tolist()])
    return math.fsum(
        abs(float(np.mean(a <= low)) - float(np.mean(b <= low))) * (high - low)
        for low, high in itertools.pairwise(steps)
    )
