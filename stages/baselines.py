"""Baseline metrics: published distances of point clouds, to put the scores of an object into context.

To add one: a function of two point sets and the settings, which returns its values, each with its name in the
catalogue and with a reason if it cannot be computed; a row in `OF_POINTS`; and a row in the catalogue.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import scipy

from ..schemas.metric_catalogue import METRIC
from ..schemas.settings import MetricsSettings
from .arrays import FloatArray, Watch, level_m, unwatched
from .coverage import nearest_distances
from .linalg.assignment import assign_nodes
from .linalg.nearest import nearest_points
from .reference import visiting_order
from .selection import Selection

_SEED = 0  # of samples
#: Of the network simplex; far more than it needs, so that it always converges.
_MAX_PIVOTS = 10**12
# Range images of LiDAR4D: rows and columns, degrees from the upper edge to the horizon and to the lower edge, range
_IMAGE_ROWS, _IMAGE_COLUMNS = 66, 1030
_IMAGE_UP_DEG, _IMAGE_DEG = 2.0, 26.9
_IMAGE_RANGE_M = 80.0
_LEAST_RANGE_M = 1e-6
_NEAR_M2 = 0.05  # squared distance of two points that are near: 22.4 cm


@dataclass(frozen=True)
class Baseline:
    """One value of a baseline.

    name : as in the table's rows, a column of the catalogue
    value : None if it cannot be computed
    reason : reason for None, or a note about the value
    """

    name: str
    value: float | None
    reason: str | None = None

    @property
    def unit(self) -> str | None:
        """Unit by the catalogue: "m", "m2", or None for a plain number."""
        return METRIC[self.name].unit


Baselines = tuple[Baseline, ...]
_OfPoints = Callable[[FloatArray, FloatArray, MetricsSettings], Baselines]


def compare_points(
    real: FloatArray,
    sim: FloatArray,
    settings: MetricsSettings,
    *,
    nodes: Selection | None = None,
    watch: Watch = unwatched,
) -> Baselines:
    """Compute the requested baseline metrics of two point sets, in the order of the settings.

    Parameters
    ----------
    real, sim : (n, 3), (m, 3) float64, metres, in one frame, at least one point each
    settings : names and parameters
    nodes : of a matched object, its aligned nodes; without them `emd` is left out
    watch : entered around each baseline

    Examples
    --------
    >>> import numpy as np
    >>> from fidpipe.schemas.settings import MetricsSettings
    >>> points = np.array([[0.0, 0, 0], [1, 0, 0]])
    >>> compare_points(points, points + [0, 0, 3], MetricsSettings(baselines=("hausdorff",)))
    (Baseline(name='hausdorff_m', value=3.0, reason=None),)
    """
    values: list[Baseline] = []
    for name in settings.baselines:
        if name in OF_POINTS:
            with watch(name):
                values += OF_POINTS[name](real, sim, settings)
        elif name == "emd" and nodes is not None:
            with watch(name):
                values += _emd(real, sim, nodes, settings)
    return tuple(values)


def _without_value(reason: str, *names: str) -> Baselines:
    return tuple(Baseline(name, None, reason) for name in names)


def chamfer(real: FloatArray, sim: FloatArray, settings: MetricsSettings) -> Baselines:
    """Chamfer distance in three conventions, without centring; 0 if each point coincides with one of the other side.

    chamfer_mean_m = mean_x min_y |x - y| + mean_y min_x |y - x|, x real, y simulated.
    chamfer_squared_m2: the same with |.|^2, the form of Fan, Su and Guibas (A point set generation network for 3D
    object reconstruction from a single image, CVPR 2017) and of Achlioptas et al. (Learning representations and
    generative models for 3D point clouds, ICML 2018), with means in place of their sums.
    chamfer_one_way_sum_m = sum_x min_y |x - y|: as the paper writes it (section "Related Work"), it grows with the
    number of real points and does not see invented ones.

    Parameters
    ----------
    real, sim : (n, 3), (m, 3) float64, metres, at least one point each

    Examples
    --------
    >>> import numpy as np
    >>> baselines = chamfer(np.array([[0.0, 0, 0], [4, 0, 0]]), np.array([[1.0, 0, 0]]), MetricsSettings())
    >>> [baseline.value for baseline in baselines]
    [3.0, 6.0, 4.0]
    """
    to_sim, to_real = nearest_distances(real, sim)
    return (
        Baseline("chamfer_mean_m", float(to_sim.mean() + to_real.mean())),
        Baseline("chamfer_squared_m2", float((to_sim**2).mean() + (to_real**2).mean())),
        Baseline("chamfer_one_way_sum_m", float(to_sim.sum())),
    )


def hausdorff(real: FloatArray, sim: FloatArray, settings: MetricsSettings) -> Baselines:
    """max(max_x min_y |x - y|, max_y min_x |y - x|) in metres: the worst point (Hausdorff, Mengenlehre, 1914).

    See Huttenlocher, Klanderman and Rucklidge, Comparing images using the Hausdorff distance, IEEE PAMI 1993, eq. 1.

    Parameters
    ----------
    real, sim : (n, 3), (m, 3) float64, metres, not centred, at least one point each

    Examples
    --------
    >>> import numpy as np
    >>> hausdorff(np.array([[0.0, 0, 0], [4, 0, 0]]), np.array([[1.0, 0, 0]]), MetricsSettings())[0].value
    3.0
    """
    to_sim, to_real = nearest_distances(real, sim)
    return (Baseline("hausdorff_m", float(max(to_sim.max(), to_real.max()))),)


def f_score(real: FloatArray, sim: FloatArray, settings: MetricsSettings) -> Baselines:
    """2 P R / (P + R), 1 best, 0 without near points (Knapitsch et al., Tanks and Temples, ACM TOG 2017, section 4).

    Precision P is the share of simulated points nearer than `f_score_distance_m` to a real one, recall R the share of
    real points nearer than that to a simulated one.

    Parameters
    ----------
    real, sim : (n, 3), (m, 3) float64, metres, not centred, at least one point each

    Examples
    --------
    >>> import numpy as np
    >>> f_score(np.array([[0.0, 0, 0], [9, 0, 0]]), np.array([[0.1, 0, 0], [0, 9, 0]]), MetricsSettings())[0].value
    0.5
    """
    to_sim, to_real = nearest_distances(real, sim)
    return (Baseline("f_score", _f_score(to_sim, to_real, settings.f_score_distance_m)),)


def _f_score(to_sim: FloatArray, to_real: FloatArray, near: float) -> float:
    """2 P R / (P + R), with the shares P of simulated and R of real points near the other side; 0 if both are 0."""
    recall = float(np.mean(to_sim < near))
    precision = float(np.mean(to_real < near))
    return 2 * precision * recall / (precision + recall) if precision + recall else 0.0


def dcd(real: FloatArray, sim: FloatArray, settings: MetricsSettings) -> Baselines:
    """The published density-aware Chamfer distance, 0 to 1, with a note on limited weights.

    DCD = 1/2 (mean_x (1 - w_x exp(-alpha |x - y'|^2)) + mean_y (1 - w_y exp(-alpha |y - x'|^2))), y' the nearest
    simulated point of x (for equal distances the first by x, y, z), w_x = (n / m) / (number of real points whose
    nearest is the same y'), and the other way round (Wu, Pan, Zhang, Wang, Liu and Lin, Density-aware Chamfer distance
    as a comprehensive metric for point cloud completion, NeurIPS 2021, section 3). For equal sizes w is 1 over the
    count. The squared distance and the factor n / m for unequal sizes are those of the authors' code (`calc_dcd`); the
    article writes |x - y'|. With that factor a weight can be above 1, and its term below 0: such weights are limited to
    1 and counted.

    Its authors chose alpha = 1000 for objects of unit size, so both sides are scaled by the diagonal of the real
    object's axis-aligned bounding box; None if that has no extent. This is not the score that the paper calls CDC
    (`metrics`).

    Parameters
    ----------
    real, sim : (n, 3), (m, 3) float64, metres, at least one point each
    """
    squared_m2 = float(np.linalg.norm(np.ptp(real, axis=0))) ** 2
    alpha = settings.dcd_alpha / squared_m2 if squared_m2 else np.inf
    if np.isinf(alpha):  # no extent, or its square underflows
        return _without_value("the real points have no extent to scale by", "dcd")
    from_real, n_cut_real = _one_way(real, sim, alpha)
    from_sim, n_cut_sim = _one_way(sim, real, alpha)
    n_cut = n_cut_real + n_cut_sim
    note = None
    if n_cut:
        note = (
            f"{len(real)} real and {len(sim)} simulated points: "
            f"{n_cut} of {len(real) + len(sim)} count weights cut at 1"
        )
    return (Baseline("dcd", (from_real + from_sim) / 2, note),)


def _one_way(x: FloatArray, y: FloatArray, alpha: float) -> tuple[float, int]:
    """Mean of the terms of x, and number of its weights that were limited."""
    nearest, distance = nearest_points(y, x)
    weight = len(x) / len(y) / np.bincount(nearest, minlength=len(y))[nearest]
    with np.errstate(over="ignore"):  # points at infinity have the term 1
        term = 1 - np.minimum(weight, 1.0) * np.exp(-alpha * distance**2)
    return float(term.mean()), int(np.count_nonzero(weight > 1.0))


def histogram(real: FloatArray, sim: FloatArray, settings: MetricsSettings) -> Baselines:
    """(sum_k |h_k(real) - h_k(sim)|^p)^(1/p); None if all points of a side coincide.

    h_k is the share of pairwise distances, divided by the largest distance of the side, in the k-th of equal bins from
    0 to 1: the paper's section "Related Work" after Wallace et al. (Validating simulation environments for automated
    driving systems using 3D object comparison metric, IEEE IV 2022), who compare by the Minkowski distance; the
    histogram itself is the shape distribution D2 of Osada, Funkhouser, Chazelle and Dobkin (Shape distributions, ACM
    TOG 2002). It does not depend on position, rotation and size of the object. Sides of more than `histogram_points`
    points are represented by a sample of that size, selected by a hash of the coordinates, independent of row order.

    Parameters
    ----------
    real, sim : (n, 3), (m, 3) float64, metres, at least one point each
    settings : numbers of points and bins, and p, `histogram_order`
    """
    shares = []
    for points in (real, sim):
        sample = points[visiting_order(points, _SEED)[: settings.histogram_points]]
        distance = scipy.spatial.distance.pdist(sample)
        largest = distance.max(initial=0.0)
        if largest == 0:
            return _without_value("a side has no two points apart from each other", "histogram")
        counts, _ = np.histogram(
            distance / largest, bins=settings.histogram_bins, range=(0.0, 1.0)
        )
        shares.append(counts / len(distance))
    distance = np.linalg.norm(shares[0] - shares[1], settings.histogram_order)
    return (Baseline("histogram", float(distance)),)


def _emd(
    real: FloatArray,
    sim: FloatArray,
    selection: Selection,
    settings: MetricsSettings,
) -> Baselines:
    """Earth mover's distance of all points, of the aligned nodes as given, and of these with both sides centred."""
    n_most = max(len(real), len(sim))
    exact_m = reason = None
    if n_most > settings.emd_max_points:
        reason = f"{n_most} points, metrics.emd_max_points allows {settings.emd_max_points}"
    else:
        exact_m = earth_movers(real, sim)
        if exact_m is None:
            reason = "the network simplex ended without the optimum"
    a = real[selection.real_nodes]
    b = sim[selection.sim_nodes]
    # The alignment is the optimal assignment of the centred nodes, so it is not solved again for these.
    centred_m = aligned_distance(a - a.mean(axis=0), b - b.mean(axis=0))
    return (
        Baseline("emd_mean_m", exact_m, reason),
        Baseline("emd_kept_mean_m", aligned_distance(a, b[assign_nodes(a, b)])),
        Baseline("emd_centred_mean_m", centred_m),
    )


