"""What a perception stack gets from both scans: obstacles, ground, occupancy and free space.

Textbook methods without networks. Each takes both scans, cut into road and objects, and returns
gaps: 0 if the stack would not notice the simulator. All definitions are fidpipe's; clusters follow
the usual pipeline of ground removal, Euclidean clustering and boxes.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy

from ..schemas.settings import TaskSettings
from .arrays import BoolArray, FloatArray, IndexArray, level_m, sums_by_id
from .linalg.nearest import search_tree
from .pieces import CutScan
from .summary import median_of
from .surfels import voxel_ids

ALL = "all"  #: group of a gap over everything
N_DIRECTIONS = 360
#: Obstacles by their longer side seen from above, and by distance: lower ends of each group.
SIZES_M = {"smaller than 1.5 m": 0.0, "1.5 to 6 m": 1.5, "larger than 6 m": 6.0}
DISTANCES_M = {"nearer than 15 m": 0.0, "15 to 30 m": 15.0, "30 m and farther": 30.0}
#: Range at which clusters link points at twice the distance at the sensor.
_DOUBLE_AT_M = 40.0
_CELLS_PER_LINK = 2  #: points are clustered by cells of this part of the link distance
_CORE_POINTS = 5  #: points within the link distance that make a point a core of DBSCAN
_BORDER_M = 5.0  #: obstacles are found so far beyond range_m, so that none is lost at the limit
_MARGIN_M = 0.1  #: boxes are enlarged by this on all sides: returns lie inside of what they hit
_SEEN_WITHIN_M = 0.3  #: both sides see a surface where they have points within this distance
_GROUND_CELL_M = 1.0
_GROUND_POINTS = 3
_TOO_FAR_M = 0.5  #: free space that is longer than the real one by more than this is dangerous


@dataclass(frozen=True)
class Gap:
    """A measure of a task on both sides.

    real, sim : values of the sides; None if they have none of their own
    gap : difference of the sides as the measure defines it, 0 for equal ones; None if unknown
    unit : m, or "" for a share
    group : `ALL`, or one of `SIZES_M` or `DISTANCES_M`
    """

    task: str
    measure: str
    real: float | None
    sim: float | None
    gap: float | None
    unit: str = ""
    group: str = ALL


@dataclass(frozen=True)
class Obstacles:
    """Clusters of one side, nearest first.

    labels : (n,) obstacle of each point of the scan, -1 for none
    low, high : (m, 3) corners of the boxes, metres, axes of the real sensor
    n_points : (m,)
    partner : (m,) matched obstacle of the other side; -1 for a lost or an added one
    iou : (m,) overlap with the partner seen from above; 0 for none
    """

    labels: IndexArray
    low: FloatArray
    high: FloatArray
    n_points: IndexArray
    partner: IndexArray
    iou: FloatArray

    @property
    def size_m(self) -> FloatArray:
        """Extents of the boxes, (m, 3)."""
        return self.high - self.low

    @property
    def centre(self) -> FloatArray:
        """Centres of the boxes, (m, 3)."""
        return (self.low + self.high) / 2

    @property
    def range_m(self) -> FloatArray:
        """Horizontal distance of the centres, (m,)."""
        return level_m(self.centre)


@dataclass(frozen=True)
class ObstacleTask:
    """Obstacles of both sides, and the gaps between them."""

    real: Obstacles
    sim: Obstacles
    gaps: tuple[Gap, ...]


def compare_obstacles(real: CutScan, sim: CutScan, settings: TaskSettings) -> ObstacleTask:
    """Obstacles that the simulated scan loses, adds, resizes and displaces.

    Boxes are matched one to one with the largest sum of their IoU seen from above, and count as
    found from min_iou on. With R and S the obstacles of both sides within range_m, and F the found
    ones:

    - lost: gap = 1 - |F| / |R|; added: gap = 1 - |F'| / |S|
    - size_m, place_m: medians over F of the largest difference of the horizontal extents, and of
      the horizontal distance of the centres

    Lost and added are also given by size and by distance of the obstacle.
    """
    real_obstacles = find_obstacles(real, settings)
    sim_obstacles = find_obstacles(sim, settings)
    overlap = box_iou(real_obstacles, sim_obstacles)
    pairs = np.stack(scipy.optimize.linear_sum_assignment(-overlap))
    rows, columns = pairs[:, overlap[*pairs] >= settings.min_iou]
    real_obstacles.partner[rows] = columns
    sim_obstacles.partner[columns] = rows
    real_obstacles.iou[rows] = sim_obstacles.iou[columns] = overlap[rows, columns]
    gaps = (
        *_unmatched("lost", real_obstacles, settings.range_m),
        *_unmatched("added", sim_obstacles, settings.range_m),
        *_errors(real_obstacles, sim_obstacles, settings.range_m),
    )
    return ObstacleTask(real_obstacles, sim_obstacles, gaps)


def find_obstacles(scan: CutScan, settings: TaskSettings) -> Obstacles:
    """Clusters of the points above the road, by DBSCAN with a distance that grows with range.

    Points p at range r are clustered as p / (1 + r / 40 m) with radius link_m. So points are
    linked up to link_m (1 + r / 40 m) across the ray, and up to link_m (1 + r / 40 m)^2 along it,
    as the spacing of returns on a surface grows. Clusters of fewer than min_points are left out.
    """
    is_near = level_m(scan.points) <= settings.range_m + _BORDER_M
    candidates = np.flatnonzero(is_near & _is_obstacle(scan, settings))
    cluster = np.full(len(scan.points), -1)
    cluster[candidates] = _clusters(scan.points[candidates], settings.link_m)
    is_clustered = cluster >= 0
    points = scan.points[is_clustered]
    cluster_of = cluster[is_clustered]
    n_points = np.bincount(cluster_of)
    low = np.full((len(n_points), 3), np.inf)
    high = -low
    np.minimum.at(low, cluster_of, points)
    np.maximum.at(high, cluster_of, points)
    distance_m = level_m((low + high) / 2)
    order = np.argsort(distance_m, kind="stable")
    order = order[n_points[order] >= settings.min_points]
    number_of = np.full(len(n_points) + 1, -1)  # the last is of points without a cluster
    number_of[order] = np.arange(len(order))
    return Obstacles(
        labels=number_of[cluster],
        low=low[order],
        high=high[order],
        n_points=n_points[order],
        partner=np.full(len(order), -1),
        iou=np.zeros(len(order)),
    )


def _clusters(points: FloatArray, link_m: float) -> IndexArray:
    """Cluster of each point, (n,), -1 for none; points of one cell count as one, at their mean."""
    from sklearn.cluster import DBSCAN

    if not len(points):
        return np.empty(0, dtype=int)
    range_m = np.linalg.norm(points, axis=1)
    scaled = points / (1 + range_m / _DOUBLE_AT_M)[:, None]
    _, cell, n_in_cell = np.unique(
        voxel_ids(scaled, link_m / _CELLS_PER_LINK),
        return_inverse=True,
        return_counts=True,
    )
    means = sums_by_id(scaled, cell, len(n_in_cell)) / n_in_cell[:, None]
    dbscan = DBSCAN(eps=link_m, min_samples=_CORE_POINTS)
    return dbscan.fit(means, sample_weight=n_in_cell).labels_[cell]


def box_iou(a: Obstacles, b: Obstacles) -> FloatArray:
    """|A n B| / |A u B| of all boxes seen from above, enlarged by 0.1 m, (m, k)."""
    low = np.maximum(a.low[:, None], b.low) - _MARGIN_M
    high = np.minimum(a.high[:, None], b.high) + _MARGIN_M
    extent = np.maximum(high - low, 0.0)
    common = extent[..., :2].prod(axis=2)
    a_extent = a.size_m[:, :2] + 2 * _MARGIN_M
    b_extent = b.size_m[:, :2] + 2 * _MARGIN_M
    union = a_extent.prod(axis=1)[:, None] + b_extent.prod(axis=1) - common
    return common / union


def compare_ground(real: CutScan, sim: CutScan, settings: TaskSettings) -> tuple[Gap, ...]:
    """Agreement of the two ground cuts on surface that both sides see, and of the road's height.

    - disagreement: share of the points with a point of the other side within 0.3 m whose nearest
      one is ground where they are not, or the reverse; mean of both directions. `real` and `sim`
      are the shares of ground among these points
    - height_m: median over cells of 1 m with at least three ground points of both sides of
      |z_sim - z_real|, z being the mean height of the ground points of the cell
    """
    real = _within(real, settings.range_m)
    sim = _within(sim, settings.range_m)
    real_share, real_wrong = _ground_on_common_surface(real, sim)
    sim_share, sim_wrong = _ground_on_common_surface(sim, real)
    gap = None
    if real_wrong is not None and sim_wrong is not None:
        gap = (real_wrong + sim_wrong) / 2
    return (
        Gap("ground", "disagreement", real_share, sim_share, gap),
        Gap("ground", "height_m", None, None, _height_error_m(real, sim), "m"),
    )


def counterparts(points: FloatArray, others: FloatArray) -> IndexArray:
    """The nearest point of the other side, (n,); -1 if none is within 0.3 m."""
    tree = search_tree(others)
    distance_m, nearest = tree.query(points, distance_upper_bound=_SEEN_WITHIN_M)
    return np.where(np.isfinite(distance_m), nearest, -1)


def compare_occupancy(real: CutScan, sim: CutScan, settings: TaskSettings) -> tuple[Gap, ...]:
    """Agreement of the two occupancy maps of a planner, square cells of cell_m seen from above.

    A cell is occupied with a point of an obstacle (above the road, at most height_m). It is free
    if it is not occupied and holds ground, or lies in front of the first obstacle of its direction
    (of 360), or of the farthest return if there is no obstacle. All other cells are unknown. With
    O and F the occupied and the free cells within range_m:

    - mismatch: 1 - |O_real n O_sim| / |O_real u O_sim|
    - wrongly_free: |O_real n F_sim| / |O_real|
    - wrongly_occupied: |F_real n O_sim| / |O_sim|

    `real` and `sim` are the occupied area of the sides, m^2.
    """
    real_occupied, real_free = _map(real, settings)
    sim_occupied, sim_free = _map(sim, settings)
    is_other = real_occupied != sim_occupied
    gaps = {
        "mismatch": _share(is_other[real_occupied | sim_occupied]),
        "wrongly_free": _share(sim_free[real_occupied]),
        "wrongly_occupied": _share(real_free[sim_occupied]),
    }
    cell_m2 = settings.cell_m**2
    real_m2 = int(real_occupied.sum()) * cell_m2
    sim_m2 = int(sim_occupied.sum()) * cell_m2
    return tuple(Gap("occupancy", name, real_m2, sim_m2, gap) for name, gap in gaps.items())


def compare_free_space(real: CutScan, sim: CutScan, settings: TaskSettings) -> tuple[Gap, ...]:
    """Distance to the first obstacle in each of 360 directions; range_m if there is none nearer.

    - distance_m: median of |d_sim - d_real|; too_far: share with d_sim > d_real + 0.5 m

    over the directions in which a side has an obstacle. `real` and `sim` are the median distances.
    """
    real_m = _first_obstacle_m(real, settings)
    sim_m = _first_obstacle_m(sim, settings)
    has_obstacle = np.minimum(real_m, sim_m) < settings.range_m
    real_m = real_m[has_obstacle]
    sim_m = sim_m[has_obstacle]
    error_m = median_of(np.abs(sim_m - real_m))
    return (
        Gap("free_space", "distance_m", median_of(real_m), median_of(sim_m), error_m, "m"),
        Gap("free_space", "too_far", None, None, _share(sim_m > real_m + _TOO_FAR_M)),
    )


def _is_obstacle(scan: CutScan, settings: TaskSettings) -> BoolArray:
    """True for points above the road, and at most height_m above it, (n,)."""
    return ~scan.is_ground & (scan.height_m <= settings.height_m)


def _within(scan: CutScan, range_m: float) -> CutScan:
    """The points of a scan within a horizontal distance."""
    is_near = level_m(scan.points) <= range_m
    return CutScan(
        scan.points[is_near],
        scan.is_ground[is_near],
        scan.height_m[is_near],
    )


def _unmatched(measure: str, obstacles: Obstacles, range_m: float) -> list[Gap]:
    """Share of obstacles without a partner: of all, by size and by distance.

    `real` is the number of obstacles and `sim` that of the matched ones, or the reverse if the
    obstacles are the simulated ones.
    """
    is_near = obstacles.range_m <= range_m
    longer_m = obstacles.size_m[:, :2].max(axis=1)
    groups = {ALL: is_near}
    for limits_m, values_m in ((SIZES_M, longer_m), (DISTANCES_M, obstacles.range_m)):
        group_of = np.digitize(values_m, [*limits_m.values()]) - 1
        for i, name in enumerate(limits_m):
            groups[name] = is_near & (group_of == i)
    gaps = []
    for group, chosen in groups.items():
        is_lost = obstacles.partner[chosen] < 0
        n = len(is_lost)
        n_found = int((~is_lost).sum())
        counts = (n, n_found) if measure == "lost" else (n_found, n)
        gaps.append(Gap("objects", measure, *counts, _share(is_lost), group=group))
    return gaps


def _errors(real: Obstacles, sim: Obstacles, range_m: float) -> list[Gap]:
    """Errors of size and place of the found obstacles."""
    is_found = real.partner >= 0
    rows = np.flatnonzero(is_found & (real.range_m <= range_m))
    columns = real.partner[rows]
    real_m = real.size_m[rows, :2]
    sim_m = sim.size_m[columns, :2]
    error_m = np.abs(real_m - sim_m).max(axis=1)
    offset_m = real.centre[rows, :2] - sim.centre[columns, :2]
    apart_m = np.linalg.norm(offset_m, axis=1)
    return [
        Gap(
            "objects",
            "size_m",
            median_of(real_m.max(axis=1)),
            median_of(sim_m.max(axis=1)),
            median_of(error_m),
            "m",
        ),
        Gap("objects", "place_m", None, None, median_of(apart_m), "m"),
    ]


def _ground_on_common_surface(
    scan: CutScan,
    other: CutScan,
) -> tuple[float | None, float | None]:
    """Among points near the other side, the share of ground, and of those whose nearest point disagrees; or None."""
    nearest = counterparts(scan.points, other.points)
    is_seen = nearest >= 0
    is_ground = scan.is_ground[is_seen]
    is_wrong = is_ground != other.is_ground[nearest[is_seen]]
    return _share(is_ground), _share(is_wrong)


def _height_error_m(real: CutScan, sim: CutScan) -> float | None:
    """Median difference of the ground's height over cells that both sides have."""
    real_cells, real_m = _ground_heights(real)
    sim_cells, sim_m = _ground_heights(sim)
    _, rows, columns = np.intersect1d(real_cells, sim_cells, return_indices=True)
    return median_of(np.abs(sim_m[columns] - real_m[rows]))


