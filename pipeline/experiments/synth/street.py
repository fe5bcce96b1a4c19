"""The course of a street: its bend, width and rise, and how much stands along it.

Decides where a place along the street lies in the sensor's frame. Leaves to others: what stands there (`scene`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ....stages.arrays import BoolArray, FloatArray

_KERB_M = 0.1


@dataclass(frozen=True)
class Street:
    """What one street has in common along its length.

    Places on it have an s along its middle line, 0 beside the sensor, growing forward, and an n to the left of that.

    bend_per_m : curvature, positive to the left
    lane_m : n of the sensor
    half_road_m, pavement_m, setback_m : from the middle to the kerb, to the garden boundary, to the house fronts
    grade : rise of the road, metres a metre
    crossing_m : s of a side street, null without one
    parking, planting, building : how likely kerbs, gardens and plots are used
    leaf_scale : how much larger leaves are than usual, and the fewer
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
        s, n, above = (np.asarray(of, dtype=np.float64) for of in (s, n, above))
        k = self.bend_per_m
        x = np.sin(k * s) / k - n * np.sin(k * s)
        y = (1 - np.cos(k * s)) / k + n * np.cos(k * s) - self.lane_m
        return np.stack(np.broadcast_arrays(x, y, self.height(s, n) + above), axis=-1)

    def along(self, s: float) -> FloatArray:
        """(3,) float64, unit vector of growing s."""
        turn = self.bend_per_m * s
        return np.array([np.cos(turn), np.sin(turn), 0.0])

    def height(self, s: FloatArray, n: FloatArray) -> FloatArray:
        """Height of road, pavement or garden in the sensor frame."""
        beside = np.abs(n) > self.half_road_m
        raised = np.where(beside & ~self.is_crossed(s), _KERB_M, 0.0)
        camber = 0.01 * np.minimum(np.abs(n), self.half_road_m)
        swell = 0.01 * np.sin(s / 7.0) * np.cos(n / 5.0)
        height: FloatArray = -self.sensor_height_m + self.grade * s + raised - camber + swell
        return height

    def is_crossed(self, s: ArrayLike, margin_m: float = 0.0) -> BoolArray:
        """Whether the side street opens here."""
        if self.crossing_m is None:
            return np.zeros(np.shape(s), dtype=np.bool_)
        is_crossed: BoolArray = np.abs(np.asarray(s) - self.crossing_m) < self.half_road_m + margin_m
        return is_crossed


def draw_street(rng: np.random.Generator, leaf_scale: float = 1.0) -> Street:
    """A street unlike the others."""
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
