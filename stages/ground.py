"""Ground removal: the PCA Z-cut of the paper ("Data Collection and Graph Build-up")."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace

import numpy as np
import scipy

from ..schemas.errors import StageError
from ..schemas.settings import GroundSettings
from .arrays import BoolArray, FloatArray
from .linalg.nearest import nearest_points, search_tree

MIN_OBJECT_POINTS = 8
MAX_TILT_DEG = 10.0
NEAR_M = 30.0
WINDOW_M = 0.1
STEP_M = 0.05
DEPTH_M = 1.0
CELL_M = 0.5
MIN_COMMON_CELLS = 20
#: A simulated point on the real road is no object if the real scan has an object nowhere within this distance.
NO_OBJECT_M = 1.0
PEAKS_APART_M = 0.05
_ROUNDING_M = 1e-9


@dataclass(frozen=True)
class GroundResult:
    """A ground cut and its effect on one scan.

    is_ground : (n,) bool
    height_m : (n,) float64, along the axis, from the road's peak
    axis : (3,) float64, unit vector along which heights are measured
    tilt_deg : angle of the PCA axis to +Z; above 10 degrees `axis` is +Z instead
    peak_m, threshold_m : heights p . axis of the road and of the cut; threshold None if the method has none
    loss, iterations : variance loss at the threshold, and number of times it was lowered; None without a threshold
    notes : notes for the user about this cut
    """

    is_ground: BoolArray
    height_m: FloatArray
    axis: FloatArray
    tilt_deg: float
    peak_m: float
    threshold_m: float | None
    loss: float | None
    iterations: int | None
    notes: tuple[str, ...] = ()


def remove_ground(
    points: FloatArray,
    settings: GroundSettings,
    shared: GroundResult | None = None,
    real_points: FloatArray | None = None,
) -> GroundResult:
    """Classify points of a scan as ground by a cut through their heights.

    Heights are h = p . axis along the PCA axis nearest +Z (+Z itself if the axis is tilted by more than 10 degrees).
    The road's peak is the median of the fullest 0.1 m window over the sorted heights of the points within 30 m
    (the lowest of equally full windows). The threshold z starts at peak + `prior_m`; while its variance loss is above
    `max_variance_loss` and z is above the peak it is lowered by 0.05 m, the last step ending at the peak. Points with
    h < z are ground. The variance loss ("within 1 % of the total variance") is, by `loss`:

    removed : sum (h_r - mean h_r)^2 over removed points r above peak - 1 m, over sum (h - mean h)^2 of all points
    total : |tr Cov(kept) - tr Cov(all)| / tr Cov(all)

    With `real_points`, points above the cut that lie on the real road are ground, too (`_on_real_road`).

    Parameters
    ----------
    points : (n, 3) float64, metres, cleaned, at least 8
    settings : method and thresholds
    shared : the cut of the real side, applied unchanged (`ground.shared`), or moved by the height of this side's road
        above the real one if `real_points` are given (`ground.peak = "real"`), and then with the ground flags and
        heights of the real points
    real_points : (m, 3) float64, metres, cleaned points of the real side

    Raises
    ------
    StageError
        Fewer than 8 points after the cut; or patchwork is requested and not installed.
    """
    notes: list[str] = []
    if shared and real_points is not None:
        shared = _follow_road(shared, real_points, points, notes)
    if shared:
        axis, tilt_deg, peak_m = shared.axis, shared.tilt_deg, shared.peak_m
    else:
        axis, tilt_deg = _vertical_axis(points, notes)
        peak_m = _find_peak(points, points @ axis, notes)
    height = points @ axis
    is_ground, threshold_m, loss, iterations = _cut(points, height, peak_m, settings, shared)
    if shared and real_points is not None:
        is_ground |= _on_real_road(
            points, height - peak_m, shared, real_points, settings.prior_m
        )
    n_left = int((~is_ground).sum())
    if n_left < MIN_OBJECT_POINTS:
        raise StageError(
            f"expected at least {MIN_OBJECT_POINTS} object points after ground removal, got {n_left}; "
            f"lower ground.prior_m (now {settings.prior_m:g}) "
            f"or choose another ground.method (now {settings.method})"
        )
    return GroundResult(
        is_ground,
        height - peak_m,
        axis,
        tilt_deg,
        peak_m,
        threshold_m,
        loss,
        iterations,
        tuple(notes),
    )


def _cut(
    points: FloatArray,
    height: FloatArray,
    peak_m: float,
    settings: GroundSettings,
    shared: GroundResult | None,
) -> tuple[BoolArray, float | None, float | None, int | None]:
    """Ground flags by the method of the settings; threshold, its loss, and number of times it was lowered, or None."""
    if settings.method == "none":
        return np.zeros(len(points), dtype=bool), None, None, None
    if settings.method == "patchwork":
        return _patchwork(points, peak_m), None, None, None
    if shared and shared.threshold_m is not None:
        is_ground = height < shared.threshold_m
        loss = _variance_loss(points, height, is_ground, peak_m, settings)
        return is_ground, shared.threshold_m, loss, shared.iterations
    iterations = 0
    while True:
        above_peak_m = settings.prior_m - iterations * STEP_M
        threshold_m = peak_m + (above_peak_m if above_peak_m > _ROUNDING_M else 0.0)
        is_ground = height < threshold_m
        loss = _variance_loss(points, height, is_ground, peak_m, settings)
        if loss <= settings.max_variance_loss or threshold_m <= peak_m:
            return is_ground, threshold_m, loss, iterations
        iterations += 1


def _vertical_axis(points: FloatArray, notes: list[str]) -> tuple[FloatArray, float]:
    """Principal axis nearest +Z, pointing up, and its angle to +Z; +Z instead of an axis that is tilted too much."""
    centred = points - points.mean(axis=0)
    axes: FloatArray = scipy.linalg.svd(centred, full_matrices=False)[2]
    axis = axes[np.argmax(np.abs(axes[:, 2]))]
    if axis[2] < 0:
        axis = -axis
    tilt_deg = float(np.degrees(np.arccos(min(1.0, axis[2]))))
    if tilt_deg > MAX_TILT_DEG:
        notes.append(
            f"the PCA axis is tilted by {tilt_deg:.1f} degrees (at most {MAX_TILT_DEG:.0f}); heights are along +Z"
        )
        axis = np.array([0.0, 0.0, 1.0])
    return axis, tilt_deg


def _find_peak(points: FloatArray, height: FloatArray, notes: list[str]) -> float:
    """Height of the road along the axis."""
    near = height[np.linalg.norm(points, axis=1) <= NEAR_M]
    if not len(near):
        notes.append(f"no point within {NEAR_M:.0f} m; the road's peak is that of all points")
        near = height
    return _fullest_window_median(near)


def peaks_note(real_peak_m: float, sim_peak_m: float, settings: GroundSettings) -> str:
    """Note for two sides that are cut at different road peaks, more than 5 cm apart; else ""."""
    above_m = sim_peak_m - real_peak_m
    if settings.shared or settings.peak == "real" or abs(above_m) <= PEAKS_APART_M:
        return ""
    return (
        f"the simulated road's peak is {100 * abs(above_m):.0f} cm {'above' if above_m > 0 else 'below'} the real one, "
        "and each side is cut at its own: strips of road may remain as objects. Correct the height of the simulated "
        "scan, or set ground.peak=real"
    )


def _fullest_window_median(height: FloatArray) -> float:
    """Median of the heights inside the fullest closed window of 0.1 m; for equally full windows the lowest."""
    in_order = np.sort(height)
    end = np.searchsorted(in_order, in_order + WINDOW_M, side="right")
    start = int(np.argmax(end - np.arange(len(in_order))))
    return float(np.median(in_order[start : end[start]]))


def _follow_road(
    cut: GroundResult, real: FloatArray, sim: FloatArray, notes: list[str]
) -> GroundResult | None:
    """Move the real side's cut by the height of the simulated road above the real one; None without a common road.

    The plane x, y is split into cells of 0.5 m. In each cell with points of both sides within 30 m, the difference of
    the median heights is taken; the road's is the median of the fullest 0.1 m window over these differences. Walls and
    holes change single cells, and a slope changes both sides equally. At least 20 such cells are needed.
    """
    from scipy import ndimage

    near_real = real[np.linalg.norm(real, axis=1) <= NEAR_M]
    near_sim = sim[np.linalg.norm(sim, axis=1) <= NEAR_M]
    cells = np.floor(np.vstack([near_real, near_sim])[:, :2] / CELL_M).astype(np.int64)
    cells = np.unique(cells, axis=0, return_inverse=True)[1].ravel()
    of_real, of_sim = np.split(cells, [len(near_real)])
    common = np.intersect1d(of_real, of_sim)
    if len(common) < MIN_COMMON_CELLS:
        notes.append(
            f"fewer than {MIN_COMMON_CELLS} cells within {NEAR_M:.0f} m have points of both sides; "
            "the road's peak is that of this side only"
        )
        return None
    height_real = ndimage.median(near_real @ cut.axis, of_real, common)
    height_sim = ndimage.median(near_sim @ cut.axis, of_sim, common)
    offset_m = _fullest_window_median(height_sim - height_real)
    threshold_m = None if cut.threshold_m is None else cut.threshold_m + offset_m
    return replace(cut, peak_m=cut.peak_m + offset_m, threshold_m=threshold_m)


def _on_real_road(
    points: FloatArray,
    height_m: FloatArray,
    cut: GroundResult,
    real_points: FloatArray,
    most_m: float,
) -> BoolArray:
    """True for simulated points that lie on the real road, (n,) bool.

    Road that rises is cut at one place in the real scan and at another in the simulated one. A point is road if no real
    object point is within 1 m, but real ground is, and the point is at most `most_m` higher than the nearest of it
    (heights above the roads' peaks; for equal distances the first by x, y, z).
    """
    on_road = np.zeros(len(points), dtype=bool)
    ground = real_points[cut.is_ground]
    if not len(ground):
        return on_road
    objects = search_tree(real_points[~cut.is_ground])
    distance_m, _ = objects.query(points, distance_upper_bound=2 * NO_OBJECT_M)
    no_object = np.flatnonzero(distance_m > NO_OBJECT_M)
    nearest, ground_m = nearest_points(ground, points[no_object])
    above_m = height_m[no_object] - cut.height_m[cut.is_ground][nearest]
    on_road[no_object] = (ground_m <= NO_OBJECT_M) & (above_m <= most_m)
    return on_road


def _variance_loss(
    points: FloatArray,
    height: FloatArray,
    removed: BoolArray,
    peak_m: float,
    settings: GroundSettings,
) -> float:
    """Share of the scan's variance that is lost with the removed points, by the definition that `loss` selects."""
    if settings.loss == "total":
        total = float(points.var(axis=0).sum())
        kept = float(points[~removed].var(axis=0).sum()) if not removed.all() else 0.0
        return abs(kept - total) / total if total > 0 else 0.0
    scatter = _scatter(height)
    if scatter <= len(height) * _ROUNDING_M**2:
        return 0.0  # a perfect plane: its heights differ by rounding only
    return _scatter(height[removed & (height > peak_m - DEPTH_M)]) / scatter


def _scatter(height: FloatArray) -> float:
    """Sum of squared distances from the mean; 0 without points."""
    return float(((height - height.mean()) ** 2).sum()) if len(height) else 0.0


def _patchwork(points: FloatArray, peak_m: float) -> BoolArray:
    """Ground flags of patchwork++ (Lee, Lim and Myung, IROS 2022), with the sensor's height from the peak."""
    try:
        import pypatchworkpp
    except ImportError as error:
        raise StageError(
            'ground.method = "patchwork" needs pypatchworkpp; install it with: pip install "fidpipe[patchwork]"'
        ) from error
    parameters = pypatchworkpp.Parameters()
    parameters.sensor_height = -peak_m
    parameters.enable_RNR = False  # needs intensity, which is optional
    parameters.verbose = False
    with _quiet_stdout():  # it prints a message in spite of `verbose`
        estimator = pypatchworkpp.patchworkpp(parameters)
    estimator.estimateGround(
        np.column_stack([points, np.zeros(len(points))]).astype(np.float32)
    )
    is_ground = np.zeros(len(points), dtype=bool)
    is_ground[np.asarray(estimator.getGroundIndices(), dtype=int)] = True
    return is_ground


@contextmanager
def _quiet_stdout() -> Iterator[None]:
    """Discard output of a library's compiled code to standard output, which is for results."""
    kept = os.dup(1)
    nothing = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nothing, 1)
    try:
        yield
    finally:
        os.dup2(kept, 1)
        os.close(kept)
        os.close(nothing)
