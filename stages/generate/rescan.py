"""Re-scan of a recording: posed scans become a map of surfels (small discs), at which rays are cast.

Moving objects leave a trail in the map: later rays that pass through do not remove points.
"""

from __future__ import annotations

import numpy as np
from scipy.ndimage import binary_dilation
from scipy.spatial import cKDTree

from ...schemas.sensor_models import SensorModel
from ..arrays import FloatArray, IndexArray, azimuths_deg, slopes_deg, sums_by_id
from ..surfels import fit_planes, voxel_ids
from .flaws import SCATTERED
from .ray_casting import cast_rays, measure_ranges

VOXEL_M = 0.1
_FULL_DETAIL_M = 15.0
_BANDS = 4
_PLANE_NEIGHBOURS = 20
_RADIUS_NEIGHBOUR = 4
_WIDEST = 2.0  # radius of a surfel, in voxels
_LEAF = 0.5
_AZIMUTH_CELL_DEG, _ELEVATION_CELL_DEG = 0.2, 0.4
_DIRECTION_CELLS = (1800, 451)  # the last row is straight up

#: A sensor known only by its recording; see `recorded_directions`.
RECORDED = SensorModel(
    name="recorded",
    elevation_deg=(),
    azimuth_offset_deg=(),
    azimuth_step_deg=_AZIMUTH_CELL_DEG,
    min_range_m=0.9,
    max_range_m=120.0,
    range_noise_m=0.02,
    range_quantum_m=0.0,
)


#: Scans in one frame of reference, downsampled to one point per voxel: mean x, y, z in metres and mean intensity (NaN
#: if a scan has none) of the points in each voxel, and their number.
EMPTY_MAP: FloatArray = np.empty((0, 5))


def extend_map(voxels: FloatArray, points: FloatArray, intensity: FloatArray) -> FloatArray:
    """Add the points of a scan to a map; its size is bounded by the surface, not by the number of scans.

    Voxels have an edge of 0.1 m within 15 m of the sensor, twice that to 30 m, and so on: about the
    distance of neighbouring beams, so that distant rings become as even as near ones.

    Parameters
    ----------
    voxels : (n, 5) float64, see `EMPTY_MAP`
    points : (m, 3) float64, metres, in the frame of the new scan
    intensity : (m,) float64, NaN if unknown
    """
    new = np.column_stack([points, intensity, np.ones(len(points))])
    rows = np.concatenate([voxels, new])
    band = _bands(rows[:, :3])
    merged = []
    for number in range(_BANDS):
        of_band = rows[band == number]
        weight = of_band[:, 4]
        voxel = voxel_ids(of_band[:, :3], VOXEL_M * 2.0**number)
        _, ids = np.unique(voxel, return_inverse=True)
        total = np.bincount(ids, weight)
        sums = sums_by_id(weight[:, None] * of_band[:, :4], ids, len(total))
        merged.append(np.column_stack([sums / total[:, None], total]))
    return np.concatenate(merged)


def rescan(
    voxels: FloatArray,
    directions: FloatArray,
    sensor: SensorModel,
    rng: np.random.Generator,
) -> tuple[FloatArray, FloatArray]:
    """Scan a map by a sensor at the origin.

    Each point of the map becomes a square in the plane of its 20 nearest points, of the area of a
    disc out to its fourth nearest one, at most two voxels; in foliage (l3 / l1 of 0.1 or more) half
    as wide, since leaves leave gaps. The first disc that a ray hits selects the surface; the range
    is that of the plane through the 20 nearest points of the map, unless it differs by more than
    two voxels: discs overlap, and the first one is too near. A pulse is then lost with the
    probability `lost_share`, ranges get noise and quantum, and points outside the sensor's range
    are dropped.

    Parameters
    ----------
    voxels : (n, 5) float64, see `EMPTY_MAP`, in the frame of the new scan
    directions : (n, 3) float64, unit vectors
    rng : noise and losses

    Returns
    -------
    points : (m, 3) float64, metres, sensor frame, in the order of the rays
    intensity : (m,) float64, of the surface that each ray hit; NaN if unknown
    """
    points = voxels[:, :3]
    if not len(points):
        return np.empty((0, 3)), np.empty(0)
    widest_m = (_WIDEST * VOXEL_M * 2.0 ** _bands(points)).astype(np.float64)
    planes = fit_planes(points, points, _PLANE_NEIGHBOURS)
    apart, _ = cKDTree(points).query(points, k=[min(_RADIUS_NEIGHBOUR + 1, len(points))])
    leaf = np.where(planes.scattering >= SCATTERED, _LEAF, 1.0)
    radius_m = np.minimum(apart[:, 0], widest_m) * leaf
    off_m = ((planes.mean - points) * planes.normal).sum(axis=1)[:, None]
    discs = _discs(points + off_m * planes.normal, planes.normal, radius_m)
    hits = cast_rays(discs, directions)
    rays = directions[hits.ray_ids]
    surfels = hits.face_ids // 2
    range_m = _onto_planes(points, rays, hits.range_m, widest_m[surfels])
    is_detected = rng.random(len(range_m)) >= sensor.lost_share
    range_m = measure_ranges(sensor, range_m, rng)
    is_detected &= (range_m >= sensor.min_range_m) & (range_m <= sensor.max_range_m)
    return (rays * range_m[:, None])[is_detected], voxels[surfels[is_detected], 3]


