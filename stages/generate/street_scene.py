"""A random street around a sensor: its course and the objects along it.

A road that may bend and be crossed, kerbs and pavements, plots with houses, gardens and what grows there, parked cars,
street trees, lamps and signs. All of it is drawn from one random generator.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ..arrays import BoolArray, FloatArray
from .street_objects import (
    Mesh,
    StreetObject,
    build_bush,
    build_car,
    build_grid,
    build_hedge,
    build_house,
    build_pole,
    build_tree,
    build_wall,
)

_REACH_M = 95.0  # length of the built-up street in both directions
_GROUND_REACH_M = 130.0
_KERB_M = 0.1


@dataclass(frozen=True)
class Street:
    """Course, profile and building density of a street.

    A place on it has an s along its middle line, 0 at the sensor, growing forward, and an n to the left of that.

    bend_per_m : curvature, positive to the left
    lane_m : n of the sensor
    half_road_m, pavement_m, setback_m : from the middle to the kerb, to the garden boundary, to the house fronts
    sensor_height_m : of the sensor above the road
    plot_m : mean width of a plot
    grade : rise of the road, metres per metre
    crossing_m : s of a side street, or None
    parking, planting, building : probability that kerbs, gardens and plots are used
    leaf_scale : factor of the size of leaves; their number decreases accordingly
    """

    bend_per_m: float
    lane_m: float
    half_road_m: float
    pavement_m: float
    setback_m: float
    grade: float
    sensor_height_m: float
    crossing_m: float | None
    plot_m: float
    parking: tuple[float, float]
    planting: float
    building: float
    leaf_scale: float

    def place(self, s: ArrayLike, n: ArrayLike, above: ArrayLike = 0.0) -> FloatArray:
        """(..., 3) float64, metres, sensor frame: `above` metres over the ground at (s, n)."""
        s, n, above = (np.asarray(values, dtype=np.float64) for values in (s, n, above))
        k = self.bend_per_m
        x = np.sin(k * s) / k - n * np.sin(k * s)
        y = (1 - np.cos(k * s)) / k + n * np.cos(k * s) - self.lane_m
        return np.stack(np.broadcast_arrays(x, y, self.height(s, n) + above), axis=-1)

    def along(self, s: float) -> FloatArray:
        """(3,) float64, unit vector of growing s."""
        turn = self.bend_per_m * s
        return np.array([np.cos(turn), np.sin(turn), 0.0])

    def height(self, s: FloatArray, n: FloatArray) -> FloatArray:
        """Height of road, pavement or garden at (s, n), metres, sensor frame."""
        off_road = np.abs(n) > self.half_road_m
        raised = np.where(off_road & ~self.is_crossed(s), _KERB_M, 0.0)
        camber = 0.01 * np.minimum(np.abs(n), self.half_road_m)
        swell = 0.01 * np.sin(s / 7.0) * np.cos(n / 5.0)
        return -self.sensor_height_m + self.grade * s + raised - camber + swell

    def is_crossed(self, s: ArrayLike, margin_m: float = 0.0) -> BoolArray:
        """True if s is within the side street or a margin of it."""
        if self.crossing_m is None:
            return np.zeros(np.shape(s), dtype=np.bool_)
        return np.abs(np.asarray(s) - self.crossing_m) < self.half_road_m + margin_m


def draw_street(rng: np.random.Generator, leaf_scale: float = 1.0) -> Street:
    """A random street; the scale of its leaves does not affect the other random numbers."""
    bend = rng.choice([-1.0, 1.0]) / rng.choice([75.0, 120.0, 200.0, 1e4])
    half_road = rng.uniform(3.4, 5.2)
    return Street(
        bend_per_m=float(bend),
        lane_m=-0.45 * half_road,
        half_road_m=half_road,
        pavement_m=rng.uniform(1.6, 3.2),
        setback_m=rng.uniform(5.0, 14.0),
        grade=rng.uniform(-0.003, 0.003),
        sensor_height_m=rng.uniform(1.72, 1.9),
        crossing_m=float(rng.choice([-1.0, 1.0]) * rng.uniform(12.0, 40.0)) if rng.uniform() < 0.45 else None,
        plot_m=rng.uniform(16.0, 27.0),
        parking=(rng.uniform(0.1, 0.7), rng.uniform(0.1, 0.7)),
        planting=rng.uniform(0.4, 1.0),
        building=rng.uniform(0.3, 0.7),
        leaf_scale=leaf_scale,
    )


def build_scene(rng: np.random.Generator, leaf_scale: float = 1.0) -> tuple[StreetObject, ...]:
    """The objects of one street, the ground first, in the frame of a sensor in its right lane.

    Parameters
    ----------
    rng : source of the whole scene
    leaf_scale : larger and fewer leaves for scans too coarse to resolve them; everything else is the same
    """
    street = draw_street(rng, leaf_scale)
    objects = [StreetObject("ground", _build_ground(street))]
    for side in (1, -1):
        objects += _kerbside(street, side, rng)
        edge = -_REACH_M
        while edge < _REACH_M:
            width = street.plot_m * rng.uniform(0.8, 1.25)
            if not street.is_crossed([edge, edge + width / 2, edge + width], 2.0).any():
                objects += _plot(street, side, edge, width, rng)
            edge += width
    objects += _side_street(street, rng)
    return tuple(objects)


def _build_ground(street: Street) -> Mesh:
    kerbs = [street.half_road_m - 0.01, street.half_road_m + 0.01]
    n = np.array(
        [0.0, street.half_road_m / 2, *kerbs, street.half_road_m + street.pavement_m, 12.0, 18.0, 28.0, 45.0, 65.0]
    )
    s = np.arange(-_GROUND_REACH_M, _GROUND_REACH_M + 1, 2.5)
    if street.crossing_m is not None:
        jumps = street.crossing_m + street.half_road_m * np.array([-1.001, -0.999, 0.999, 1.001])
        s = np.sort(np.concatenate([s, jumps]))
    return build_grid(street.place(s[:, None], np.concatenate([-n[:0:-1], n])), 0.22)


def _kerbside(street: Street, side: int, rng: np.random.Generator) -> Iterator[StreetObject]:
    """Parked cars at the kerb, street trees, lamps and signs on the pavement."""
    lamps, trees = rng.uniform(24.0, 36.0), rng.uniform(9.0, 24.0)
    for s in np.arange(-_REACH_M + rng.uniform(0, 6.0), _REACH_M, 6.2):
        parked = rng.uniform() < street.parking[0 if side > 0 else 1]
        in_own_way = abs(s) < 7.0 and side < 0
        if parked and not in_own_way and not street.is_crossed(s, 5.0):
            yield _place_car(
                street, s, side * (street.half_road_m - 1.0), street.bend_per_m * s + np.pi * (side > 0), rng
            )
    for s in np.arange(-_REACH_M + rng.uniform(0, trees), _REACH_M, trees):
        if rng.uniform() < street.planting and not street.is_crossed(s, 2.0):
            yield _place_tree(street, s, side * (street.half_road_m + 0.7), rng.uniform(5.0, 9.0), rng)
    for s in np.arange(-_REACH_M + rng.uniform(0, lamps), _REACH_M, lamps) + 1.5:
        if not street.is_crossed(s, 1.0):
            arm = -side * 1.4 * np.array([-np.sin(street.bend_per_m * s), np.cos(street.bend_per_m * s), 0.1])
            foot = street.place(s, side * (street.half_road_m + 0.4))
            yield StreetObject("pole", build_pole(foot, rng.uniform(5.0, 7.5), 0.08, arm, 0.0))
    for s in rng.uniform(-50.0, 50.0, rng.integers(1, 4)):
        foot = street.place(s, side * (street.half_road_m + 0.5))
        yield StreetObject("pole", build_pole(foot, rng.uniform(2.3, 3.0), 0.04, None, rng.uniform(0.5, 0.8)))


def _plot(street: Street, side: int, start: float, width: float, rng: np.random.Generator) -> Iterator[StreetObject]:
    """A house with its garden, or a small park."""
    boundary = street.half_road_m + street.pavement_m
    front = boundary + street.setback_m * rng.uniform(0.8, 1.2)
    depth = rng.uniform(7.0, 10.0)
    if rng.uniform() > street.building:
        for _ in range(rng.integers(2, 5)):
            yield _place_tree(
                street, start + width * rng.uniform(), side * (boundary + rng.uniform(2, 18)), rng.uniform(5, 11), rng
            )
        for _ in range(rng.integers(1, 4)):
            yield _place_bush(street, start + width * rng.uniform(), side * (boundary + rng.uniform(1, 12)), rng)
        return
    length = min(width - 2.5, rng.uniform(8.0, 14.0))
    corner_s = start + (width - length) * rng.uniform(0.3, 0.7)
    size = (length, depth, float(rng.choice([2.9, 3.3, 5.6])))
    corner = street.place(corner_s if side > 0 else corner_s + length, side * front)
    yield StreetObject(
        "wall", build_house(corner, side * street.along(corner_s + length / 2), size, rng.uniform(0.3, 0.7))
    )
    drive = 3.4 if rng.uniform() < 0.6 else 1.2
    style = rng.uniform()
    line_s = np.linspace(start + drive, start + width - 0.3, max(3, int(width - drive)))
    line = street.place(line_s, side * (boundary + 0.4))
    if style < 0.3 * street.planting:
        yield _place_hedge(street, line, rng.uniform(0.7, 1.1), rng.uniform(0.8, 1.7), rng)
    elif style < 0.5:
        yield StreetObject("wall", build_wall(line, 0.25, rng.uniform(0.5, 1.3), rng.uniform(0.3, 0.6)))
    if drive > 2 and rng.uniform() < 0.5:
        s, n = start + drive / 2, side * (boundary + 2.8)
        yield _place_car(street, s, n, street.bend_per_m * s + np.pi / 2 * rng.choice([-1, 1]), rng)
    for _ in range(rng.poisson(1.2 * street.planting)):
        yield _place_bush(
            street, rng.uniform(start + drive, start + width), side * rng.uniform(boundary + 1.2, front - 0.6), rng
        )
    if rng.uniform() < 0.5 * street.planting and street.setback_m > 4.5:
        yield _place_tree(
            street, start + width * rng.uniform(0.5, 0.95), side * (boundary + 2.2), rng.uniform(3.5, 6), rng
        )
    for _ in range(rng.poisson(1.0)):
        n = side * (front + depth + rng.uniform(3.0, 14.0))
        yield _place_tree(street, start + width * rng.uniform(), n, rng.uniform(6.0, 12.0), rng)


def _side_street(street: Street, rng: np.random.Generator) -> Iterator[StreetObject]:
    """The visible part of a side street: hedges or walls at its sides, cars, a house at each end."""
    if street.crossing_m is None:
        return
    first = street.half_road_m + street.pavement_m + 1.0
    for side in (1, -1):
        for edge in (-1, 1):
            s = street.crossing_m + edge * (street.half_road_m + 1.6)
            line = street.place(np.full(9, s), side * np.linspace(first, first + rng.uniform(8, 20), 9))
            if rng.uniform() < 0.5:
                yield _place_hedge(street, line, 0.9, rng.uniform(1.2, 2.0), rng)
            else:
                yield StreetObject("wall", build_wall(line, 0.25, rng.uniform(0.9, 1.9), 0.45))
        s = street.crossing_m + rng.uniform(-2.0, 2.0)
        heading = street.bend_per_m * s + np.pi / 2
        yield _place_car(street, s, side * rng.uniform(first + 4, 30.0), heading, rng)
        length = rng.uniform(9.0, 14.0)
        corner = street.place(street.crossing_m - side * length / 2, side * rng.uniform(40.0, 58.0))
        yield StreetObject("wall", build_house(corner, side * street.along(street.crossing_m), (length, 9.0, 5.6), 0.5))


def _place_car(street: Street, s: float, n: float, heading_rad: float, rng: np.random.Generator) -> StreetObject:
    style = int(rng.choice(4, p=[0.3, 0.35, 0.27, 0.08]))
    askew = heading_rad + rng.normal(0.0, 0.02)
    return StreetObject(
        "car", build_car(street.place(s, n), askew, style, float(rng.choice([0.06, 0.25, 0.45, 0.7])), rng)
    )


def _place_tree(street: Street, s: float, n: float, height_m: float, rng: np.random.Generator) -> StreetObject:
    foot = street.place(s, n)
    return StreetObject("tree", *build_tree(foot, height_m, _leaf_m(street, foot), rng.spawn(1)[0]))


def _place_bush(street: Street, s: float, n: float, rng: np.random.Generator) -> StreetObject:
    foot = street.place(s, n)
    bush = build_bush(foot, rng.uniform(0.5, 1.2), _leaf_m(street, foot), rng.spawn(1)[0])
    return StreetObject("vegetation", leaves=bush)


def _place_hedge(
    street: Street, line: FloatArray, width_m: float, height_m: float, rng: np.random.Generator
) -> StreetObject:
    hedge = build_hedge(line, width_m, height_m, _leaf_m(street, line), rng.spawn(1)[0])
    return StreetObject("vegetation", leaves=hedge)


def _leaf_m(street: Street, place: FloatArray) -> float:
    """Radius of a leaf: small nearby, larger where single leaves cannot be distinguished."""
    range_m = float(np.linalg.norm(place.reshape(-1, 3).mean(axis=0)))
    return street.leaf_scale * min(max(0.006 * range_m, 0.12), 0.35)
