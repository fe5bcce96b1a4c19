"""Scores of papers that synthesise LiDAR scans, as their code defines them: range images, and points seen from above.

Images and scores are those of LiDAR4D (Zheng et al., CVPR 2024), `utils/convert.py` and `utils/metrics.py` at commit
4d6abbd; those from above are LiDARGen's (Zyrianov et al., ECCV 2022) as R2DM codes them, `metrics/bev.py` at ad66e71.
"""

from __future__ import annotations

from dataclasses import dataclass
from importlib.util import find_spec

import numpy as np
import scipy

from ..schemas.metric_catalogue import NVS_SCORES
from .arrays import BoolArray, FloatArray, Watch, unwatched
from .baselines import Baseline, Baselines, harmonic_mean
from .coverage import nearest_distances

#: The range image: rows and columns, degrees from its upper edge to the horizon and to its lower edge, largest range.
HEIGHT, WIDTH = 66, 1030
FOV_UP_DEG, FOV_DEG = 2.0, 26.9
MAX_RANGE_M = 80.0
#: Two points are near if their squared distance is below this: 22.4 cm.
NEAR_M2 = 0.05
#: The map from above: square cells per side, its width, and the ranges between which points count.
BEV_CELLS, BEV_WIDTH_M, BEV_RANGES_M = 100, 160.0, (3.0, 70.0)
NOT_INSTALLED = 'scikit-image is not installed; pip install "fidpipe[nvs]"'
_SIGMA = 0.5
_LEAST = 1e-6
_EMPTY_MAP = "a side has no point between 3 and 70 m"


@dataclass(frozen=True)
class RangeImage:
    """Nearest return in each direction, (66, 1030) float64 metres, 0 for none, and its intensity."""

    range_m: FloatArray
    intensity: FloatArray

    @property
    def is_hit(self) -> BoolArray:
        """(66, 1030) True where there is a return."""
        return self.range_m > 0

    def points(self) -> FloatArray:
        """(n, 3) metres, the returns placed in the directions of their pixels."""
        row, column = np.nonzero(self.is_hit)
        azimuth = -(column - WIDTH / 2) / WIDTH * 2 * np.pi
        elevation = (FOV_UP_DEG - row / HEIGHT * FOV_DEG) / 180 * np.pi
        level = np.cos(elevation)
        directions = np.column_stack([level * np.cos(azimuth), level * np.sin(azimuth), np.sin(elevation)])
        return directions * self.range_m[row, column, None]


def project(points: FloatArray, intensity: FloatArray | None = None) -> RangeImage:
    """Range image of a scan; rows and columns are rounded, half to even, and those outside of the image are lost.

    Parameters
    ----------
    points : (n, 3) float64, metres, in the sensor's frame, none at the origin
    intensity : (n,) of the points; by default 0
    """
    range_m = np.linalg.norm(points, axis=1)
    x, y, z = points.T
    elevation = np.arctan2(z, np.hypot(x, y)) + (FOV_DEG - FOV_UP_DEG) / 180 * np.pi
    column = np.rint((np.pi - np.arctan2(y, x)) / (2 * np.pi / WIDTH)).astype(np.intp)
    row = np.rint(HEIGHT - elevation / (FOV_DEG / 180 * np.pi / HEIGHT)).astype(np.intp)
    is_in = np.flatnonzero((range_m < MAX_RANGE_M) & (row >= 0) & (row < HEIGHT) & (column >= 0) & (column < WIDTH))
    pixel = row[is_in] * WIDTH + column[is_in]
    order = np.lexsort((range_m[is_in], pixel))  # of equal ranges the first point
    pixel, first = np.unique(pixel[order], return_index=True)
    nearest = is_in[order[first]]
    images = np.zeros((2, HEIGHT * WIDTH))
    images[0, pixel] = range_m[nearest]
    images[1, pixel] = 0.0 if intensity is None else intensity[nearest]
    return RangeImage(*images.reshape(2, HEIGHT, WIDTH))


def score_pair(
    real: FloatArray,
    sim: FloatArray,
    intensities: tuple[FloatArray | None, FloatArray | None] = (None, None),
    *,
    watch: Watch = unwatched,
) -> Baselines:
    """All scores of a pair, in the order of the catalogue, null with their reason.

    Parameters
    ----------
    real, sim : (n, 3), (m, 3) float64, metres, in the real sensor's frame
    intensities : of the points of each side, or None
    watch : entered around each part
    """
    with watch("range images"):
        a, b = (project(points, own) for points, own in zip((real, sim), intensities, strict=True))
        unknown = _no_intensity(intensities)
        values = (
            *image_errors(a.range_m, b.range_m, MAX_RANGE_M),
            *((unknown,) * 4 if unknown else image_errors(a.intensity, b.intensity, 1.0)),
            *hit_errors(a.is_hit, b.is_hit),
        )
    with watch("clouds"):
        values += cloud_errors(a.points(), b.points())
    with watch("maps from above"):
        values += (map_distance(*(map_from_above(points) for points in (real, sim))),)
    return tuple(baseline(metric.column, value) for metric, value in zip(NVS_SCORES, values, strict=True))


def baseline(column: str, value: float | str) -> Baseline:
    """A score of the catalogue with its value, or with the reason for having none."""
    return Baseline(column, None, value) if isinstance(value, str) else Baseline(column, value)


