"""Flaws of beams and of their angles: dead and exchanged beams, scale and noise of elevations, second returns."""

from __future__ import annotations

from itertools import combinations

import numpy as np

from ..arrays import BoolArray, FloatArray, IndexArray
from ..sensor_description import SensorDescription
from ..surfels import fit_planes
from .sides import PLANE_NEIGHBOURS, Side, medians_by_group

#: Numbers of beams that differ by at most this are not counted exactly.
DOUBTFUL_BEAMS = 3
_FEWEST_RETURNS = 20  # reference returns of a beam that is compared
_DEAD = 0.2  # share of the usual number of returns
_BIN_DEG = 2.0  # of azimuth, in which ranges of two beams are compared
_FEWEST_BINS = 10
_SUSPECT_LOG, _SUSPECT = 0.02, 2.0  # log of the range ratio, and over the median of all beams
_BETTER = 0.5  # of the difference of ranges to the same beam, that to the exchanged beam
_MOST_RESIDUAL_DEG = 0.05
_FEWEST_BEAMS = 8
_SAME_HEIGHT_M = 0.04  # between the heights at which beams start
_LEAST_RESULTANT = 0.03  # of phases between beams
_COHERENT = 0.8  # resultant of the mean phases of all beams
_ROAD_M = (8.0, 40.0)
_ROAD_POINTS = 4000
_SAME_RAY = 2e-4  # chord between two directions of one ray
_MOST_RETURNS = 9  # of one ray that are compared
_BEHIND_M = 0.3


def dead_beams(sensor: SensorDescription, reference: IndexArray, side: Side) -> IndexArray:
    """Beams of a sensor that return almost nothing on a side, although they do on the reference side.

    A beam is dead if it has less than 0.2 of the returns that it would have at the ratio of all returns.

    Parameters
    ----------
    reference : (n,) beam of each return of the reference side
    """
    n_beams = len(sensor.elevation_deg)
    n_reference = np.bincount(reference, minlength=n_beams)
    n_side = np.bincount(_beams_hit(sensor, side), minlength=n_beams)
    is_compared = n_reference >= _FEWEST_RETURNS
    usual = n_side[is_compared].sum() / max(n_reference[is_compared].sum(), 1)
    return np.flatnonzero(is_compared & (n_side < _DEAD * usual * n_reference))


def _beams_hit(sensor: SensorDescription, side: Side) -> IndexArray:
    """Beam of each point within 0.4 of the spacing from one."""
    elevation = sensor.elevation_of(side.sensor_points)
    beam = sensor.beam_of(side.sensor_points)
    spacing = np.gradient(sensor.beams_deg)
    return beam[np.abs(elevation - sensor.beams_deg[beam]) < 0.4 * spacing[beam]]


def exchanged_beams(
    sensor: SensorDescription, reference: Side, side: Side
) -> list[tuple[int, int]]:
    """Pairs of beams of a sensor whose ranges are exchanged on a side.

    The ranges of a beam over azimuth are a profile of the scene. Two beams are exchanged if the profile of each is
    nearest to that of the other on the reference side, by the median ratio of ranges, and at most half as far from it
    as from that of the same beam.
    """
    profiles = _range_profiles(sensor, side)
    expected = _range_profiles(sensor, reference)
    distances = _profile_distances(profiles, expected)
    known = np.isfinite(distances)
    if not known.any():
        return []
    limit = max(_SUSPECT_LOG, _SUSPECT * float(np.median(distances[known])))
    nearest = {}
    for beam in np.flatnonzero(known & (distances > limit)).tolist():
        to_others = _profile_distances(profiles[beam], expected)
        best = int(np.nanargmin(to_others))
        if to_others[best] < _BETTER * distances[beam]:
            nearest[beam] = best
    return [(a, b) for a, b in combinations(nearest, 2) if nearest[a] == b and nearest[b] == a]


