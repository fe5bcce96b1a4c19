"""Known flaws of simulators, applied to a scan in a given amount, to see which scores respond.

Each needs only the points of a scan, so that it has the same meaning for every scan; a beam through
a hole does not hit anything behind it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.random import Generator
from scipy.spatial import cKDTree

from ...schemas.errors import FidpipeError, suggestion
from ..arrays import BoolArray, FloatArray
from ..surfels import fit_planes, voxel_means
from .perturbations import (
    add_clusters,
    add_noise,
    change_density,
    drop_points,
    grow_regions,
    move_rigidly,
)

SCATTERED = 0.1  # l3 / l1 of foliage, and more
_NEIGHBOURS = 40
_BLUR_VOXELS = 4  # per radius
_BLUR_NEIGHBOURS = 96
_BEAM_DEG = 0.2
_MAX_SLIDE = 0.1
_THIN = 1e-3


@dataclass(frozen=True)
class Flaw:
    """One kind of flaw. Call it with points, an amount and a random generator to alter the points.

    name : name in the command
    amount : description of the amount
    high, low : bounds of the amount
    alter : function of points, amount, random generator and, if it has one, `at_m`, that returns
        the altered points; by default their coordinates stay
    is_systematic : all scans of a simulator have the same flaw, so that they share one seed
    at_m : default second parameter in metres, or None
    at : description of the second parameter
    is_whole : the amount is an integer
    intensity : function of points, intensity and amount that returns the altered intensity, or
        None; see `carried`
    """

    name: str
    amount: str
    high: float
    alter: Callable[..., FloatArray] = lambda points, amount, rng: points.copy()
    low: float = 0
    is_systematic: bool = False
    at_m: float | None = None
    at: str = ""
    is_whole: bool = False
    intensity: Callable[[FloatArray, FloatArray, float], FloatArray] | None = None

    def __call__(
        self,
        points: FloatArray,
        amount: float,
        rng: Generator,
        at_m: float | None = None,
    ) -> FloatArray:
        """Return the altered points, (m, 3): the kept points in their order, then new ones. No points remain no points.

        Parameters
        ----------
        points : (n, 3) float64, metres, sensor at the origin, z up; not changed
        amount : amount of the flaw; 0 changes nothing, for `density` 1
        rng : source of all random numbers
        at_m : second parameter

        Raises
        ------
        FidpipeError
            The amount is out of bounds, or a second parameter is given for a flaw that has none.
        """
        self.check(amount, at_m)
        if not len(points):
            return points.copy()
        second = at_m or self.at_m
        return self.alter(points, amount, rng, *([] if second is None else [second]))

    def check(self, amount: float, at_m: float | None = None) -> None:
        """Raise `FidpipeError` if an amount or a second parameter is out of bounds."""
        kind = "a whole number" if self.is_whole else "a number"
        is_valid = self.low <= amount <= self.high
        if not is_valid or (self.is_whole and amount != round(amount)):
            raise FidpipeError(
                f"flaw {self.name}: expected {kind} from {self.low:g} to {self.high:g} ({self.amount}), got {amount:g}"
            )
        if at_m is not None and (self.at_m is None or not 0 < at_m < np.inf):
            expected = f"a second number above 0 ({self.at})" if self.at else "no second number"
            raise FidpipeError(f"flaw {self.name}: expected {expected}, got {at_m:g}")


@dataclass(frozen=True)
class ChosenFlaw:
    """A flaw with its amount.

    name : name in `FLAWS`
    at_m : second parameter; None for the default, or if the flaw has none
    """

    name: str
    amount: float
    at_m: float | None = None

    def entries(self) -> dict[str, str | float]:
        """The fields that have a value."""
        return {name: value for name, value in vars(self).items() if value is not None}


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
    is_lost = np.zeros(len(points), dtype=np.bool_)
    if len(rows):
        is_lost[rows[grow_regions(points[rows], round(share * len(rows)), rng)]] = True
    return points[~is_lost]


def _lose_far(points: FloatArray, share: float, rng: Generator, beyond_m: float) -> FloatArray:
    """Remove a share of the points with a range above `beyond_m`, each independently."""
    is_far = np.linalg.norm(points, axis=1) > beyond_m
    return points[~(is_far & (rng.random(len(points)) < share))]


def _cut_holes(points: FloatArray, n_holes: float, rng: Generator, radius_m: float) -> FloatArray:
    """Remove the points within `radius_m` of `n_holes` random points."""
    centres = points[rng.integers(len(points), size=round(n_holes))]
    apart, _ = cKDTree(centres).query(points, distance_upper_bound=np.nextafter(radius_m, np.inf))
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


def _misalign_beams(points: FloatArray, std_deg: float, rng: Generator) -> FloatArray:
    """Points that beams of a wrong elevation table would have measured on the same surfaces.

    Beams are bands of 0.2 degrees of elevation, each with one error drawn from N(0, std_deg). A
    point slides along its local plane n . x = n . p into the direction u' of its beam: x = u' (n .
    p) / (n . u'). If that changes its range by more than a tenth (grazing rays, edges), or if the
    neighbours are on a line, the range does not change.
    """
    range_m = np.maximum(np.linalg.norm(points, axis=1), 1e-9)
    level_m = np.hypot(points[:, 0], points[:, 1])
    elevation = np.arctan2(points[:, 2], level_m)
    bands = np.floor((np.degrees(elevation) + 90.0) / _BEAM_DEG).astype(np.intp)
    errors = np.radians(rng.normal(0.0, std_deg, round(180.0 / _BEAM_DEG) + 1))
    elevation += errors[bands]
    heading = points[:, :2] / np.maximum(level_m, 1e-9)[:, None]
    directions = np.column_stack([np.cos(elevation)[:, None] * heading, np.sin(elevation)])
    planes = fit_planes(points, points, _NEIGHBOURS)
    with np.errstate(divide="ignore", invalid="ignore"):
        slid_m = (planes.normal * points).sum(axis=1) / (planes.normal * directions).sum(axis=1)
    is_plane = (planes.variance[:, 1] > _THIN * planes.variance[:, 2]) & (
        planes.scattering < SCATTERED
    )
    slides = is_plane & (np.abs(slid_m - range_m) <= _MAX_SLIDE * range_m)
    return directions * np.where(slides, slid_m, range_m)[:, None]


_INTENSITY_MAX = 65_535
_KINDS = (
    Flaw("foliage", "share of the foliage lost, in clumps of 2 m", 1, lose_foliage),
    Flaw(
        name="holes",
        amount="number of holes",
        high=10_000,
        alter=_cut_holes,
        at_m=1.5,
        at="radius of a hole, metres",
        is_whole=True,
    ),
    Flaw(
        name="far-dropout",
        amount="share lost beyond a range",
        high=1,
        alter=_lose_far,
        at_m=25.0,
        at="range, metres",
    ),
    Flaw("dropout", "share of the points lost", 1, drop_points),
    Flaw(
        name="density",
        amount="factor of the density in regions that hold 30 % of the points",
        high=8,
        alter=change_density,
    ),
    Flaw(
        name="beams",
        amount="std of each beam's elevation error, degrees",
        high=10,
        alter=_misalign_beams,
        is_systematic=True,
    ),
    Flaw("blur", "radius within which surfaces are smoothed, metres", 5, _blur),
    Flaw("noise", "std of the noise on each coordinate, metres", 10, add_noise),
    Flaw("ghosts", "points in ghost clusters of 20, per point", 8, add_clusters),
    Flaw(
        name="yaw",
        amount="turn about the vertical, degrees",
        low=-180,
        high=180,
        alter=move_rigidly,
        is_systematic=True,
    ),
    Flaw(
        name="offset",
        amount="shift in a random horizontal direction, metres",
        high=100,
        alter=lambda points, shift_m, rng: move_rigidly(points, 0.0, rng, shift_m),
        is_systematic=True,
    ),
    Flaw(
        name="mirrored",
        amount="1: y is negated; 0: it is not",
        high=1,
        alter=lambda points, is_mirrored, rng: points * [1.0, -1.0 if is_mirrored else 1.0, 1.0],
        is_systematic=True,
        is_whole=True,
    ),
    Flaw(
        name="intensity-constant",
        amount="intensity of all points",
        high=_INTENSITY_MAX,
        intensity=lambda points, intensity, amount: np.full(len(points), amount),
    ),
    Flaw(
        name="intensity-range",
        amount="a of exp(-a d), 1/m, as in CARLA",
        high=10,
        intensity=lambda points, intensity, per_m: np.exp(-per_m * np.linalg.norm(points, axis=1)),
    ),
    Flaw(
        name="intensity-scale",
        amount="factor of the intensity",
        high=_INTENSITY_MAX,
        intensity=lambda points, intensity, factor: factor * intensity,
    ),
)
#: Flaws by name, in the order in which they are applied to a scan: losses, distortions, additions, then rigid motions.
FLAWS: dict[str, Flaw] = {flaw.name: flaw for flaw in _KINDS}


def parse_flaws(words: Sequence[str]) -> tuple[ChosenFlaw, ...]:
    """Parse flaws such as `dropout=0.3`, `holes=12:1.5` and `mirrored`; the result is in the order of `FLAWS`.

    Raises
    ------
    FidpipeError
        Text of another form, an unknown flaw, a flaw given twice, or an amount out of bounds.

    Examples
    --------
    >>> [flaw.name for flaw in parse_flaws(["mirrored", "holes=12:1.5"])]
    ['holes', 'mirrored']
    """
    chosen: dict[str, ChosenFlaw] = {}
    for word in words:
        name, _, text = word.partition("=")
        if name not in FLAWS:
            raise FidpipeError(f"flaw {name!r}: unknown; {suggestion(name, FLAWS)}")
        if name in chosen:
            raise FidpipeError(f"flaw {name}: given twice; give it once")
        if word == "mirrored":
            text = "1"
        amount, colon, at_m = text.partition(":")
        try:
            flaw = ChosenFlaw(name, float(amount), float(at_m) if colon else None)
        except ValueError:
            meaning = " : ".join(filter(None, [FLAWS[name].amount, FLAWS[name].at]))
            raise FidpipeError(
                f"flaw {word!r}: expected {name}=AMOUNT with a number ({meaning})",
            ) from None
        FLAWS[name].check(flaw.amount, flaw.at_m)
        chosen[name] = flaw
    return tuple(chosen[name] for name in FLAWS if name in chosen)
