"""The two scans of a pair as the estimators of causes need them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.spatial import cKDTree

from ..arrays import BoolArray, FloatArray, IndexArray, azimuths_deg, sorted_rows
from ..clean import seen_from
from ..linalg.nearest import search_tree
from ..pieces import CutScan
from ..sensor_description import SensorDescription
from ..surfels import LocalPlanes, fit_planes
from ..trust import BEAMS

#: Returns beyond this range are far.
FAR_M = 25.0
#: l3 / l1 of foliage, and more.
SCATTERED = 0.1
#: Neighbours that define the plane around a point.
PLANE_NEIGHBOURS = 20
_LOW_M = 0.5
_GRAZING_DEG = 75.0  # between the ray and the normal of the surface


@dataclass(frozen=True, eq=False)
class Side:
    """Clean points of one side, with what is derived from them when first used.

    points : (n, 3) float64, metres, in the real sensor's frame
    is_ground : (n,) bool
    sensor : description of the side's sensor, from the points as recorded
    T_real_sim : (3, 4) float64, of the simulated side, if its frame is another
    is_low : (n,) bool, what moves with the road if this is too high or too low; the ground by default
    """

    points: FloatArray
    is_ground: BoolArray
    sensor: SensorDescription
    T_real_sim: FloatArray | None = None
    is_low: BoolArray | None = None

    @property
    def moves_with_road(self) -> BoolArray:
        """(n,) True for the ground, and for verges and all else that is low."""
        return self.is_ground if self.is_low is None else self.is_low

    @cached_property
    def range_m(self) -> FloatArray:
        """(n,) distance from the real sensor."""
        range_m: FloatArray = np.maximum(np.linalg.norm(self.points, axis=1), 1e-9)
        return range_m

    @cached_property
    def rays(self) -> FloatArray:
        """(n, 3) directions, unit vectors."""
        return self.points / self.range_m[:, None]

    @cached_property
    def azimuth_deg(self) -> FloatArray:
        """(n,) direction around the vertical, 0 ahead, positive to the left."""
        return azimuths_deg(self.points)

    @cached_property
    def sorted_azimuth_deg(self) -> FloatArray:
        """(n,) the azimuths, ascending."""
        return np.sort(self.azimuth_deg)

    @cached_property
    def azimuth_gap_deg(self) -> float:
        """Gap between neighbouring azimuths in which a random direction lies: the azimuth step of common columns."""
        gap_deg = np.sort(np.diff(self.sorted_azimuth_deg))
        return float(gap_deg[np.searchsorted(np.cumsum(gap_deg), gap_deg.sum() / 2)])

    @cached_property
    def elevation_deg(self) -> FloatArray:
        """(n,) angle above the horizon."""
        return np.degrees(np.arcsin(self.rays[:, 2]))

    @cached_property
    def sensor_points(self) -> FloatArray:
        """(n, 3) the points in the frame of the side's sensor, in which its beams are."""
        if self.T_real_sim is None:
            return self.points
        rotation = self.T_real_sim[:, :3]
        return (self.points - self.T_real_sim[:, 3]) @ rotation

    @cached_property
    def tree(self) -> cKDTree:
        """Search tree of the points."""
        return search_tree(self.points)

    @cached_property
    def ray_tree(self) -> cKDTree:
        """Search tree of the directions."""
        return search_tree(self.rays)

    def near_rays(self, rows: IndexArray, n_around: int) -> tuple[FloatArray, IndexArray]:
        """Chord from some rays to the nearest others, and the rows of these, (k, n_around) each."""
        chord, near = self.ray_tree.query(self.rays[rows], k=n_around + 1)
        is_self = near == rows[:, None]
        has_no_self = ~is_self.any(axis=1)  # more other rays than these have the same direction
        is_self[has_no_self, -1] = True
        return chord[~is_self].reshape(-1, n_around), near[~is_self].reshape(-1, n_around)

    @cached_property
    def object_rows(self) -> IndexArray:
        """(k,) rows of the points that are not ground, neighbours next to each other, which speeds up searches."""
        order: IndexArray = self.tree.indices
        return order[~self.is_ground[order]]

    @cached_property
    def object_planes(self) -> LocalPlanes:
        """Planes through the neighbours of each point that is not ground."""
        return fit_planes(self.tree, self.points[self.object_rows], PLANE_NEIGHBOURS)

    @cached_property
    def normals(self) -> FloatArray:
        """(n, 3) normal of the surface at each point, of the ground the vertical; NaN on no plane."""
        planes = self.object_planes
        is_plane = (planes.scattering < SCATTERED) & ~planes.is_line
        normals = np.tile([0.0, 0.0, 1.0], (len(self.points), 1))
        normals[self.object_rows] = np.where(is_plane[:, None], planes.normal, np.nan)
        return normals

    @cached_property
    def incidence_deg(self) -> FloatArray:
        """(n,) angle between ray and normal of the surface; NaN on no plane."""
        cosine = np.minimum(np.abs((self.normals * self.rays).sum(axis=1)), 1.0)
        return np.degrees(np.arccos(cosine))

    def concerned(self, cause: str) -> BoolArray:
        """(n,) True for the returns of which a cause loses some: far ones, grazing ones, or all."""
        if cause == "lost far returns":
            return self.range_m > FAR_M
        if cause == "lost grazing returns":
            return self.incidence_deg > _GRAZING_DEG
        return np.ones(len(self.points), dtype=np.bool_)

    def chosen(self, is_kept: BoolArray | IndexArray) -> Side:
        """The side with some of its points, or all of them in another order."""
        rows = np.arange(len(self.points))[is_kept]
        return replace(
            self,
            points=self.points.take(rows, axis=0),
            is_ground=self.is_ground[rows],
            is_low=self.moves_with_road[rows],
        )