def _range_profiles(sensor: SensorDescription, side: Side) -> FloatArray:
    """(beams, bins) log of the median range of each beam and bin of azimuth; NaN without a return."""
    n_bins = round(360.0 / _BIN_DEG)
    column = ((side.azimuth_deg + 180.0) // _BIN_DEG).astype(np.intp) % n_bins
    cell = sensor.beam_of(side.sensor_points) * n_bins + column
    n_returns, median_m = medians_by_group(
        side.range_m, cell, len(sensor.elevation_deg) * n_bins
    )
    return np.where(n_returns > 0, np.log(median_m), np.nan).reshape(-1, n_bins)


def _profile_distances(profiles: FloatArray, expected: FloatArray) -> FloatArray:
    """(beams,) median absolute difference of profiles; NaN if they share too few bins."""
    difference = np.sort(np.abs(profiles - expected), axis=1)  # NaN last
    n_bins = np.isfinite(difference).sum(axis=1, keepdims=True)
    middle = np.hstack([(n_bins - 1) // 2, n_bins // 2])
    median = np.take_along_axis(difference, middle, axis=1).mean(axis=1)
    return np.where(n_bins[:, 0] >= _FEWEST_BINS, median, np.nan)


def elevation_scale(reference: Side, side: Side) -> float | None:
    """Elevations of a side's beams over those of a reference, minus 1; None if no scale and offset fit both.

    Both need the same number of beams, and beams that start at the same heights. A road that is too high, which fills
    most of a scan, also looks like beams of another scale, or of another height: the scale is 0 if objects are seen
    along the beams of the reference.
    """
    sensors = (reference.sensor, side.sensor)
    beams_deg = reference.sensor.beams_deg
    other_deg = side.sensor.beams_deg
    if len(other_deg) < _FEWEST_BEAMS:
        return None
    heights_m = [sensor.origin_height_m or (0.0,) for sensor in sensors]
    apart_m = [heights_m[0][end] - heights_m[1][end] for end in (0, -1)]
    if len(beams_deg) != len(other_deg) or np.abs(apart_m).max() > _SAME_HEIGHT_M:
        return None
    scale, offset = np.polyfit(beams_deg, other_deg, 1)
    residual_deg = np.abs(other_deg - scale * beams_deg - offset)
    if np.median(residual_deg) >= _MOST_RESIDUAL_DEG:
        return None
    objects = side.sensor_points[~side.is_ground]
    if len(objects):
        off_deg = [_off_beams_deg(sensor, objects) for sensor in sensors]
        if off_deg[0] < off_deg[1]:
            return 0.0
    return float(scale) - 1.0


def _off_beams_deg(sensor: SensorDescription, points: FloatArray) -> float:
    """Median difference of the elevations of points from the nearest beam."""
    off_deg = sensor.elevation_of(points) - sensor.beams_deg[sensor.beam_of(points)]
    return float(np.median(np.abs(off_deg)))


def blurred_elevation_deg(sensor: SensorDescription, side: Side) -> float | None:
    """Standard deviation of the elevations of a side around the beams of a sensor; None if they are unrelated to them.

    The phase of an elevation between two neighbouring beams, spaced s apart, has the resultant exp(-2 pi^2 sigma^2 /
    s^2) if elevations scatter normally with sigma around the beams (Mardia and Jupp, Directional Statistics, 2000). It
    also works if the noise is so large that no beams can be recognised on the side.
    """
    beams_deg = sensor.beams_deg
    elevation_deg = sensor.elevation_of(side.sensor_points)
    below = np.searchsorted(beams_deg, elevation_deg) - 1
    is_inside = (below >= 0) & (below < len(beams_deg) - 1)
    below = below[is_inside]
    if len(below) < _FEWEST_RETURNS * _FEWEST_BEAMS:
        return None
    spacing_deg = np.diff(beams_deg)
    phase = 2 * np.pi * (elevation_deg[is_inside] - beams_deg[below]) / spacing_deg[below]
    direction = np.exp(1j * phase)
    by_gap = np.bincount(below, direction.real) + 1j * np.bincount(below, direction.imag)
    by_gap = by_gap[by_gap != 0]
    coherence = (by_gap / np.abs(by_gap)).mean().real
    resultant = float(direction.mean().real)
    if coherence < _COHERENT or resultant < _LEAST_RESULTANT:
        return None
    from scipy.optimize import brentq  # takes a third of a second to load

    spacings_deg = spacing_deg[below]

    def excess(sigma_deg: float) -> float:
        """Resultant of this noise over that of the side."""
        return float(np.exp(-2 * np.pi**2 * sigma_deg**2 / spacings_deg**2).mean()) - resultant

    return float(brentq(excess, 0.0, float(spacing_deg.max())))


def road_blur_deg2(side: Side) -> float | None:
    """Slope of the variance of the road's height over the squared range, degrees^2; None without enough road.

    Noise of the elevation of sigma radians moves a return on the road up and down by range times sigma, so that the
    slope grows by sigma^2, whatever the beams are. Roughness and range noise hardly depend on the range.
    """
    is_road = side.is_ground & (side.range_m > _ROAD_M[0]) & (side.range_m < _ROAD_M[1])
    rows = np.flatnonzero(is_road)
    if len(rows) < _FEWEST_RETURNS * _FEWEST_BEAMS:
        return None
    rows = rows[:: len(rows) // _ROAD_POINTS + 1]
    planes = fit_planes(side.points[is_road], side.points[rows], PLANE_NEIGHBOURS)
    squared_range = side.range_m[rows] ** 2
    is_near = squared_range < np.median(squared_range)
    variance_near = np.median(planes.variance[is_near, 0])
    variance_far = np.median(planes.variance[~is_near, 0])
    step = np.median(squared_range[~is_near]) - np.median(squared_range[is_near])
    return float((variance_far - variance_near) / step * np.degrees(1.0) ** 2)


def second_returns(side: Side, behind_m: float = _BEHIND_M) -> BoolArray:
    """(n,) True for returns this far behind another one of the same ray: equal direction, larger range."""
    next_chord, _ = side.ray_tree.query(side.rays, k=[2], distance_upper_bound=_SAME_RAY)
    rows = np.flatnonzero(np.isfinite(next_chord))  # of rays with several returns
    _, near = side.ray_tree.query(
        side.rays[rows], k=_MOST_RETURNS, distance_upper_bound=_SAME_RAY
    )
    nearest_m = np.append(side.range_m, np.inf)[near].min(axis=1)  # the last row: no neighbour
    is_second = np.zeros(len(side.points), dtype=np.bool_)
    is_second[rows] = side.range_m[rows] > nearest_m + behind_m
    return is_second
