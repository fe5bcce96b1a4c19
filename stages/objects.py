"""Describes each community as an object: where it is, how large, of what shape.

Leaves to others: which points belong together (`communities`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .arrays import FloatArray, IntArray


@dataclass(frozen=True)
class Objects:
    """One row a community, by id.

    n_points : (c,) int32
    centroid : (c, 3) float64, metres, mean of the member points
    extent : (c, 3) float64, metres, axis-aligned size
    shape : (c, 3) float64, linearity, planarity, scattering
    """

    n_points: IntArray
    centroid: FloatArray
    extent: FloatArray
    shape: FloatArray


def describe_objects(points: FloatArray, labels: IntArray) -> Objects:
    """Size, place and shape of each community.

    With l1 >= l2 >= l3 the eigenvalues of the covariance of the member points, linearity is (l1 - l2) / l1,
    planarity (l2 - l3) / l1, scattering l3 / l1 (Demantke et al., ISPRS 2011); all three are 0 where l1 is 0.

    Parameters
    ----------
    points : (n, 3) float64, metres
    labels : (n,) int32, ids from 0 without gaps
    """
    order = np.argsort(labels, kind="stable")
    n_points = np.bincount(labels).astype(np.int32)
    members = np.split(points[order], np.cumsum(n_points)[:-1])
    centroid = np.array([of.mean(axis=0) for of in members])
    extent = np.array([np.ptp(of, axis=0) for of in members])
    shape = np.array([_shape(of) for of in members])
    return Objects(n_points, centroid, extent, shape)


def majority_labels(labels: IntArray, names: list[str | None]) -> list[str | None]:
    """The most frequent name in each community, of equals the first in the alphabet; None without names."""
    counts: list[dict[str, int]] = [{} for _ in range(int(labels.max()) + 1)]
    for community, name in zip(labels.tolist(), names, strict=True):
        if name is not None:
            counts[community][name] = counts[community].get(name, 0) + 1
    return [min(of, key=lambda name: (-of[name], name)) if of else None for of in counts]


def _shape(points: FloatArray) -> tuple[float, float, float]:
    centred = points - points.mean(axis=0)
    l3, l2, l1 = np.maximum(np.linalg.eigvalsh(centred.T @ centred / len(points)), 0.0)
    if l1 <= 0:
        return 0.0, 0.0, 0.0
    return float((l1 - l2) / l1), float((l2 - l3) / l1), float(l3 / l1)