def _ground_heights(scan: CutScan) -> tuple[IndexArray, FloatArray]:
    """Cells of 1 m with at least three ground points, (m,), and the mean height of each, (m,)."""
    ground = scan.points[scan.is_ground]
    ids = voxel_ids(ground * [1, 1, 0], _GROUND_CELL_M)
    cells, cell_of, n_points = np.unique(ids, return_inverse=True, return_counts=True)
    is_measured = n_points >= _GROUND_POINTS
    mean_m = np.bincount(cell_of, ground[:, 2], len(cells)) / n_points
    return cells[is_measured], mean_m[is_measured]


def _map(scan: CutScan, settings: TaskSettings) -> tuple[BoolArray, BoolArray]:
    """Occupied and free cells of a side, (c, c) bool each."""
    half = int(np.ceil(settings.range_m / settings.cell_m))
    near = _within(scan, settings.range_m)
    is_occupied = _cells(near.points[_is_obstacle(near, settings)], half, settings)
    is_road = _cells(near.points[near.is_ground], half, settings)
    centre_m = (np.arange(-half, half) + 0.5) * settings.cell_m
    x, y = np.meshgrid(centre_m, centre_m, indexing="ij")
    range_m = np.hypot(x, y)
    farthest_m = _extreme_m(np.maximum, scan.points, 0.0)
    visible_m = np.minimum(_first_obstacle_m(scan, settings), farthest_m)
    is_visible = range_m + settings.cell_m < visible_m[_direction(x, y)]
    is_near = range_m <= settings.range_m
    is_occupied &= is_near
    return is_occupied, (is_road | is_visible) & is_near & ~is_occupied