def earth_movers(a: FloatArray, b: FloatArray) -> float | None:
    """min_F sum_ij F_ij |a_i - b_j|, in metres; exact, for sets of any sizes; None if the solver finds no optimum.

    F_ij >= 0 is the mass moved from a_i to b_j: 1 / n leaves each point of a, 1 / m reaches each of b (Rubner, Tomasi
    and Guibas, The earth mover's distance as a metric for image retrieval, IJCV 2000, with equal weights). For equal
    sizes it is the mean distance under the best one-to-one assignment; the paper's equation "d_EMD" is the sum. Network
    simplex of POT (Bonneel, van de Panne, Paris and Heidrich, Displacement interpolation using Lagrangian mass
    transport, SIGGRAPH Asia 2011), which computes distances on demand instead of storing n m of them. The solver gets
    integer weights, so that the marginals hold without rounding.

    Parameters
    ----------
    a, b : (n, 3), (m, 3) float64, metres, not centred; at least one point each

    Examples
    --------
    >>> earth_movers(np.array([[0.0, 0, 0], [1, 0, 0]]), np.array([[1.0, 0, 2], [0, 0, 2]]))
    2.0
    >>> earth_movers(np.array([[0.0, 0, 0], [1, 0, 0]]), np.array([[1.0, 0, 0]]))
    0.5
    """
    import ot

    n, m = len(a), len(b)
    shares = math.lcm(n, m)  # a point of a has shares / n of them, one of b shares / m
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # the warning is also in the log
        total_m, log = ot.emd2_lazy(
            a,
            b,
            np.full(n, shares / n),
            np.full(m, shares / m),
            metric="euclidean",
            numItermax=_MAX_PIVOTS,
            log=True,
            return_matrix=False,
            center_dual=False,
        )
    return None if log["warning"] else float(total_m) / shares