def image_errors(real: FloatArray, sim: FloatArray, largest: float) -> tuple[float, float, float | str, float | str]:
    """RMSE, MedAE, PSNR in decibels and SSIM over all pixels; a pixel without a return has the value 0.

    Values are clipped to [1e-6, `largest`]. PSNR = 10 log10(largest^2 / MSE). SSIM (Wang et al., IEEE TIP 2004) is that
    of scikit-image with windows of 7 x 7 pixels and the extent of the real values as range.

    Parameters
    ----------
    real, sim : (66, 1030) float64

    Examples
    --------
    >>> image_errors(np.full((7, 7), 4.0), np.full((7, 7), 12.0), 80.0)[:3]
    (8.0, 8.0, 20.0)
    """
    real, sim = (np.clip(image, _LEAST, largest) for image in (real, sim))
    error = float(np.mean((real - sim) ** 2))
    signal = 10 * float(np.log10(largest**2 / error)) if error else "both images are equal"
    return float(np.sqrt(error)), float(np.median(np.abs(real - sim))), signal, _similarity(real, sim)


def hit_errors(real: BoolArray, sim: BoolArray) -> tuple[float, float, float | str]:
    """RMSE, accuracy and F1 of pixels with a return: LiDAR4D's ray drop, whose positives are returns, not drops.

    Parameters
    ----------
    real, sim : (66, 1030) True where a side has a return
    """
    wrong, n_both = float(np.mean(real != sim)), int(np.count_nonzero(real & sim))
    f1 = 2 * n_both / int(real.sum() + sim.sum()) if n_both else "no pixel with a return on both"
    return float(np.sqrt(wrong)), float(np.mean(real == sim)), f1


def cloud_errors(real: FloatArray, sim: FloatArray) -> tuple[float | str, float | str]:
    """Chamfer distance in m2, mean squared distances of both directions added, and F-score at 0.05 m2.

    Parameters
    ----------
    real, sim : (n, 3), (m, 3) float64, metres: the points of the range images
    """
    if not min(len(real), len(sim)):
        reason = "a side has no point in the range image"
        return reason, reason
    to_sim, to_real = (apart**2 for apart in nearest_distances(real, sim))
    recall, precision = float(np.mean(to_sim < NEAR_M2)), float(np.mean(to_real < NEAR_M2))
    return float(to_sim.mean() + to_real.mean()), harmonic_mean(precision, recall)


def map_from_above(points: FloatArray) -> FloatArray:
    """(100, 100) float64, number of points in each cell of 1.6 m; those between 3 and 70 m from the sensor count."""
    range_m = np.linalg.norm(points, axis=1)
    is_in = (range_m > BEV_RANGES_M[0]) & (range_m < BEV_RANGES_M[1])
    half = BEV_WIDTH_M / 2
    counts: FloatArray
    counts, _, _ = np.histogram2d(points[is_in, 0], points[is_in, 1], BEV_CELLS, ((-half, half), (-half, half)))
    return counts


def map_distance(real: FloatArray, sim: FloatArray) -> float | str:
    """Square root of the Jensen-Shannon divergence (natural logarithm) of two maps, 0 to sqrt(ln 2).

    Parameters
    ----------
    real, sim : (100, 100) float64, numbers of points, of one scan or of many
    """
    if not (real.any() and sim.any()):
        return _EMPTY_MAP
    with np.errstate(invalid="ignore"):  # rounding may leave a divergence just below 0
        return float(np.nan_to_num(scipy.spatial.distance.jensenshannon(real.ravel(), sim.ravel())))


def map_discrepancy(real: FloatArray, sim: FloatArray) -> float | str:
    """Maximum mean discrepancy, squared and biased, of maps of sum 1; Gaussian kernel, sigma 0.5.

    mean k(p, p') + mean k(q, q') - 2 mean k(p, q) over all pairs of maps, also of one with itself.

    Parameters
    ----------
    real, sim : (n, 10000) float64, one map a row
    """
    p, q = (maps[maps.any(axis=1)] for maps in (real, sim))
    if not min(len(p), len(q)):
        return _EMPTY_MAP
    p, q = (maps / maps.sum(axis=1, keepdims=True) for maps in (p, q))
    within = sum(_mean_kernel(maps, maps) for maps in (p, q))
    return within - 2 * _mean_kernel(p, q)


def can_compare_images() -> bool:
    """True if scikit-image (an extra) is installed."""
    return find_spec("skimage") is not None


def _mean_kernel(p: FloatArray, q: FloatArray) -> float:
    apart2 = (p**2).sum(axis=1)[:, None] + (q**2).sum(axis=1) - 2 * p @ q.T
    return float(np.exp(-apart2 / (2 * _SIGMA**2)).mean())


def _similarity(real: FloatArray, sim: FloatArray) -> float | str:
    extent = float(np.ptp(real))
    if not extent:
        return "the real image has a single value"
    if not can_compare_images():
        return NOT_INSTALLED
    from skimage.metrics import structural_similarity

    return float(structural_similarity(sim, real, data_range=extent))


def _no_intensity(intensities: tuple[FloatArray | None, FloatArray | None]) -> str:
    """Reason why intensities are not compared, or ""."""
    for side, own in zip(("real", "simulated"), intensities, strict=True):
        if own is None or not own.any():
            return f"the {side} side has no intensity"
        if not (own.min() >= 0 and own.max() <= 1):
            return f"expected intensities from 0 to 1, got {own.min():g} to {own.max():g} on the {side} side"
    return ""
