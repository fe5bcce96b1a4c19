"""Local planes of the surface around points, and downsampling to one point per voxel."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy

from .arrays import BoolArray, FloatArray, IndexArray, sums_by_id
from .linalg.nearest import search_tree

_BROAD = 0.02  # l2 / l1 of a plane that is not a line, at least
_ROWS_AT_ONCE = 8192  # limits the memory of neighbourhoods


@dataclass(frozen=True)
class LocalPlanes:
    """Planes through the neighbours of each place.

    mean : (n, 3) float64, metres, weighted mean of the neighbours
    normal : (n, 3) float64, unit vectors: the axis along which the neighbours vary least, of either sign
    variance : (n, 3) float64, m^2, along the three principal axes, ascending; l3, l2, l1 of the literature
    n_neighbours : (n,) intp, number of neighbours; a plane needs three
    """

    mean: FloatArray
    normal: FloatArray
    variance: FloatArray
    n_neighbours: IndexArray

    @property
    def scattering(self) -> FloatArray:
        """l3 / l1 (Demantke et al., ISPRS 2011): 0 on a plane or a line, 1 for equal variance on all axes."""
        smallest, _, largest = self.variance.T
        return smallest / np.maximum(largest, 1e-300)

    @property
    def is_line(self) -> BoolArray:
        """True where the neighbours are on a line, so that the normal is arbitrary."""
        return self.variance[:, 1] < _BROAD * self.variance[:, 2]


def fit_planes(
    surface: FloatArray | scipy.spatial.cKDTree,
    places: FloatArray,
    n_most: int,
    reach_m: float = np.inf,
) -> LocalPlanes:
    """Fit a plane to the neighbours of each place, by weighted principal component analysis.

    The neighbours are the `n_most` nearest points within `reach_m`. With a finite reach h their weights are
    exp(-(2 d / h)^2), as in moving least squares (Alexa et al., IEEE Visualization 2001); otherwise all weights are 1.
    A place without neighbours has itself as mean, and variance 0.

    Parameters
    ----------
    surface : (m, 3) float64, metres, or their search tree
    places : (n, 3) float64, metres

    Examples
    --------
    >>> import numpy as np
    >>> floor = np.array([[x, y, 0.0] for x in range(3) for y in range(3)])
    >>> planes = fit_planes(floor, floor[4:5], 9)
    >>> np.abs(planes.normal).tolist(), planes.n_neighbours.tolist()
    ([[0.0, 0.0, 1.0]], [9])
    """
    tree = surface if isinstance(surface, scipy.spatial.cKDTree) else search_tree(surface)
    points = tree.data
    n = len(places)
    n_most = min(n_most, len(points))
    planes = LocalPlanes(
        mean=places.copy(),
        normal=np.tile([0.0, 0.0, 1.0], (n, 1)),
        variance=np.zeros((n, 3)),
        n_neighbours=np.zeros(n, dtype=int),
    )
    if not n_most:
        return planes
    ranks = np.arange(1, n_most + 1)
    for start in range(0, n, _ROWS_AT_ONCE):
        rows = slice(start, start + _ROWS_AT_ONCE)
        place = places[rows]
        distance_m, ids = tree.query(place, k=ranks, distance_upper_bound=reach_m)
        is_near = np.isfinite(distance_m)
        share = 2 * np.where(is_near, distance_m, 0.0) / reach_m
        weight = is_near * np.exp(-(share**2))
        total = np.maximum(weight.sum(axis=1, keepdims=True), 1e-300)
        neighbours = points.take(np.where(is_near, ids, 0), axis=0)
        offset = neighbours - place[:, None]
        mean = np.einsum("nk,nkd->nd", weight, offset) / total
        scale = np.sqrt(weight / total)
        centred = (offset - mean[:, None]) * scale[..., None]
        covariance = centred.transpose(0, 2, 1) @ centred
        variance, axes = np.linalg.eigh(covariance)
        planes.mean[rows] += mean
        planes.normal[rows] = axes[:, :, 0]
        planes.variance[rows] = np.maximum(variance, 0.0)
        planes.n_neighbours[rows] = is_near.sum(axis=1)
    return planes


def voxel_means(points: FloatArray, edge_m: float) -> FloatArray:
    """Mean of the points of each occupied voxel, (v, 3) float64, in the order of the voxels.

    Parameters
    ----------
    points : (n, 3) float64, metres
    edge_m : edge of a voxel; one voxel has a corner at the origin

    Examples
    --------
    >>> voxel_means(np.array([[0.1, 0, 0], [0.3, 0, 0], [1.5, 0, 0]]), 1.0).tolist()
    [[0.2, 0.0, 0.0], [1.5, 0.0, 0.0]]
    """
    _, ids, n_points = np.unique(
        voxel_ids(points, edge_m),
        return_inverse=True,
        return_counts=True,
    )
    return sums_by_id(points, ids, len(n_points)) / n_points[:, None]


def voxel_ids(points: FloatArray, edge_m: float) -> IndexArray:
    """Number of the voxel of each point, (n,) int64; unique within a million voxels of the origin.

    Parameters
    ----------
    points : (n, 3) float64, metres
    edge_m : of a voxel
    """
    cells = np.floor(points / edge_m).astype(np.int64) + 2**20
    x, y, z = cells.T
    return (x << 42) | (y << 21) | z
