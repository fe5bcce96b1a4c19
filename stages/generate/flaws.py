"""Known flaws of simulators, applied to a scan in a given amount, to see which scores respond.

Each needs only the points of a scan, so that it has the same meaning for every scan; a beam through
a hole does not hit anything behind it. Noise, dropout and rigid motion are those of the paper (section "Controlled
Perturbation Analysis"); it names hallucination and local density change but does not sweep them, so their definitions
are ours.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.random import Generator
from scipy.spatial import cKDTree

from ...schemas.errors import FidpipeError, SettingsError, suggestion
from ..arrays import BoolArray, FloatArray
from ..surfels import fit_planes, voxel_means

SCATTERED = 0.1  # l3 / l1 of foliage, and more
_NEIGHBOURS = 40
_BLUR_VOXELS = 4  # per radius
_BLUR_NEIGHBOURS = 96
_FAR_M = 25.0
_HOLE_M = 1.5
_CLUSTER_POINTS = 20
_CLUSTER_STD_M = 0.15
_CLUSTER_DISTANCE_M = 0.5
_REGION_RADIUS_M = 2.0
_REGION_SHARE = 0.3
_SURFACE_NEIGHBOURS = 5


@dataclass(frozen=True)
class Flaw:
    """One kind of flaw. Call it with points, an amount and a random generator to alter the points.

    amount : description of the amount
    high, low : bounds of the amount
    alter : function of points, amount and random generator that returns the altered points
    is_systematic : all scans of a simulator have the same flaw, so that they share one seed
    is_count : the amount is a whole number
    """

    amount: str
    high: float
    alter: Callable[[FloatArray, float, Generator], FloatArray]
    low: float = 0
    is_systematic: bool = False
    is_count: bool = False

    def __call__(self, points: FloatArray, amount: float, rng: Generator) -> FloatArray:
        """Return the altered points, (m, 3): the kept points in their order, then new ones. No points remain no points.

        Parameters
        ----------
        points : (n, 3) float64, metres, sensor at the origin, z up; not changed
        amount : amount of the flaw; 0 changes nothing, for `density` 1
        rng : source of all random numbers
        """
        return self.alter(points, amount, rng) if len(points) else points.copy()

    def parse(self, text: str, option: str) -> float:
        """The amount in a text; `SettingsError`, which names the option, if it is out of bounds."""
        try:
            amount = float(text)
        except ValueError:
            amount = float("nan")
        is_wrong_count = self.is_count and not amount.is_integer()
        if is_wrong_count or not self.low <= amount <= self.high:
            kind = "whole number" if self.is_count else "number"
            raise SettingsError(
                f"{option}: expected a {kind} from {self.low:g} to {self.high:g} ({self.amount}), "
                f"got {text!r}"
            )
        return amount


@dataclass(frozen=True)
class Perturbation:
    """A perturbation of the paper's experiment.

    kind : one of `KINDS`
    amount : of that flaw; rigid: the angle
    shift_m : rigid only, length of the translation
    """

    kind: str
    amount: float
    shift_m: float = 0.0

    def __str__(self) -> str:
        shift = f"{self.shift_m:g}:" if self.kind == "rigid" else ""
        return f"{self.kind} {shift}{self.amount:g}"


def perturb(points: FloatArray, perturbation: Perturbation, rng: Generator) -> FloatArray:
    """The altered points, (m, 3); remaining points keep their order (except for `null`), new ones follow.

    Parameters
    ----------
    points : (n, 3) float64, metres, sensor at the origin
    perturbation : kind and amount
    rng : source of all randomness

    Examples
    --------
    >>> import numpy as np
    >>> line = np.arange(30.0).reshape(10, 3)
    >>> len(perturb(line, Perturbation("dropout", 0.4), np.random.default_rng(0)))
    7
    """
    if perturbation.kind == "rigid":
        return move_rigidly(points, perturbation.amount, rng, perturbation.shift_m)
    return KINDS[perturbation.kind].alter(points, perturbation.amount, rng)


def carried(points: FloatArray, intensity: FloatArray, altered: FloatArray) -> FloatArray:
    """Intensity of the points after a flaw: of the same rows if their number is the same, else of the nearest point.

    Parameters
    ----------
    points, intensity : (n, 3) and (n,) float64, before
    altered : (m, 3) float64, after
    """
    if len(points) == len(altered) or not len(altered):
        return intensity[: len(altered)]
    _, nearest = cKDTree(points).query(altered)
    return intensity[nearest]


def reorder(points: FloatArray, n_lost: float, rng: Generator) -> FloatArray:
    """All points except a few, in a random order: the scene is the same, but Louvain visits nodes in their order."""
    return points[rng.permutation(len(points))[round(n_lost) :]]


def add_noise(points: FloatArray, std_m: float, rng: Generator) -> FloatArray:
    """Points with independent Gaussian noise on each coordinate."""
    return points + rng.normal(0.0, std_m, points.shape)


def drop_points(points: FloatArray, share: float, rng: Generator) -> FloatArray:
    """The points without those lost, each independently with the same probability."""
    return points[rng.random(len(points)) >= share]


def move_rigidly(
    points: FloatArray,
    angle_deg: float,
    rng: Generator,
    shift_m: float = 0.0,
) -> FloatArray:
    """Points rotated about +Z through the sensor, then moved in a random horizontal direction."""
    angle = np.radians(angle_deg)
    heading = rng.uniform(0.0, 2 * np.pi)
    cos = np.cos(angle)
    sin = np.sin(angle)
    R = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
    return points @ R.T + shift_m * np.array([np.cos(heading), np.sin(heading), 0.0])


def add_clusters(points: FloatArray, share: float, rng: Generator) -> FloatArray:
    """The points and round(share n) spurious ones, in clusters of 20 (the last one smaller).

    The centre of a cluster is 0.5 m from a random point in a random direction, its points are
    Gaussian about the centre with 0.15 m on each coordinate: a blob of foliage or mesh in empty
    space.
    """
    n_new = round(share * len(points))
    if not n_new:
        return points.copy()
    n_clusters = -(-n_new // _CLUSTER_POINTS)
    direction = rng.normal(size=(n_clusters, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    centre = (
        points[rng.integers(len(points), size=n_clusters)] + _CLUSTER_DISTANCE_M * direction
    )
    cluster_ids = np.arange(n_new) // _CLUSTER_POINTS
    return np.vstack(
        [points, centre[cluster_ids] + rng.normal(0.0, _CLUSTER_STD_M, (n_new, 3))]
    )


def change_density(points: FloatArray, factor: float, rng: Generator) -> FloatArray:
    """The points with another density in regions that together hold 30 % of them.

    Regions grow about random points: each takes the nearest free points within 2 m until the share
    is reached. Below 1, a point of a region stays with probability `factor`. Above 1, a region of m
    points gets round((factor - 1) m) more, each on the line from a random point of the region to a
    random one of its 5 nearest neighbours in the scan, so that they lie on the surface.
    """
    chosen = grow_regions(points, round(_REGION_SHARE * len(points)), rng)
    if factor <= 1:
        return points[~chosen | (rng.random(len(points)) < factor)]
    n_new = round((factor - 1) * np.count_nonzero(chosen))
    if not n_new or len(points) < 2:
        return points.copy()
    start = rng.choice(np.flatnonzero(chosen), size=n_new)
    n_near = min(_SURFACE_NEIGHBOURS, len(points) - 1)
    _, near = cKDTree(points).query(points[start], k=n_near + 1)
    end = near[np.arange(n_new), rng.integers(1, n_near + 1, size=n_new)]
    return np.vstack(
        [points, points[start] + rng.random((n_new, 1)) * (points[end] - points[start])],
    )


def grow_regions(points: FloatArray, n_chosen: int, rng: Generator) -> BoolArray:
    """Mask of `n_chosen` points in regions of 2 m about random points, (n,) bool."""
    chosen = np.zeros(len(points), dtype=np.bool_)
    tree = cKDTree(points)
    n_left = n_chosen
    while n_left:
        centre = points[rng.choice(np.flatnonzero(~chosen))]
        inside = np.array(tree.query_ball_point(centre, _REGION_RADIUS_M), dtype=np.intp)
        inside = inside[~chosen[inside]]
        distance = np.linalg.norm(points[inside] - centre, axis=1)
        taken = inside[np.lexsort((inside, distance))[:n_left]]
        chosen[taken] = True
        n_left -= len(taken)
    return chosen


def is_foliage(points: FloatArray) -> BoolArray:
    """True for points in scattered surroundings, (n,) bool: l3 / l1 of the 40 nearest points is at least 0.1.

    Parameters
    ----------
    points : (n, 3) float64, metres
    """
    return fit_planes(points, points, _NEIGHBOURS).scattering >= SCATTERED


def lose_foliage(points: FloatArray, share: float, rng: Generator) -> FloatArray:
    """Remove a share of the foliage, rounded to whole points, in clumps of 2 m instead of single leaves."""
    rows = np.flatnonzero(is_foliage(points))
    lost = rows[grow_regions(points[rows], round(share * len(rows)), rng)]
    return np.delete(points, lost, axis=0)


def _lose_far(points: FloatArray, share: float, rng: Generator) -> FloatArray:
    """Remove a share of the points with a range above 25 m, each independently."""
    is_far = np.linalg.norm(points, axis=1) > _FAR_M
    return points[~(is_far & (rng.random(len(points)) < share))]


def _cut_holes(points: FloatArray, n_holes: float, rng: Generator) -> FloatArray:
    """Remove the points within 1.5 m of `n_holes` random points."""
    centres = points[rng.integers(len(points), size=round(n_holes))]
    apart, _ = cKDTree(centres).query(
        points, distance_upper_bound=np.nextafter(_HOLE_M, np.inf)
    )
    return points[np.isinf(apart)]


def _blur(points: FloatArray, radius_m: float, rng: Generator) -> FloatArray:
    """Move each point along the normal onto the plane of its surroundings within `radius_m`.

    One step of a moving least squares projection (Alexa et al., IEEE Visualization 2001) onto the
    scan's voxel means, four voxels per radius, independent of the density of rings: planes remain,
    roughness disappears, corners are cut, and objects thinner than the radius become a sheet.
    """
    if radius_m == 0:
        return points.copy()
    means = voxel_means(points, radius_m / _BLUR_VOXELS)
    planes = fit_planes(means, points, _BLUR_NEIGHBOURS, radius_m)
    off_m = ((planes.mean - points) * planes.normal).sum(axis=1)
    return points + np.where(planes.n_neighbours >= 3, off_m, 0.0)[:, None] * planes.normal


def _shift(points: FloatArray, shift_m: float, rng: Generator) -> FloatArray:
    return move_rigidly(points, 0.0, rng, shift_m)


def _mirror(points: FloatArray, is_mirrored: float, rng: Generator) -> FloatArray:
    return points * [1.0, -1.0 if is_mirrored else 1.0, 1.0]


#: Flaws by name, in the order in which they are applied to a scan: losses, distortions, additions, then rigid motions.
FLAWS = {
    "foliage": Flaw("share of the foliage lost, in clumps of 2 m", 1, lose_foliage),
    "holes": Flaw("number of holes of 1.5 m", 10_000, _cut_holes, is_count=True),
    "far-dropout": Flaw("share lost beyond 25 m", 1, _lose_far),
    "dropout": Flaw("share of the points lost", 1, drop_points),
    "density": Flaw(
        "factor of the density in regions that hold 30 % of the points", 20, change_density
    ),
    "blur": Flaw("radius within which surfaces are smoothed, metres", 5, _blur),
    "noise": Flaw("std of the noise on each coordinate, metres", 10, add_noise),
    "ghosts": Flaw("points in ghost clusters of 20, per point", 10, add_clusters),
    "yaw": Flaw(
        "turn about the vertical, degrees", 180, move_rigidly, -180, is_systematic=True
    ),
    "offset": Flaw(
        "shift in a random horizontal direction, metres", 100, _shift, is_systematic=True
    ),
    "mirrored": Flaw(
        "1: y is negated; 0: it is not", 1, _mirror, is_systematic=True, is_count=True
    ),
}

#: The flaws of the paper's experiment by its names.
KINDS = {
    "noise": FLAWS["noise"],
    "dropout": FLAWS["dropout"],
    "rigid": FLAWS["yaw"],
    "hallucination": FLAWS["ghosts"],
    "density": FLAWS["density"],
    "null": Flaw("number of points lost, the others in another order", 100, reorder),
}


def parse_flaws(words: Sequence[str]) -> dict[str, float]:
    """Parse flaws such as `dropout=0.3` and `mirrored` into amounts by name, in the order of `FLAWS`.

    Raises
    ------
    FidpipeError
        Text of another form, an unknown flaw, a flaw given twice, or an amount out of bounds.

    Examples
    --------
    >>> parse_flaws(["mirrored", "holes=12"])
    {'holes': 12.0, 'mirrored': 1.0}
    """
    amounts: dict[str, float] = {}
    for word in words:
        name, _, text = word.partition("=")
        if name not in FLAWS:
            raise FidpipeError(f"flaw {name!r}: unknown; {suggestion(name, FLAWS)}")
        if name in amounts:
            raise FidpipeError(f"flaw {name}: given twice; give it once")
        amounts[name] = FLAWS[name].parse("1" if word == "mirrored" else text, f"flaw {name}")
    return {name: amounts[name] for name in FLAWS if name in amounts}