def _first_obstacle_m(scan: CutScan, settings: TaskSettings) -> FloatArray:
    """Horizontal distance of the first obstacle in each direction, (360,); at most range_m."""
    obstacles = scan.points[_is_obstacle(scan, settings)]
    return _extreme_m(np.minimum, obstacles, settings.range_m)


def _extreme_m(extreme: np.ufunc, points: FloatArray, start_m: float) -> FloatArray:
    """Least or greatest horizontal distance in each direction, (360,), and of a start."""
    extreme_m = np.full(N_DIRECTIONS, start_m)
    x, y, _ = points.T
    extreme.at(extreme_m, _direction(x, y), np.hypot(x, y))
    return extreme_m


def _direction(x: FloatArray, y: FloatArray) -> IndexArray:
    """Direction of each place, 0 to 359, one per degree from straight behind on."""
    share = np.arctan2(y, x) / (2 * np.pi) + 0.5
    return np.minimum((share * N_DIRECTIONS).astype(int), N_DIRECTIONS - 1)


def _cells(points: FloatArray, half: int, settings: TaskSettings) -> BoolArray:
    """Cells of the map, (2 half, 2 half), that hold a point."""
    is_filled = np.zeros((2 * half, 2 * half), dtype=bool)
    cell = np.floor(points[:, :2] / settings.cell_m).astype(int) + half
    rows, columns = np.clip(cell, 0, 2 * half - 1).T
    is_filled[rows, columns] = True
    return is_filled


def _share(flags: BoolArray) -> float | None:
    """Share of the flags that are set; None without any."""
    return float(flags.mean()) if flags.size else None
