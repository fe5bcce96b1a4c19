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
MAX_RANGE_M = 150.0
_UNITS = (("inches", 39.37), ("centimetres", 100), ("millimetres", 1000))
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
    measured = as_ros(points[is_finite & points.any(axis=1)], settings.frame_of(side))
    if T_real_sim is not None:
        measured = measured @ T_real_sim[:, :3].T
    warnings = implausible(measured, side, settings.min_range_m)
    share = 1.0 - float(is_finite.mean()) if len(points) else 0.0
    if share > _MAX_NOT_FINITE:
        dropped = f"{share:.0%} of the points are not finite (NaN or infinite) and are dropped"
        warnings.append(f"{dropped}; is the export complete?")
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
    odd = []
    low, high = np.percentile(points, [1, 99], axis=0)
    spread = high - low
    reach = np.abs([low, high]).max()
    are_angles = _are_angles(points)
    if reach > FAR_COORDINATE_M:
        unit = _unit(low, high)
        words = f"{reach:.0f} m" if reach < FARTHEST_M else f"{reach:.0e} m"
        question = "a scan has its sensor at (0, 0, 0): are they projected?"
        if unit:
            question = f"expected metres: are they {unit}?"
        odd.append(f"coordinates reach {words}; {question}")
    elif spread.max() < SMALLEST_EXTENT_M:
        odd.append(f"all points are within {spread.max():.2g} m; expected metres")
    elif not are_angles and spread[2] > max(STEEP_SPREAD_M, STEEP_SPREAD * spread[:2].max()):
        odd.append(
            f"z spans {spread[2]:.0f} m and x and y {spread[0]:.0f} and {spread[1]:.0f} m: is z up, "
            f"are the columns right? see input.{side}_frame and input.columns"
        )
    if are_angles:
        odd.append(
            "one column is spread evenly over a turn, and one is never negative: are they angles and ranges?"
        )
    place, n_there = _most_repeated(points)
    if n_there > _REPEATED_SHARE * len(points):
        words = ", ".join(f"{value:.4g}" for value in place)
        odd.append(
            f"{n_there / len(points):.0%} of the points are one repeated point ({words}): rays without a return?"
        )
        points = points[(points != place).any(axis=1)]
        if not len(points):
            return odd
    range_m = np.linalg.norm(points, axis=1)
    near = float(np.mean(range_m < EGO_RANGE_M))
    if near > 0.5:
        left = float(np.mean((range_m >= min_range_m) & (range_m < EGO_RANGE_M)))
        odd.append(
            f"{near:.0%} of the points are within {EGO_RANGE_M:g} m; hits on the ego vehicle? {left:.1%} are kept by "
            f"input.min_range_m={min_range_m:g}; input.min_range_m={EGO_RANGE_M:g} or input.exclude_box drops them"
        )
    return odd


def _are_angles(points: FloatArray) -> bool:
    """True if the columns are azimuth, elevation (or angle from the zenith) and range, in degrees or radians."""
    quantiles = np.quantile(points, np.linspace(0.0, 1.0, 5), axis=0)
    spans = np.ptp(quantiles, axis=0)
    for turn, right_angle in ((360.0, 90.0), (2 * np.pi, np.pi / 2)):
        uneven = np.abs(np.diff(quantiles, axis=0) / np.maximum(spans, 1e-9) - 0.25).max(axis=0)
        is_azimuth = (spans > 0.9 * turn) & (spans < 1.001 * turn) & (uneven < _EVEN)
        is_small = (np.abs(quantiles) <= right_angle).all(axis=0)
        is_around_horizon = (quantiles[-1] <= 2 * right_angle) & (
            np.abs(quantiles[2] - right_angle) < right_angle / 3
        )
        is_elevation = (is_small & (quantiles[0] < 0) | is_around_horizon) & ~is_azimuth
        is_range = (quantiles[0] >= 0) & ~is_azimuth & ~is_elevation
        if is_azimuth.any() and is_elevation.any() and is_range.any():
            return True
    return False


def _most_repeated(points: FloatArray) -> tuple[FloatArray, int]:
    """The point that most rows have, and how many."""
    in_order = points[np.lexsort(points.T)]
    first = np.flatnonzero(np.append(True, (np.diff(in_order, axis=0) != 0).any(axis=1)))
    counts = np.diff(first, append=len(points))
    most = counts.argmax()
    return in_order[first[most]], int(counts[most])


def _unit(low: FloatArray, high: FloatArray) -> str:
    """Units in which the points surround a sensor at the usual range, two at most; "" if there are none."""
    if (low[:2] > 0).any() or (high[:2] < 0).any():
        return ""
    reach = np.abs([low, high]).max()
    fitting = [name for name, factor in _UNITS if reach / factor <= MAX_RANGE_M]
    return " or ".join(fitting[:2] if "inches" in fitting else fitting[:1])


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