def aligned_distance(a: FloatArray, b: FloatArray) -> float:
    """mean_i |a_i - b_i| in metres, for rows that are already assigned.

    Parameters
    ----------
    a, b : (n, 3) float64, metres, at least one point
    """
    return float(np.linalg.norm(a - b, axis=1).mean())


def nvs(real: FloatArray, sim: FloatArray) -> Baselines:
    """Scores of two whole scans as papers on LiDAR synthesis define them, to compare with their tables.

    Both scans become images of 66 x 1030 ranges (fields of view of KITTI-360, nearest return, below 80 m,), in which a
    pixel without a return has the range 0. Over all pixels, so that a dropped ray counts with its whole range:
    nvs_depth_rmse_m and nvs_depth_medae_m, root mean square and median absolute difference in metres;
    nvs_depth_psnr_db = 10 log10(80^2 / mean squared difference). Of the points of the images:
    nvs_chamfer_m2, mean squared distance to the nearest point of the other side, both directions added, and
    nvs_f_score_0p05m2, harmonic mean of the shares of points with a squared distance below 0.05 m2. That is a radius
    of 22.4 cm, although the papers call it 5 cm. Definitions of LiDAR4D (Zheng et al., LiDAR4D, CVPR 2024:
    `utils/convert.py` and `utils/metrics.py` at commit 4d6abbd).

    Parameters
    ----------
    real, sim : (n, 3), (m, 3) float64, metres, in the real sensor's frame, ground included, none at the origin

    Examples
    --------
    >>> import numpy as np
    >>> scan = np.array([[10.0, 0, 0], [0, 10, 0]])
    >>> [baseline.value for baseline in nvs(scan, scan)]
    [0.0, 0.0, None, 0.0, 1.0]
    """
    images = np.stack([_range_image(real), _range_image(sim)])
    error = np.diff(images.clip(_LEAST_RANGE_M, _IMAGE_RANGE_M), axis=0)
    mean_square = float(np.mean(error**2))
    median = float(np.median(np.abs(error)))
    psnr = 10 * float(np.log10(_IMAGE_RANGE_M**2 / mean_square)) if mean_square else None
    return (
        Baseline("nvs_depth_rmse_m", math.sqrt(mean_square)),
        Baseline("nvs_depth_medae_m", median),
        Baseline("nvs_depth_psnr_db", psnr, "both images are equal" if psnr is None else None),
        *_image_points_apart(*map(_points_of_image, images)),
    )


