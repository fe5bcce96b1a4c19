"""Typical objects of a scan: one of a class by its labels, or one for each shape, of median size."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..arrays import FloatArray, IndexArray, IntArray

#: The shape features, in the order of the columns of `ScanObjects.shape`, and the name of an object of that shape.
SHAPES = {"linearity": "linear", "planarity": "planar", "scattering": "scattered"}
PURE_SHARE = 0.75


@dataclass(frozen=True)
class ChosenObject:
    """Chosen object of a scan.

    name : class or shape, or "object 7"
    n_points, range_m : size and distance
    why : text of the criterion of the choice
    """

    pair_id: str
    community_id: int
    name: str
    n_points: int
    range_m: float
    why: str


@dataclass(frozen=True)
class ScanObjects:
    """Objects of a scan, by community id.

    n_points, range_m : (n,) sizes, and distances in metres
    labels : most frequent label of the points of each; None without labels
    label_share : (n,) share of the points with that label
    shape : (n, 3) linearity, planarity and scattering
    """

    pair_id: str
    n_points: IntArray
    range_m: FloatArray
    labels: list[str | None]
    label_share: FloatArray
    shape: FloatArray

    def chosen(self, community_id: int, name: str, why: str) -> ChosenObject:
        """Chosen object by its id."""
        size = int(self.n_points[community_id])
        range_m = float(self.range_m[community_id])
        return ChosenObject(self.pair_id, community_id, name, size, range_m, why)

    def median_sized(self, candidates: IndexArray) -> int:
        """Id of the object of median size; for an even number the smaller one."""
        by_size = candidates[np.lexsort((candidates, self.n_points[candidates]))]
        return int(by_size[(len(by_size) - 1) // 2])


def typical_of_class(scan: ScanObjects, label: str, least: int) -> ChosenObject | None:
    """Typical object of a class; None if no object has the label.

    It is the one of median size among the objects of at least `least` points with three quarters of them of the label;
    without such objects, the largest with that most frequent label.
    """
    is_of_class = np.array([name == label for name in scan.labels], dtype=np.bool_)
    if not is_of_class.any():
        return None
    is_typical = is_of_class & (scan.label_share >= PURE_SHARE) & (scan.n_points >= least)
    typical = np.flatnonzero(is_typical)
    if len(typical):
        pure = f"{PURE_SHARE:.0%} of the label or more"
        why = f"median size of {len(typical)} with {least} points and {pure}"
        return scan.chosen(scan.median_sized(typical), label, why)
    largest = int(np.argmax(np.where(is_of_class, scan.n_points, -1)))
    why = f"the largest; none has {least} points and {PURE_SHARE:.0%} of the label"
    return scan.chosen(largest, label, why)


def typical_of_shapes(scan: ScanObjects, least: int) -> list[ChosenObject]:
    """Choose one object for each shape, no object twice; first objects of a shape, then the nearest of the others.

    The shape of an object is that of the largest of the three features; among the objects of a shape and at least
    `least` points the one of median size is chosen. A shape without a remaining object is left out.
    """
    is_large = scan.n_points >= least
    is_free = is_large.copy() if is_large.any() else np.ones(len(scan.n_points), dtype=np.bool_)
    n_candidates = is_free.sum()
    chosen: dict[str, ChosenObject] = {}
    for place, name in enumerate(SHAPES.values()):
        typical = np.flatnonzero((np.argmax(scan.shape, axis=1) == place) & is_large)
        if len(typical):
            why = f"median size of {len(typical)} {name} objects"
            chosen[name] = scan.chosen(scan.median_sized(typical), name, why)
            is_free[chosen[name].community_id] = False
    for place, (feature, name) in enumerate(SHAPES.items()):
        if name not in chosen and is_free.any():
            share = np.where(is_free, scan.shape[:, place], -np.inf)
            nearest = int(np.argmax(share))
            rest = "" if is_free.sum() == n_candidates else " of the others"
            largest = f"the largest {feature}{rest}, {share[nearest]:.2f}"
            why = f"none mostly {name}; this one has {largest}"
            chosen[name] = scan.chosen(nearest, name, why)
            is_free[nearest] = False
    return [chosen[name] for name in SHAPES.values() if name in chosen]
