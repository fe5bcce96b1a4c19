"""Pose of a simulated side relative to the real one, with the scale of its elevations."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..arrays import FloatArray, level_m
from ..displacement import Displacement, fit_displacement
from ..linalg.nearest import search_tree
from ..sensor_description import SensorDescription, describe_sensor
from .beams import DOUBTFUL_BEAMS, elevation_scale
from .distance import surface_distance
from .sides import Side

_LEAST_SCALE = 0.004  # elevation scale that is tried
_BETTER = 0.97  # of the distance without a scale, which confirms it


@dataclass(frozen=True)
class Pose:
    """Pose of a simulated side relative to the real one.

    displacement : of the simulated side
    elevation_scale : by which its elevations are too large; None if the beams of both sides do not correspond
    sensor : its sensor, as it is without the displacement
    """

    displacement: Displacement
    elevation_scale: float | None
    sensor: SensorDescription

    def undisplaced(self, sim: Side) -> Side:
        """The simulated side without its displacement and the scale of its elevations."""
        points = undo_elevation_scale(sim.points, self.elevation_scale or 0.0)
        points = self.displacement.undo(points, sim.moves_with_road)
        return replace(sim, points=points, sensor=self.sensor)


def fit_pose(real: Side, sim: Side) -> tuple[Pose, Side] | None:
    """Pose of the simulated side, and the side without its displacement; None without enough surface in common.

    A scale of the elevations of the beams counts only if undoing it brings the surfaces closer: beams can also be
    spaced differently without distorting the world.
    """
    displacement = fit_displacement(real.tree, sim.tree, real.moves_with_road)
    if displacement is None:
        return None
    aligned = replace(sim, points=displacement.undo(sim.points, sim.moves_with_road))
    scale = elevation_scale(real, sim)
    confirmed = None if scale is None else 0.0
    if scale is not None and abs(scale) >= _LEAST_SCALE:
        points = undo_elevation_scale(sim.points, scale)
        other = fit_displacement(real.tree, search_tree(points), real.moves_with_road)
        if other is not None:
            rescaled = replace(sim, points=other.undo(points, sim.moves_with_road))
            distance_m = surface_distance(real.tree, aligned.tree)
            if surface_distance(real.tree, rescaled.tree) < _BETTER * distance_m:
                displacement, aligned, confirmed = other, rescaled, scale
    pose = Pose(displacement, confirmed, _described(real, aligned))
    return pose, replace(aligned, sensor=pose.sensor)


def undo_elevation_scale(points: FloatArray, scale: float) -> FloatArray:
    """The points with elevations divided by 1 + scale; azimuths and ranges stay."""
    factor = 1.0 / (1.0 + scale)
    if factor == 1.0:
        return points
    level = level_m(points)
    elevation = np.arctan2(points[:, 2], level)
    range_m = np.hypot(level, points[:, 2])
    new_level = range_m * np.cos(factor * elevation)
    ratio = new_level / np.maximum(level, 1e-9)
    return np.column_stack(
        [points[:, :2] * ratio[:, None], range_m * np.sin(factor * elevation)]
    )


def _described(real: Side, aligned: Side) -> SensorDescription:
    """The simulated sensor; described again without the displacement if that has blurred its beams."""
    n_real = len(real.sensor.elevation_deg)
    n_sim = len(aligned.sensor.elevation_deg)
    if not n_real or abs(n_sim - n_real) <= DOUBTFUL_BEAMS:
        return aligned.sensor
    again = describe_sensor(aligned.sensor_points)
    if not n_sim:
        return again
    return replace(
        aligned.sensor,
        elevation_deg=again.elevation_deg or aligned.sensor.elevation_deg,
    )