def _range_image(points: FloatArray) -> FloatArray:
    """(66, 1030) metres, range of the nearest return of each pixel, 0 without one.

    Rows and columns are rounded, half to even; points outside of the image are left out.
    """
    range_m = np.linalg.norm(points, axis=1)
    x, y, z = points.T
    elevation = np.arctan2(z, level_m(points)) + (_IMAGE_DEG - _IMAGE_UP_DEG) / 180 * np.pi
    azimuth = np.arctan2(y, x)
    column = np.rint((np.pi - azimuth) / (2 * np.pi / _IMAGE_COLUMNS)).astype(int)
    row_height = _IMAGE_DEG / 180 * np.pi / _IMAGE_ROWS
    row = np.rint(_IMAGE_ROWS - elevation / row_height).astype(int)
    is_inside = (range_m < _IMAGE_RANGE_M) & (row >= 0) & (row < _IMAGE_ROWS)
    is_inside &= (column >= 0) & (column < _IMAGE_COLUMNS)
    pixel = row[is_inside] * _IMAGE_COLUMNS + column[is_inside]
    image = np.full(_IMAGE_ROWS * _IMAGE_COLUMNS, np.inf)
    np.minimum.at(image, pixel, range_m[is_inside])
    image[np.isinf(image)] = 0.0
    return image.reshape(_IMAGE_ROWS, _IMAGE_COLUMNS)


