"""Plausibility of the points of a scan: units, axes, hits on the ego vehicle, a half sweep."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..schemas.columns import FARTHEST_M
from ..schemas.settings import InputSettings
from .arrays import FloatArray, azimuths_deg
from .clean import as_ros

FAR_COORDINATE_M = 1000.0
SMALLEST_EXTENT_M = 1.0
STEEP_SPREAD = 0.5
STEEP_SPREAD_M = 20.0
HALF_SWEEP_GAP_DEG = 90.0
EGO_RANGE_M = 3.0
_MAX_NOT_FINITE = 0.25
_REPEATED_SHARE = 0.02
_EVEN = 0.08


@dataclass(frozen=True)
class ScanInspection:
    """Result of inspecting the points of a scan.

    azimuth_gap_deg : widest sector around the sensor without a point
    warnings : one line each
    """

    azimuth_gap_deg: float
    warnings: tuple[str, ...] = ()


def inspect_points(
    points: FloatArray, side: str, settings: InputSettings, T_real_sim: FloatArray | None = None
) -> ScanInspection:
    """Inspect the points of a scan before it is cleaned.

    Parameters
    ----------
    points : (n, 3) float64, as read, in the side's own frame
    side : "real" or "sim"
    T_real_sim : (3, 4) float64 of the simulated side; its rotation counts as a part of the axes
    """
    is_finite = np.isfinite(points).all(axis=1)
    is_measured = is_finite & points.any(axis=1)
    measured = as_ros(points[is_measured], settings.frame_of(side))
    if T_real_sim is not None:
        measured = measured @ T_real_sim[:, :3].T
    warnings = implausible(measured, side, settings.min_range_m)
    share = 1.0 - float(is_finite.mean()) if len(points) else 0.0
    if share > _MAX_NOT_FINITE:
        warnings.append(
            f"{share:.0%} of the points are not finite (NaN or infinite) and are dropped; "
            "is the export complete?"
        )
    return ScanInspection(widest_azimuth_gap_deg(measured), tuple(warnings))


@np.errstate(over="ignore", invalid="ignore")  # distances may be infinite
def implausible(points: FloatArray, side: str, min_range_m: float) -> list[str]:
    """Describe implausible values of a scan, one sentence each; an empty list without points.

    Parameters
    ----------
    points : (n, 3) float64, metres, the scan's own frame, finite and not zero
    side : "real" or "sim", for the suggested setting
    min_range_m : present minimum range; nearer points are dropped
    """
    if not len(points):
        return []
    odd = _odd_coordinates(points, side)
    place, n_there = _most_repeated(points)
    if n_there > _REPEATED_SHARE * len(points):
        numbers = ", ".join(f"{value:.4g}" for value in place)
        odd.append(
            f"{n_there / len(points):.0%} of the points are one repeated point ({numbers}): "
            "rays without a return?"
        )
        points = points[(points != place).any(axis=1)]
    range_m = np.linalg.norm(points, axis=1)
    is_near = range_m < EGO_RANGE_M
    if np.count_nonzero(is_near) > 0.5 * len(points):
        left = np.mean(is_near & (range_m >= min_range_m))
        odd.append(
            f"{is_near.mean():.0%} of the points are within {EGO_RANGE_M:g} m; hits on the ego vehicle? "
            f"{left:.1%} are kept by input.min_range_m={min_range_m:g}; "
            f"input.min_range_m={EGO_RANGE_M:g} or input.exclude_box drops them"
        )
    return odd


def _odd_coordinates(points: FloatArray, side: str) -> list[str]:
    """Sentences for coordinates that are too large, too small, steep, or angles."""
    low, high = np.percentile(points, [1, 99], axis=0)
    width, depth, height = high - low
    level = max(width, depth)
    reach = np.abs([low, high]).max()
    are_angles = _are_angles(points)
    odd = []
    if reach > FAR_COORDINATE_M:
        metres = f"{reach:.0f} m" if reach < FARTHEST_M else f"{reach:.0e} m"
        odd.append(
            f"coordinates reach {metres}; expected metres, with the sensor at (0, 0, 0): "
            "are they projected, or in another unit?"
        )
    elif max(level, height) < SMALLEST_EXTENT_M:
        odd.append(f"all points are within {max(level, height):.2g} m; expected metres")
    elif not are_angles and height > max(STEEP_SPREAD_M, STEEP_SPREAD * level):
        odd.append(
            f"z spans {height:.0f} m and x and y {width:.0f} and {depth:.0f} m: is z up, "
            f"are the columns right? see input.{side}_frame and input.columns"
        )
    if are_angles:
        odd.append(
            "one column is spread evenly over a turn, and one is never negative: "
            "are they angles and ranges?"
        )
    return odd


def _are_angles(points: FloatArray) -> bool:
    """True if the columns are azimuth, elevation (or angle from the zenith) and range, in degrees or radians."""
    quantiles = np.quantile(points, np.linspace(0.0, 1.0, 5), axis=0)
    lowest, _, middle, _, highest = quantiles
    span = highest - lowest
    shares = np.diff(quantiles, axis=0) / np.maximum(span, 1e-9)
    is_even = np.abs(shares - 0.25).max(axis=0) < _EVEN
    for turn, right_angle in ((360.0, 90.0), (2 * np.pi, np.pi / 2)):
        is_azimuth = is_even & (span > 0.9 * turn) & (span < 1.001 * turn)
        is_small = (np.abs(quantiles) <= right_angle).all(axis=0)
        is_from_horizon = is_small & (lowest < 0)
        is_from_zenith = (highest <= 2 * right_angle) & (
            np.abs(middle - right_angle) < right_angle / 3
        )
        is_elevation = (is_from_horizon | is_from_zenith) & ~is_azimuth
        is_range = (lowest >= 0) & ~is_azimuth & ~is_elevation
        if is_azimuth.any() and is_elevation.any() and is_range.any():
            return True
    return False


def _most_repeated(points: FloatArray) -> tuple[FloatArray, int]:
    """The point that most rows have, and how many."""
    in_order = points[np.lexsort(points.T)]
    is_other = (in_order[1:] != in_order[:-1]).any(axis=1)
    first = np.flatnonzero(np.append(True, is_other))
    counts = np.diff(first, append=len(points))
    most = counts.argmax()
    return in_order[first[most]], int(counts[most])


def widest_azimuth_gap_deg(points: FloatArray) -> float:
    """Widest sector around +Z without points, in degrees; 360 without any point.

    Parameters
    ----------
    points : (n, 3) float64, the scan's own frame, finite
    """
    if not len(points):
        return 360.0
    azimuth = np.sort(azimuths_deg(points))
    return float(np.diff(azimuth, append=azimuth[0] + 360.0).max())
