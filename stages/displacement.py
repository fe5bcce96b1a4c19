"""Position of the simulated side against the real one, in six degrees of freedom, with systematic errors of range."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from operator import itemgetter

import numpy as np
from scipy.spatial import cKDTree

from ..schemas.cause_catalogue import PARAMETERS
from .arrays import BoolArray, FloatArray, IndexArray
from .reference import visiting_order
from .surfels import fit_planes, voxel_ids

#: Azimuth of the seam of a sweep of which the pose is right ahead, and all seams that are tried, this one first.
BEHIND_DEG = 180.0
SEAMS_DEG = (BEHIND_DEG, 0.0, 90.0, -90.0)
_COARSE_REACHES_M = (1.5, 1.5)
_CLEARLY = 0.93  # misfit of another seam, over that behind
_IS_ANGLE = np.isin(PARAMETERS, ("roll", "pitch", "yaw", "motion turning"))
_VOXEL_M = 0.5
_MOST_PLACES = 6000
_NEIGHBOURS = 16
_FLAT = 0.02  # l3 / l1 of a plane, at most
_REACHES_M = (1.5, 1.5, 1.0, 1.0, 0.7, 0.7)
_FINE_REACH_M, _FINE_STEPS = 0.5, 8
_TUKEY, _LEAST_SPREAD_M = 4.685, 0.01  # efficiency of 95 % under normal errors
#: Standard deviations of the parameters; radians.
_PRIOR = np.array([1.0, 1.0, 1.0, 0.05, 0.05, 0.05, 0.05, 0.5, 3.0, 3.0, 0.5, 0.5])
#: If the variance of the road's height stays above this part of its prior, hardly anything but the road shows a height:
#: then the road is as high as the world, and large information keeps the difference at 0.
_UNKNOWN, _FIXED = 0.5, 1e9
_ROAD = PARAMETERS.index("road height")
#: The sensor does not turn during a sweep, unless the surfaces fit clearly better after some steps in which it may.
_WITHOUT_TURNING = np.where(np.array(PARAMETERS) == "motion turning", 1e-6, _PRIOR)
_TRIAL_STEPS = 3
_TURNED = 0.96  # mean square with a turn over that without: turns of 0.5 degrees have up to 0.945, others from 0.972 on
_MOST_RESIDUAL_M = 0.1
_NOISE_M, _CORRELATED = 0.1, 20  # of a distance to a plane, and the places that share an error


@dataclass(frozen=True)
class Displacement:
    """Displacement of the simulated side: x_sim = x + displacement(x).

    values : (12,) float64, of `PARAMETERS`
    seam_deg : azimuth at which a sweep begins and ends; the pose is right in the opposite direction
    """

    values: FloatArray
    seam_deg: float = BEHIND_DEG

    def without(self, parameter: int) -> Displacement:
        """The displacement without one of its parameters."""
        values = self.values.copy()
        values[parameter] = 0.0
        return Displacement(values, self.seam_deg)

    def of(self, points: FloatArray, is_ground: BoolArray) -> FloatArray:
        """(n, 3) metres, displacement of real points."""
        values = np.where(_IS_ANGLE, np.radians(self.values), self.values)
        return _displaced_by(values, _derivatives(points, is_ground, self.seam_deg))

    def undo(self, points: FloatArray, is_ground: BoolArray) -> FloatArray:
        """(n, 3) simulated points without the displacement: two steps of a fixed point."""
        place = points - self.of(points, is_ground)
        return points - self.of(place, is_ground)


def fit_displacement(real: cKDTree, sim: cKDTree, is_ground: BoolArray) -> Displacement | None:
    """Fit the displacement of the simulated surface, or None without enough planes in common.

    Least squares of distances along normals, point to plane (Chen and Medioni, Image Vision Comput. 1992), linear in
    all parameters: a rigid motion, a scale and a constant error of range, and a motion of the sensor during the sweep,
    of which the pose is right opposite the seam. The seam is behind, unless another one fits clearly better. A weak
    prior keeps at 0 what no surface shows. The last steps compare the mean of as many simulated points as the plane
    has, which lies inside a curved surface as that of the real ones does, and weigh distances by Tukey's biweight:
    surface that differs has no say. The sensor turns during the sweep only if the surfaces then fit clearly better.

    Parameters
    ----------
    real, sim : search trees of the clean points, (n, 3), (m, 3) float64, metres, ground included
    is_ground : (n,) bool, of the real points
    """
    order = visiting_order(real.data, 0)
    _, first = np.unique(voxel_ids(real.data[order], _VOXEL_M), return_index=True)
    rows = order[np.sort(first)[:_MOST_PLACES]]
    planes = fit_planes(real, real.data[rows], _NEIGHBOURS)
    l3, _, l1 = planes.variance.T
    is_plane = (l3 <= _FLAT * l1) & ~planes.is_line
    places = planes.mean[is_plane]
    normal = planes.normal[is_plane]
    is_low = is_ground[rows[is_plane]]
    candidates = []
    for seam_deg in SEAMS_DEG:
        fit = _Fit(places, normal, _derivatives(places, is_low, seam_deg), sim, seam_deg)
        values = fit.steps(np.zeros(len(PARAMETERS)), _COARSE_REACHES_M)
        if values is not None:
            weight = _CLEARLY if seam_deg == BEHIND_DEG else 1.0
            candidates.append((weight * fit.misfit(values), values, fit))
    if not candidates:
        return None
    _, values, fit = min(candidates, key=itemgetter(0))
    values = fit.steps(values, (*_REACHES_M, *[_FINE_REACH_M] * _FINE_STEPS))
    if values is None:
        return None
    turned = fit.steps(values, [_FINE_REACH_M] * _TRIAL_STEPS, _PRIOR)
    if turned is not None and fit.mean_square(turned) < _TURNED * fit.mean_square(values):
        values = fit.steps(turned, [_FINE_REACH_M] * _FINE_STEPS, _PRIOR)
    if values is None:
        return None
    return Displacement(np.where(_IS_ANGLE, np.degrees(values), values), fit.seam_deg)


@dataclass(frozen=True, eq=False)
class _Fit:
    """Planes of the real surface, and the simulated points that are fitted to them.

    places, normal : (n, 3) of each plane
    derivatives : (12, 3, n) of each place by the parameters
    sim : search tree of the simulated points
    """

    places: FloatArray
    normal: FloatArray
    derivatives: FloatArray
    sim: cKDTree
    seam_deg: float

    def steps(
        self,
        values: FloatArray,
        reaches_m: Sequence[float],
        prior: FloatArray = _WITHOUT_TURNING,
    ) -> FloatArray | None:
        """Better parameters after a step with each reach; None if too few planes have any points within."""
        for reach_m in reaches_m:
            is_fine = reach_m == _FINE_REACH_M
            met, off_m = self._offsets(values, reach_m, _NEIGHBOURS if is_fine else 1)
            if len(met) < 10 * len(PARAMETERS):
                return None
            slopes = self.slopes[met]
            weighted = slopes / (_NOISE_M**2 * _CORRELATED)
            if is_fine:
                weighted *= _biweight(off_m - slopes @ values)[:, None]
            information = weighted.T @ slopes + np.diag(prior**-2.0)
            if np.linalg.inv(information)[_ROAD, _ROAD] > _UNKNOWN * _PRIOR[_ROAD] ** 2:
                information[_ROAD, _ROAD] += _FIXED
            values = np.linalg.solve(information, weighted.T @ off_m).astype(np.float64)
        return values

    def mean_square(self, values: FloatArray) -> float:
        """Mean square of the distances that the displacement leaves, each counted up to 0.1 m."""
        met, off_m = self._offsets(values, _FINE_REACH_M, _NEIGHBOURS)
        left_m = np.minimum(np.abs(off_m - self.slopes[met] @ values), _MOST_RESIDUAL_M)
        return float((left_m**2).mean())

    @cached_property
    def slopes(self) -> FloatArray:
        """(n, 12) distance along the normal of each plane by the parameters."""
        return np.einsum("pkn,nk->np", self.derivatives, self.normal)

    def _offsets(
        self, values: FloatArray, reach_m: float, n_near: int
    ) -> tuple[IndexArray, FloatArray]:
        """Planes with simulated points within reach of their displaced place, and the distance of these from them."""
        distance, near = self.sim.query(
            self.places + _displaced_by(values, self.derivatives),
            k=range(1, 1 + n_near),
            distance_upper_bound=reach_m,
        )
        met = np.flatnonzero(np.isfinite(distance[:, 0]))
        is_near = np.isfinite(distance[met])
        points = self.sim.data.take(np.where(is_near, near[met], 0), axis=0)
        mean = np.einsum("nkd,nk->nd", points, is_near) / is_near.sum(axis=1, keepdims=True)
        return met, ((mean - self.places[met]) * self.normal[met]).sum(axis=1)

    def misfit(self, values: FloatArray) -> float:
        """Mean distance of the simulated points from the displaced planes, each counted up to half a metre."""
        displaced = self.places + _displaced_by(values, self.derivatives)
        distance, near = self.sim.query(displaced, distance_upper_bound=_FINE_REACH_M)
        is_met = np.isfinite(distance)
        gap = np.full(len(displaced), _FINE_REACH_M)
        offset = self.sim.data[near[is_met]] - displaced[is_met]
        gap[is_met] = np.abs((offset * self.normal[is_met]).sum(axis=1))
        return float(gap.mean())


def _biweight(residual: FloatArray) -> FloatArray:
    """Weights of distances (Tukey), their spread from the median of the absolute ones."""
    spread = max(1.4826 * float(np.median(np.abs(residual))), _LEAST_SPREAD_M)
    return np.maximum(1.0 - (residual / (_TUKEY * spread)) ** 2, 0.0) ** 2


def _derivatives(points: FloatArray, is_ground: BoolArray, seam_deg: float) -> FloatArray:
    """(12, 3, n) derivative of each point's position by the parameters, angles in radians."""
    derivatives = np.zeros((len(PARAMETERS), 3, len(points)))
    x, y, z = points.T
    derivatives[[0, 1, 2], [0, 1, 2]] = 1.0
    derivatives[3, 1] = -z
    derivatives[3, 2] = y
    derivatives[4, 0] = z
    derivatives[4, 2] = -x
    derivatives[5, 0] = -y
    derivatives[5, 1] = x
    derivatives[6] = points.T
    derivatives[7] = points.T / np.maximum(np.linalg.norm(points, axis=1), 1e-9)
    since_seam = np.arctan2(y, x) - np.radians(seam_deg)
    turn = np.mod(since_seam, 2 * np.pi) / (2 * np.pi) - 0.5
    derivatives[8, 0] = derivatives[9, 1] = turn
    derivatives[10] = turn * derivatives[5]
    derivatives[11, 2] = is_ground
    return derivatives


def _displaced_by(values: FloatArray, derivatives: FloatArray) -> FloatArray:
    """(n, 3) displacement by parameters, angles in radians."""
    return np.tensordot(values, derivatives, 1).T