def _points_of_image(image: FloatArray) -> FloatArray:
    """(n, 3) metres, the returns placed in the directions of their pixels."""
    row, column = np.nonzero(image)
    azimuth = -(column - _IMAGE_COLUMNS / 2) / _IMAGE_COLUMNS * 2 * np.pi
    elevation = (_IMAGE_UP_DEG - row / _IMAGE_ROWS * _IMAGE_DEG) / 180 * np.pi
    level = np.cos(elevation)
    x = level * np.cos(azimuth)
    y = level * np.sin(azimuth)
    return np.column_stack([x, y, np.sin(elevation)]) * image[row, column, None]


def _image_points_apart(real: FloatArray, sim: FloatArray) -> Baselines:
    """Chamfer distance and F-score of the points of two range images."""
    if not min(len(real), len(sim)):
        reason = "a side has no point in the range image"
        return _without_value(reason, "nvs_chamfer_m2", "nvs_f_score_0p05m2")
    to_sim, to_real = nearest_distances(real, sim)
    to_sim **= 2
    to_real **= 2
    return (
        Baseline("nvs_chamfer_m2", float(to_sim.mean() + to_real.mean())),
        Baseline("nvs_f_score_0p05m2", _f_score(to_sim, to_real, _NEAR_M2)),
    )


#: Baseline metrics of two point sets by their names in the settings.
OF_POINTS: dict[str, _OfPoints] = {
    "chamfer": chamfer,
    "hausdorff": hausdorff,
    "f_score": f_score,
    "dcd": dcd,
    "histogram": histogram,
}
#: Name in the settings of the scores of whole scans, ground included; objects do not have them.
OF_SCANS = "nvs"
