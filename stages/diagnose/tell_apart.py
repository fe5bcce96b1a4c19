"""Classifier two-sample test: does the local neighbourhood of a point show if it is real or simulated?

Lopez-Paz and Oquab, Revisiting classifier two-sample tests, ICLR 2017. Neighbouring points, and neighbouring frames,
show the same surface: points of one place are never in the training and the test set at once.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.spatial import cKDTree

from ...schemas.errors import StageError
from ..arrays import BoolArray, FloatArray, IndexArray, IntArray, azimuths_deg
from ..statistics.comparison import mean_interval
from ..surfels import fit_planes

#: Numbers of neighbours over which the shape of the surface is described.
SCALES = (8, 24, 64)
#: With fewer places, folds are sectors of azimuth.
LEAST_PLACES = 5
SECTORS = 8
MOST_FOLDS = 10
#: Trees of a classifier with many features, and with one.
TREES = 60
TREES_ALONE = 20
#: Points next to a tested sector are not trained on.
GUARD_DEG = 10.0
_LEAST_POINTS = 20  # of each side in a fold
_DENSITY_M = 0.5
#: Weight of elevation against azimuth, so that the nearest ray is one of the same beam.
_ROW_WEIGHT = 4.0
#: Features by family. Each is also tested alone: a single regular ray pattern is enough to recognise every point.
FAMILIES = {
    "surface": (
        *(f"shape of {k} points" for k in SCALES),
        *(f"roughness of {k} points" for k in SCALES),
        *(f"spacing of {k} points" for k in SCALES),
        *("inclination", "density", "height above the road"),
    ),
    "rays": ("azimuth step", "elevation step", "range step", "mean range step"),
    "intensity": ("intensity", "mean intensity", "intensity contrast"),
}

Fold = tuple[IndexArray, IndexArray]  #: rows to train on and to test on


@dataclass(frozen=True)
class Separation:
    """Result of the test; the AUC is 0.5 if the sides are indistinguishable, and 1 if every point is recognised.

    by_fold : (k,) float64, area under the ROC curve on points of places that were not trained on
    auc : their mean
    low, high : its 95 % interval, Student's t over the folds
    """

    by_fold: FloatArray
    auc: float
    low: float
    high: float


def describe_points(
    points: FloatArray,
    height_m: FloatArray,
    rows: IndexArray,
    *,
    own_points: FloatArray | None = None,
    intensity: FloatArray | None = None,
) -> dict[str, FloatArray]:
    """Local features of some points of a scan, (m,) float64 each, by name.

    None of them depends on where a point is, or on where the scan is relative to another. Per scale: planarity and
    scattering of the neighbourhood (shape), its thickness (roughness, the root of the smallest eigenvalue of the
    covariance), and its radius over the range (spacing); inclination of the normal, points within 0.5 m, height. Of
    rays: azimuth and elevation to the nearest ray, range to the nearest ray and to the mean of the nearest four.

    Parameters
    ----------
    points : (n, 3) float64, metres, the whole scan
    height_m : (n,) float64, above the road
    rows : (m,) intp, points to be described
    own_points : (n, 3) float64, the points in their sensor's own frame; None for no features of rays
    intensity : (n,) float64, or None for no features of intensity
    """
    tree = cKDTree(points)
    chosen = points[rows]
    range_m = np.linalg.norm(chosen, axis=1)
    scales = [min(k + 1, len(points)) for k in SCALES]  # with the point itself
    distance_m, _ = tree.query(chosen, k=scales)
    n_near = tree.query_ball_point(chosen, _DENSITY_M, return_length=True)
    planes = [fit_planes(points, chosen, k) for k in scales]
    columns = []
    for plane in planes:
        smallest, middle, largest = plane.variance.T
        columns.append((middle - smallest) / np.maximum(largest, 1e-12))
    columns += [np.sqrt(plane.variance[:, 0]) for plane in planes]
    columns += [radius_m / range_m for radius_m in distance_m.T]
    columns += [
        np.abs(planes[1].normal[:, 2]),
        np.log(n_near),
        height_m[rows],
    ]
    names = FAMILIES["surface"]
    if own_points is not None:
        columns += _ray_features(own_points, rows)
        names += FAMILIES["rays"]
    if intensity is not None:
        around = intensity[tree.query(chosen, k=scales[0])[1]]
        columns += [
            intensity[rows],
            around.mean(axis=1),
            around.std(axis=1),
        ]
        names += FAMILIES["intensity"]
    return dict(zip(names, columns, strict=True))


def separate(features: FloatArray, is_sim: BoolArray, splits: Sequence[Fold]) -> Separation:
    """Train a classifier to recognise simulated points, and test it on points of other places.

    Parameters
    ----------
    features : (n, f) float64, points of both sides
    is_sim : (n,) bool
    splits : from `folds`
    """
    from sklearn.ensemble import HistGradientBoostingClassifier
    from sklearn.model_selection import cross_val_score

    classifier = HistGradientBoostingClassifier(
        max_iter=TREES if features.shape[1] > 1 else TREES_ALONE,
        max_leaf_nodes=15,
        early_stopping=False,
        random_state=0,
    )
    by_fold = cross_val_score(classifier, features, is_sim, scoring="roc_auc", cv=splits)
    auc, low, high = mean_interval(by_fold)
    return Separation(by_fold, auc, max(0.0, low), min(1.0, high))


def folds(place: IntArray, azimuth_deg: FloatArray, is_sim: BoolArray) -> list[Fold]:
    """Rows to train on and to test on: places; with fewer than five of them, sectors of equal size.

    Neither the places before and after a tested place nor the 10 degrees next to a tested sector
    are trained on. Folds without points of both sides are left out.

    Parameters
    ----------
    place : (n,) int32, place of the frame of each point, from 0 on, in the order of recording
    azimuth_deg : (n,) float64, of each point

    Raises
    ------
    StageError
        Fewer than two folds have points of both sides.
    """
    n_places = int(place.max()) + 1
    if n_places >= LEAST_PLACES:
        values: FloatArray = place.astype(np.float64)
        n_folds = min(n_places, MOST_FOLDS)
        limits = np.linspace(0, n_places, n_folds + 1).round() - 0.5
        margin = 1.0
        turn = np.inf
    else:
        values = azimuth_deg
        limits = np.quantile(azimuth_deg, np.linspace(0, 1, SECTORS + 1))
        limits[-1] += 1.0
        margin = GUARD_DEG
        turn = 360.0
    usable = []
    for low, high in pairwise(limits):
        distance = np.abs(values - (low + high) / 2)
        distance = np.minimum(distance, turn - distance)
        train = np.flatnonzero(distance > (high - low) / 2 + margin)
        test = np.flatnonzero((values >= low) & (values < high))
        if _has_both(is_sim[train]) and _has_both(is_sim[test]):
            usable.append((train, test))
    if len(usable) < 2:
        raise StageError(
            f"points of both sides in {len(usable)} of the places or sectors; at least 2 are needed"
        )
    return usable


def _has_both(is_sim: BoolArray) -> bool:
    """True if enough points are of each side."""
    return bool(min(np.bincount(is_sim, minlength=2)) >= _LEAST_POINTS)


def _ray_features(points: FloatArray, rows: IndexArray) -> list[FloatArray]:
    """Azimuth, elevation and range to the nearest ray, and range to the mean of the nearest four, (m,) each."""
    range_m = np.linalg.norm(points, axis=1)
    elevation = np.degrees(np.arcsin(points[:, 2] / range_m))
    azimuth = azimuths_deg(points) * np.cos(np.radians(elevation))
    places = np.column_stack([azimuth, _ROW_WEIGHT * elevation])
    _, nearest = cKDTree(places).query(places[rows], k=5)
    near = nearest[:, 1:]  # without the ray itself
    step = np.abs(places[near[:, 0]] - places[rows])
    change = range_m[near] - range_m[rows, None]
    return [
        step[:, 0],
        step[:, 1] / _ROW_WEIGHT,
        np.abs(change[:, 0]),
        np.abs(change.mean(axis=1)),
    ]