def _onto_planes(
    points: FloatArray,
    rays: FloatArray,
    range_m: FloatArray,
    widest_m: FloatArray,
) -> FloatArray:
    """Ranges on the local planes of the map: x = u (n . m) / (n . u), with m and n mean and normal."""
    planes = fit_planes(points, rays * range_m[:, None], _PLANE_NEIGHBOURS)
    to_plane_m = (planes.normal * planes.mean).sum(axis=1)
    cosine = (planes.normal * rays).sum(axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        plane_m = to_plane_m / cosine
    return np.where(np.abs(plane_m - range_m) <= widest_m, plane_m, range_m)


def recorded_directions(scan: FloatArray, others: FloatArray) -> FloatArray:
    """The beams of a recorded scan, (n, 3) unit vectors.

    The directions of all its returns, and those of returns of other scans of the same sensor in
    directions without a return here: beams that hit nothing. Directions are cells of 0.2 degrees of
    azimuth and 0.4 degrees of elevation; a cell is added if neither it nor one of its eight
    neighbours holds a return of the scan, with the first return of the other scans in it.

    Parameters
    ----------
    scan, others : (n, 3), (m, 3) float64, returns, each in the sensor's frame at its time; none at
        the origin

    Examples
    --------
    >>> ahead, left = np.array([[5.0, 0, 0], [9, 0, 0]]), np.array([[7.0, 0, 0], [0, 3, 0], [0, 4, 0]])
    >>> recorded_directions(ahead, left).tolist()
    [[1.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]
    """
    is_seen = np.zeros(_DIRECTION_CELLS, dtype=np.bool_)
    is_seen[_direction_cells(scan)] = True
    around = np.pad(is_seen, ((1, 1), (0, 0)), mode="wrap")
    is_near = binary_dilation(around, np.ones((3, 3)))[1:-1]
    columns, rows = _direction_cells(others)
    _, first = np.unique(columns * _DIRECTION_CELLS[1] + rows, return_index=True)
    added = np.sort(first[~is_near[columns[first], rows[first]]])
    returns = np.concatenate([scan, others[added]])
    return returns / np.linalg.norm(returns, axis=1)[:, None]


def _direction_cells(points: FloatArray) -> tuple[IndexArray, IndexArray]:
    """Column and row of the cell of each direction."""
    azimuth = azimuths_deg(points) + 180.0
    elevation = slopes_deg(points) + 90.0
    columns = np.floor(azimuth / _AZIMUTH_CELL_DEG).astype(np.intp) % _DIRECTION_CELLS[0]
    return columns, np.floor(elevation / _ELEVATION_CELL_DEG).astype(np.intp)


def _bands(points: FloatArray) -> IndexArray:
    """The band of range of each point, (n,) intp: 0 within 15 m, 1 to 30 m, 2 to 60 m, 3 beyond."""
    range_m = np.linalg.norm(points, axis=1)
    limits = _FULL_DETAIL_M * 2.0 ** np.arange(_BANDS - 1)
    return np.searchsorted(limits, range_m, side="left")


def _discs(
    centre: FloatArray,
    normal: FloatArray,
    radius_m: FloatArray,
) -> FloatArray:
    """Corners, (2 n, 3, 3), of squares, two triangles each, of the area of a disc."""
    upright = np.where(np.abs(normal[:, 2:]) < 0.9, [[0.0, 0.0, 1.0]], [[1.0, 0.0, 0.0]])
    u = np.cross(normal, upright)
    u /= np.linalg.norm(u, axis=1)[:, None]
    v = np.cross(normal, u)
    half_m = (np.sqrt(np.pi) / 2 * radius_m)[:, None]
    corners = []
    for a, b in ((1, 1), (-1, 1), (-1, -1), (1, -1)):
        corners.append(centre + half_m * (a * u + b * v))
    squares = np.stack(corners, axis=1)
    return squares[:, [[0, 1, 2], [0, 2, 3]]].reshape(-1, 3, 3)
