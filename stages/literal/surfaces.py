"""Coverage, displacement and roughness of surfaces once more: all distances, one plane and one point at a time."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from sklearn.utils import murmurhash3_32

from ..arrays import FloatArray
from .method import distances

_NEIGHBOURS = 20
_LEAST_PLANARITY = 0.1
_REACH_M = 1.0
_FEWEST_POINTS = 10
_LEAST_SHARE = 0.05
_MOST_LEANING = 0.01
_LEAST_STEP_M = 1e-3
_MOST_STEPS = 20


def covered(distances_m: Sequence[float], reach_m: float) -> float:
    """The share of the distances to the other side that are within reach."""
    return sum(d <= reach_m for d in distances_m) / len(distances_m)


def visiting_order(points: FloatArray, seed: int = 0) -> list[int]:
    """The points in the order of a hash of their coordinates, number by number; of equal hashes by z, y, x.

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
    """The plane through the points about a place.

    point, normal : (3,) the place, and the unit normal of either sign
    roughness_m : standard deviation of the points from the plane
    is_plane : whether they tell one
    is_tied : whether another point is as near as the last of them, so that they could as well be others
    """

    point: FloatArray
    normal: FloatArray
    roughness_m: float
    is_plane: bool
    is_tied: bool


def local_plane(points: FloatArray, place: FloatArray) -> Plane:
    """The plane through the 20 points nearest to a place.

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
        bool(l1 > 0 and l2 - l3 >= _LEAST_PLANARITY * l1),
        len(last) == 2 and bool(last[1] <= last[0] * (1 + 1e-9)),
    )


@dataclass(frozen=True)
class Offset:
    """How far a piece of surface is displaced: points that tell it, directions that are told, (x, y, z), length.

    What is not told is None.
    """

    n_points: int
    n_directions: int
    shift_m: tuple[float | None, float | None, float | None]
    distance_m: float | None


def offset(planes: Iterable[Plane], sim: FloatArray) -> Offset:
    """The translation of the simulated surface against some real planes, point to plane, by least squares.

    Parameters
    ----------
    planes : of real points
    sim : (m, 3) float64, metres
    """
    own = [plane for plane in planes if plane.is_plane]
    t, told, axes, n_points = np.zeros(3), np.zeros(3, dtype=bool), np.eye(3), 0
    for _ in range(_MOST_STEPS):
        squares, wanted, n_points = np.zeros((3, 3)), np.zeros(3), 0
        for plane in own:
            apart = distances(sim, plane.point + t)
            i = int(apart.argmin())
            if apart[i] <= _REACH_M:
                squares += np.outer(plane.normal, plane.normal)
                wanted += plane.normal * (plane.normal @ (sim[i] - plane.point))
                n_points += 1
        sizes, axes = np.linalg.eigh(squares)
        told = (sizes >= _LEAST_SHARE * n_points) & (n_points >= _FEWEST_POINTS)
        before, t = t, sum((axes[:, i] * (axes[:, i] @ wanted) / sizes[i] for i in range(3) if told[i]), np.zeros(3))
        if max(abs(t - before)) <= _LEAST_STEP_M:
            break
    leaning = [sum(axes[a, i] ** 2 for i in range(3) if not told[i]) for a in range(3)]
    x, y, z = (float(t[a]) if leaning[a] <= _MOST_LEANING else None for a in range(3))
    return Offset(n_points, int(told.sum()), (x, y, z), math.hypot(*t) if told.any() else None)


def area_between(real: Sequence[float], sim: Sequence[float]) -> float:
    """Area between two empirical distribution functions, step by step."""
    a, b = np.array(real), np.array(sim)
    steps = sorted([*a.tolist(), *b.tolist()])
    return math.fsum(
        abs(float(np.mean(a <= low)) - float(np.mean(b <= low))) * (high - low)
        for low, high in itertools.pairwise(steps)
    )