def recorded_side(
    scan: CutScan,
    sensor: SensorDescription,
    T_real_sim: FloatArray | None = None,
    position: tuple[float, float, float] | None = None,
    voxel_m: float | None = None,
) -> Side:
    """A side of clean points, with the sensor at the origin.

    The points are in the order of their coordinates, so that nothing depends on the order of rows.

    Parameters
    ----------
    scan : clean points; less than 0.5 m above the road is low
    sensor, T_real_sim : see `Side`
    position : of the sensor in the frame of the points of both sides; the origin by default
    voxel_m : voxel by which the points were thinned, so that returns cannot be counted; None if they were not
    """
    if voxel_m is not None:
        thinned = f"thinned by input.voxel_m={voxel_m:g}, so that its returns cannot be counted"
        sensor = replace(sensor, doubts=sensor.doubts | {BEAMS: thinned})
    points = scan.points
    if position is not None:
        points = points - position
        T_real_sim = seen_from(position, T_real_sim)
    is_low = scan.is_ground | (scan.height_m < _LOW_M)
    side = Side(points, scan.is_ground, sensor, T_real_sim, is_low)
    return side.chosen(sorted_rows(*side.points.T[::-1]))


@dataclass(frozen=True)
class PairScans:
    """Both sides of a pair."""

    real: Side
    sim: Side


def medians_by_group(
    values: FloatArray, group: IndexArray, n_groups: int
) -> tuple[IndexArray, FloatArray]:
    """(g,) number of values of each group, and (g,) their median, the larger of two; any value for an empty group.

    Parameters
    ----------
    values, group : (n,) float64 and (n,) intp, at least one
    """
    n_values = np.bincount(group, minlength=n_groups)
    middle = np.cumsum(n_values) - n_values + n_values // 2
    order = np.argsort(values)
    small = group[order].astype(np.min_scalar_type(n_groups))  # of which a stable sort is fast
    ordered = values[order[np.argsort(small, kind="stable")]]
    return n_values, ordered[np.minimum(middle, len(ordered) - 1)]


def noise_bounds(sensor: SensorDescription) -> tuple[float, float] | None:
    """Lower and upper estimate of the range noise of a sensor without that of its range steps, q / sqrt(12)."""
    high_m = sensor.range_noise_m
    if high_m is None:
        return None
    low_m = high_m if sensor.range_noise_low_m is None else sensor.range_noise_low_m
    step_m = sensor.range_quantum_m or 0.0
    return _without_steps(low_m, step_m), _without_steps(high_m, step_m)


def _without_steps(noise_m: float, step_m: float) -> float:
    return float(np.sqrt(max(noise_m**2 - step_m**2 / 12, 0.0)))


def most_noise_m(sensor: SensorDescription) -> float:
    """Upper estimate of the range noise of a sensor without that of its range steps; 0 if it is unknown."""
    bounds = noise_bounds(sensor)
    return 0.0 if bounds is None else bounds[1]
