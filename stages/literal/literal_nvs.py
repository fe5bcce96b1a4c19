"""Literal scores of papers on LiDAR synthesis: point by point, pixel by pixel, window by window."""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Iterable, Sequence
from statistics import median

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from scipy.spatial.distance import cdist
from scipy.special import rel_entr

from ..arrays import FloatArray
from .literal_method import nearest_distances

_ROWS, _COLUMNS, _UP_DEG, _FOV_DEG, _FARTHEST_M = 66, 1030, 2.0, 26.9, 80.0
_WINDOW = 7
_CELLS, _HALF_M = 100, 80.0


def project(points: FloatArray, intensity: Sequence[float] | None = None) -> tuple[FloatArray, FloatArray]:
    """Ranges and intensities of the nearest return of each pixel, 0 for none."""
    ranges, intensities = np.zeros((2, _ROWS, _COLUMNS))
    for i, (x, y, z) in enumerate(points.tolist()):
        range_m = math.sqrt(x * x + y * y + z * z)
        if range_m >= _FARTHEST_M:
            continue
        above = math.atan2(z, math.sqrt(x * x + y * y)) + math.radians(_FOV_DEG - _UP_DEG)
        column = round((math.pi - math.atan2(y, x)) / (2 * math.pi / _COLUMNS))
        row = round(_ROWS - above / (math.radians(_FOV_DEG) / _ROWS))
        if 0 <= row < _ROWS and 0 <= column < _COLUMNS and not 0 < ranges[row, column] <= range_m:
            ranges[row, column] = range_m
            intensities[row, column] = 0.0 if intensity is None else float(intensity[i])
    return ranges, intensities


def unproject(ranges: FloatArray) -> FloatArray:
    """(n, 3) metres, a point in the direction of each pixel with a return."""
    points = []
    for row, column in zip(*np.nonzero(ranges), strict=True):
        azimuth = -(column - _COLUMNS / 2) / _COLUMNS * 2 * math.pi
        elevation = math.radians(_UP_DEG - row / _ROWS * _FOV_DEG)
        level, height = (ranges[row, column] * part for part in (math.cos(elevation), math.sin(elevation)))
        points.append((level * math.cos(azimuth), level * math.sin(azimuth), height))
    return np.array(points).reshape(-1, 3)


def image_scores(real: FloatArray, sim: FloatArray, largest: float) -> dict[str, float | None]:
    """RMSE, MedAE, PSNR and SSIM over all pixels."""
    real, sim = (np.minimum(np.maximum(image, 1e-6), largest) for image in (real, sim))
    errors = abs(real - sim).ravel().tolist()
    square = math.fsum(error * error for error in errors) / len(errors)
    return {
        "rmse": math.sqrt(square),
        "medae": median(errors),
        "psnr_db": 10 * math.log10(largest**2 / square) if square else None,
        "ssim": _similarity(real, sim, float(real.max() - real.min())),
    }


def _similarity(real: FloatArray, sim: FloatArray, extent: float) -> float | None:
    """Mean over all windows of (2 a b + c1)(2 cov + c2) / ((a^2 + b^2 + c1)(var a + var b + c2))."""
    if extent == 0:
        return None
    c1, c2 = (0.01 * extent) ** 2, (0.03 * extent) ** 2
    a, b = (sliding_window_view(image, (_WINDOW, _WINDOW)).reshape(-1, _WINDOW**2) for image in (real, sim))
    mean_a, mean_b = a.mean(axis=1), b.mean(axis=1)
    da, db = a - mean_a[:, None], b - mean_b[:, None]
    var_a, var_b, cov = ((own * other).sum(axis=1) / (_WINDOW**2 - 1) for own, other in ((da, da), (db, db), (da, db)))
    above = (2 * mean_a * mean_b + c1) * (2 * cov + c2)
    values = above / ((mean_a**2 + mean_b**2 + c1) * (var_a + var_b + c2))
    return math.fsum(values.tolist()) / len(values)


def hit_scores(real: FloatArray, sim: FloatArray) -> dict[str, float | None]:
    """Scores of the hits, 1 where there is a return: RMSE, accuracy, F1 from precision and recall."""
    hits = list(zip((real > 0).ravel().tolist(), (sim > 0).ravel().tolist(), strict=True))
    both, accuracy = hits.count((True, True)), sum(a == b for a, b in hits) / len(hits)
    precision, recall = (both / n if n else 0.0 for n in (sum(b for _, b in hits), sum(a for a, _ in hits)))
    return {
        "raydrop_rmse": math.sqrt(sum(a != b for a, b in hits) / len(hits)),
        "raydrop_accuracy": accuracy,
        "raydrop_hit_f1": 2 * precision * recall / (precision + recall) if both else None,
    }


def cloud_scores(real: FloatArray, sim: FloatArray) -> dict[str, float | None]:
    """Chamfer distance of squares and F-score of two clouds, from all distances."""
    if not len(real) or not len(sim):
        return {"chamfer_m2": None, "f_score_0p05m2": None}
    squares = [nearest_distances(a, b) ** 2 for a, b in ((sim, real), (real, sim))]
    precision, recall = (float((own < 0.05).mean()) for own in squares)
    return {
        "chamfer_m2": float(sum(own.mean() for own in squares)),
        "f_score_0p05m2": 2 * precision * recall / (precision + recall) if precision + recall else 0.0,
    }


def map_from_above(points: FloatArray) -> FloatArray:
    """(10000,) number of points between 3 and 70 m in each of 100 x 100 cells."""
    counts, edges = np.zeros((_CELLS, _CELLS)), np.linspace(-_HALF_M, _HALF_M, _CELLS + 1).tolist()
    for x, y, z in points.tolist():
        if 3.0 < math.sqrt(x * x + y * y + z * z) < 70.0:
            counts[bisect_right(edges, x) - 1, bisect_right(edges, y) - 1] += 1
    return counts.ravel()


def map_jsd(real: FloatArray, sim: FloatArray) -> float | None:
    """Root of the Jensen-Shannon divergence of two maps."""
    if not real.sum() or not sim.sum():
        return None
    p, q = real / real.sum(), sim / sim.sum()
    middle = (p + q) / 2
    return math.sqrt(max(0.0, math.fsum([*rel_entr(p, middle), *rel_entr(q, middle)]) / 2))


def map_mmd(real: Iterable[FloatArray], sim: Iterable[FloatArray]) -> float | None:
    """Squared maximum mean discrepancy of maps, from all their distances."""
    p, q = ([own / own.sum() for own in maps if own.sum()] for maps in (real, sim))
    if not p or not q:
        return None
    means = [float(np.exp(-2.0 * cdist(a, b) ** 2).mean()) for a, b in ((p, p), (q, q), (p, q))]
    return means[0] + means[1] - 2 * means[2]
