"""Description of objects: place, size and shape of each community."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from .arrays import FloatArray, IntArray, rows_by_id

Name = TypeVar("Name", int, str)


@dataclass(frozen=True)
class Objects:
    """Place, size and shape, one row per community, by id; NaN for one without points.

    n_points : (c,) int32
    centroid : (c, 3) float64, metres, mean of the member points
    extent : (c, 3) float64, metres, axis-aligned size
    shape : (c, 3) float64, linearity, planarity, scattering
    """

    n_points: IntArray
    centroid: FloatArray
    extent: FloatArray
    shape: FloatArray

    @property
    def range_m(self) -> FloatArray:
        """Distance of the centroid from the sensor, (c,) float64, metres."""
        return np.linalg.norm(self.centroid, axis=1)


def describe_objects(points: FloatArray, labels: IntArray, n_ids: int = 0) -> Objects:
    """Compute size, place and shape of each community.

    With l1 >= l2 >= l3 the eigenvalues of the covariance of the member points, linearity is (l1 - l2) / l1,
    planarity (l2 - l3) / l1, scattering l3 / l1 (Demantke et al., ISPRS 2011); all three are 0 if l1 is 0.

    Parameters
    ----------
    points : (n, 3) float64, metres, at least one
    labels : (n,) int32, ids from 0; -1 for none
    n_ids : minimum number of ids; ids without a point have n_points 0

    Examples
    --------
    >>> import numpy as np
    >>> objects = describe_objects(np.array([[3.0, 0, 0], [5, 0, 0], [0, 9, 0]]), np.array([0, 0, 1]))
    >>> objects.n_points.tolist(), objects.range_m.tolist(), objects.shape[0].tolist()
    ([2, 1], [4.0, 9.0], [1.0, 0.0, 0.0])
    """
    rows_of = rows_by_id(labels, n_ids)
    n_points = np.array([len(rows) for rows in rows_of], dtype=np.int32)
    described = np.full((3, len(rows_of), 3), np.nan)
    for i in np.flatnonzero(n_points):
        member = points[rows_of[i]]
        described[0, i] = member.mean(axis=0)
        described[1, i] = np.ptp(member, axis=0)
        described[2, i] = _shape(member)
    return Objects(n_points, *described)


def majority_labels(
    labels: IntArray,
    names: list[Name | None],
    n_ids: int = 0,
) -> list[Name | None]:
    """Most frequent name in each community, for equal counts the first in order; None without names.

    Parameters
    ----------
    labels : (n,) int32, community of each point, ids from 0; -1 for none
    names : (n,) class (or another name) of each point, or None
    n_ids : minimum number of ids
    """
    majority = []
    for rows in rows_by_id(labels, n_ids):
        counts = Counter(names[row] for row in rows if names[row] is not None)
        majority.append(max(sorted(counts), key=counts.__getitem__, default=None))
    return majority


def _shape(points: FloatArray) -> tuple[float, float, float]:
    """Linearity, planarity and scattering of the points of one community."""
    centred = points - points.mean(axis=0)
    # Scaled to about 1: squares of 1e-200 m would be 0.
    exponent = np.frexp(np.abs(centred).max())[1]
    centred = np.ldexp(centred, -exponent)
    covariance = centred.T @ centred / len(points)
    l3, l2, l1 = np.maximum(np.linalg.eigvalsh(covariance), 0.0)
    if l1 <= 0:
        return 0.0, 0.0, 0.0
    return (l1 - l2) / l1, (l2 - l3) / l1, l3 / l1
