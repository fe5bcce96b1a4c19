"""A random street around a sensor: its course and the objects along it.

A road that may bend, pavements, plots with houses, gardens and what grows there, parked cars,
street trees, lamps and signs. Objects are built along a straight street, which is then bent. All of
it is drawn from one random generator.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from .street_objects import (
    CAR_SHAPES,
    Mesh,
    StreetObject,
    build_box,
    build_bush,
    build_car,
    build_grid,
    build_hedge,
    build_house,
    build_pole,
    build_tree,
)

_REACH_M = 95.0  # length of the built-up street in both directions
_GROUND_REACH_M = 130.0
_GROUND_WIDTH_M = 65.0
_LAMP_HEAD_M = np.array([0.2, 2.4, 0.1])
_SIGN_HEAD_M = np.array([0.1, 0.7, 0.7])


@dataclass(frozen=True)
class Street:
    """Course, profile and building density of a street.

    bend_per_m : curvature, positive to the left
    half_road_m, pavement_m, setback_m : from the middle to the kerb, to the garden boundary, to the
        house fronts
    sensor_height_m : of the sensor above the road
    plot_m : mean width of a plot
    planting, building : probability that gardens and plots are used
    """

    bend_per_m: float
    half_road_m: float
    pavement_m: float
    setback_m: float
    sensor_height_m: float
    plot_m: float
    planting: float
    building: float

    def bend(self, mesh: Mesh) -> Mesh:
        """A mesh on the straight street, on the bent one, in the frame of the sensor in its right lane."""
        x, y, z = mesh.vertices.T
        turn = self.bend_per_m * x
        radius_m = 1 / self.bend_per_m
        bent_x = (radius_m - y) * np.sin(turn)
        bent_y = radius_m - (radius_m - y) * np.cos(turn) + 0.45 * self.half_road_m
        return replace(mesh, vertices=np.column_stack([bent_x, bent_y, z - self.sensor_height_m]))


def build_scene(rng: np.random.Generator) -> tuple[StreetObject, ...]:
    """The objects of one street, the ground first, in the frame of a sensor in its right lane."""
    street = _draw_street(rng)
    objects = [StreetObject("ground", _build_ground())]
    for side in (1, -1):
        objects += _park_cars(street, side, rng)
        objects += _line_pavement(street, side, rng)
        edge_m = -_REACH_M
        while edge_m < _REACH_M:
            width_m = street.plot_m * rng.uniform(0.8, 1.25)
            objects += _build_plot(street, side, edge_m, width_m, rng)
            edge_m += width_m
    return tuple(
        StreetObject(
            item.kind,
            street.bend(item.solid),
            street.bend(item.leaves),
        )
        for item in objects
    )


def _draw_street(rng: np.random.Generator) -> Street:
    return Street(
        bend_per_m=float(rng.choice([-1.0, 1.0]) / rng.choice([75.0, 120.0, 200.0, 1e4])),
        half_road_m=rng.uniform(3.4, 5.2),
        pavement_m=rng.uniform(1.6, 3.2),
        setback_m=rng.uniform(5.0, 14.0),
        sensor_height_m=rng.uniform(1.72, 1.9),
        plot_m=rng.uniform(16.0, 27.0),
        planting=rng.uniform(0.4, 1.0),
        building=rng.uniform(0.25, 0.6),
    )


def _build_ground() -> Mesh:
    """Ground that rises gently to both sides, with a swell of a centimetre."""
    along = np.arange(-_GROUND_REACH_M, _GROUND_REACH_M + 1, 2.5)
    across = np.arange(-_GROUND_WIDTH_M, _GROUND_WIDTH_M + 1, 2.5)
    x, y = np.meshgrid(along, across, indexing="ij")
    swell = 0.01 * np.sin(x / 7.0) * np.cos(y / 5.0)
    return build_grid(np.stack([x, y, 0.005 * np.abs(y) + swell], axis=-1), 0.22)


def _park_cars(street: Street, side: int, rng: np.random.Generator) -> Iterator[StreetObject]:
    """Cars at the kerb, none next to the sensor in its own lane."""
    share = rng.uniform(0.1, 0.7)
    heading_rad = np.pi if side > 0 else 0.0
    for x in np.arange(-_REACH_M + rng.uniform(0.0, 6.0), _REACH_M, 6.2):
        is_free = side < 0 and abs(x) < 7.0
        if rng.uniform() < share and not is_free:
            yield _draw_car(x, side * (street.half_road_m - 1.0), heading_rad, rng)


def _draw_car(x: float, y: float, heading_rad: float, rng: np.random.Generator) -> StreetObject:
    shape = int(rng.integers(len(CAR_SHAPES)))
    paint = rng.choice([0.06, 0.25, 0.45, 0.7])
    return StreetObject("car", build_car(np.array([x, y, 0.0]), shape, heading_rad, paint))


def _line_pavement(street: Street, side: int, rng: np.random.Generator) -> Iterator[StreetObject]:
    """Street trees, lamps and signs."""
    y = side * (street.half_road_m + 0.5)
    for x in np.arange(-_REACH_M, _REACH_M, rng.uniform(9.0, 24.0)):
        if rng.uniform() < street.planting:
            yield build_tree(np.array([x, y, 0.0]), rng.uniform(5.0, 9.0), rng)
    for x in np.arange(-_REACH_M + 3.0, _REACH_M, rng.uniform(24.0, 36.0)):
        yield build_pole(np.array([x, y, 0.0]), rng.uniform(5.0, 7.5), _LAMP_HEAD_M)
    for x in rng.uniform(-50.0, 50.0, rng.integers(1, 4)):
        yield build_pole(np.array([x, y, 0.0]), rng.uniform(1.8, 2.3), _SIGN_HEAD_M)


def _build_plot(
    street: Street, side: int, edge_m: float, width_m: float, rng: np.random.Generator
) -> Iterator[StreetObject]:
    """A house, a hedge or a wall in front of its garden, and a car on its drive; or a small park."""
    middle_m = edge_m + width_m / 2
    boundary_m = street.half_road_m + street.pavement_m
    if rng.uniform() > street.building:
        park_m = (boundary_m + 1.0, boundary_m + 18.0)
        n_trees = int(rng.integers(2, 5))
        n_bushes = int(rng.integers(1, 4))
        yield from _plant(middle_m, width_m, side, park_m, n_trees, n_bushes, rng)
        return
    length_m = min(rng.uniform(8.0, 14.0), width_m - 2.5)
    size_m = np.array([length_m, rng.uniform(7.0, 10.0), rng.choice([2.9, 3.3, 5.6])])
    front_m = boundary_m + street.setback_m * rng.uniform(0.8, 1.2)
    back_m = front_m + size_m[1]
    foot = np.array([middle_m, side * (front_m + back_m) / 2, 0.0])
    yield StreetObject("wall", build_house(foot, size_m, -side, rng.uniform(0.3, 0.7)))
    if rng.uniform() < 0.3:
        yield _draw_car(edge_m + 1.7, side * (boundary_m + 2.8), np.pi / 2, rng)
    yield from _bound_garden(middle_m + 1.7, side * boundary_m, width_m - 3.7, street.planting, rng)
    garden_m = (boundary_m + 1.2, front_m - 0.6)
    n_trees = rng.poisson(0.3 * street.planting)
    n_bushes = rng.poisson(1.2 * street.planting)
    yield from _plant(middle_m + 1.7, width_m - 3.4, side, garden_m, n_trees, n_bushes, rng)
    behind_m = (back_m + 3.0, back_m + 14.0)
    yield from _plant(middle_m, width_m, side, behind_m, rng.poisson(1.0), 0, rng)


def _bound_garden(
    x: float, y: float, length_m: float, planting: float, rng: np.random.Generator
) -> Iterator[StreetObject]:
    """A hedge, a low wall or nothing along the street."""
    foot = np.array([x, y, 0.0])
    style = rng.uniform()
    if style < 0.3 * planting:
        yield build_hedge(foot, np.array([length_m, 0.9, rng.uniform(0.8, 1.7)]), rng)
    elif style < 0.5:
        size_m = np.array([length_m, 0.25, rng.uniform(0.5, 1.3)])
        yield StreetObject("wall", build_box(foot, size_m, rng.uniform(0.3, 0.6)))


def _plant(
    middle_m: float,
    width_m: float,
    side: int,
    bounds_m: tuple[float, float],
    n_trees: int,
    n_bushes: int,
    rng: np.random.Generator,
) -> Iterator[StreetObject]:
    """Trees and bushes at random places of a bed.

    Parameters
    ----------
    middle_m, width_m : along the street
    side : of the street, 1 or -1
    bounds_m : distances of the bed from the middle of the street
    """
    for number in range(n_trees + n_bushes):
        x = middle_m + width_m * rng.uniform(-0.5, 0.5)
        foot = np.array([x, side * rng.uniform(*bounds_m), 0.0])
        if number < n_trees:
            yield build_tree(foot, rng.uniform(4.0, 11.0), rng)
        else:
            yield build_bush(foot, rng.uniform(0.5, 1.2), rng)
