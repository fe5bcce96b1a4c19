"""Known flaws of a simulated scan: what a simulator may get wrong, each in an amount, to see which score answers.

Each acts on the points of a scan alone, so that it means the same on every scan; a beam that passes through a hole
meets nothing behind it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.random import Generator
from scipy.spatial import cKDTree

from ...schemas.errors import FidpipeError, suggestion
from ..arrays import BoolArray, FloatArray
from ..inspect.surfels import fit_planes, voxel_means
from .perturbations import add_clusters, add_noise, change_density, drop_points, grow_regions, move_rigidly

SCATTERED = 0.1  # l3 / l1 of foliage, and more
_NEIGHBOURS = 40
_BLUR_VOXELS = 4  # per radius
_BLUR_NEIGHBOURS = 96
_BEAM_DEG = 0.2
_MOST_SLIDE = 0.1
_THIN = 1e-3


@dataclass(frozen=True)
class Flaw:
    """One kind of flaw; called with points, an amount and a source of random numbers it gives the altered points.

    name : as the command has it
    amount : what the amount is, in words
    low, high : least and largest amount
    alter : gives the altered points; takes points, amount, source of random numbers and, where there is one, `at_m`
    is_systematic : whether a simulator has it alike in all its scans, so that one seed serves them all
    at_m : the usual second number, metres; None where there is none
    at : what that is, in words
    is_whole : whether the amount is a whole number
    """

    name: str
    amount: str
    low: float
    high: float
    alter: Callable[..., FloatArray]
    is_systematic: bool = False
    at_m: float | None = None
    at: str = ""
    is_whole: bool = False

    def __call__(self, points: FloatArray, amount: float, rng: Generator, at_m: float | None = None) -> FloatArray:
        """The altered points, (m, 3); those that stay keep their order, new ones follow them. No points stay none.

        Parameters
        ----------
        points : (n, 3) float64, metres, sensor at the origin, z up; not changed
        amount : how much; 0 changes nothing, but for `density` 1 does
        rng : decides all that is random
        at_m : the second number; by default the usual one

        Raises
        ------
        FidpipeError
            The amount is out of bounds, or a second number is given where there is none.
        """
        self.check(amount, at_m)
        if not len(points):
            return points.copy()
        second = () if self.at_m is None else (self.at_m if at_m is None else at_m,)
        return self.alter(points, amount, rng, *second)

    def check(self, amount: float, at_m: float | None = None) -> None:
        """Raises `FidpipeError` where an amount or a second number is out of bounds."""
        if not self.low <= amount <= self.high:
            raise FidpipeError(
                f"flaw {self.name}: amount {amount:g}; {self.low:g} to {self.high:g} is wanted ({self.amount})"
            )
        if self.is_whole and amount != round(amount):
            raise FidpipeError(f"flaw {self.name}: amount {amount:g}; a whole number is wanted ({self.amount})")
        if at_m is not None and self.at_m is None:
            raise FidpipeError(f"flaw {self.name}: a second number, {at_m:g}, is given; it has none")
        if at_m is not None and not 0 < at_m < np.inf:
            raise FidpipeError(f"flaw {self.name}: second number {at_m:g}; more than 0 is wanted ({self.at})")


@dataclass(frozen=True)
class ChosenFlaw:
    """A flaw in an amount.

    name : in `FLAWS`
    at_m : its second number; None for the usual one, or where there is none
    """

    name: str
    amount: float
    at_m: float | None = None


def is_foliage(points: FloatArray) -> BoolArray:
    """Whether a point lies in something scattered, (n,) bool: l3 / l1 of its 40 nearest points is 0.1 or more.

    Parameters
    ----------
    points : (n, 3) float64, metres
    """
    scattered: BoolArray = fit_planes(points, points, _NEIGHBOURS).scattering >= SCATTERED
    return scattered


def lose_foliage(points: FloatArray, share: float, rng: Generator, where: BoolArray | None = None) -> FloatArray:
    """The points without a share of the foliage, which is lost in clumps of 2 m and not leaf by leaf.

    Parameters
    ----------
    points : (n, 3) float64, metres
    share : of the foliage points, lost; rounded to whole points
    where : (n,) bool, which points are foliage, as labels have it; by default `is_foliage`
    """
    rows = np.flatnonzero(is_foliage(points) if where is None else where)
    is_lost = np.zeros(len(points), dtype=np.bool_)
    if len(rows):
        is_lost[rows[grow_regions(points[rows], round(share * len(rows)), rng)]] = True
    return points[~is_lost]


def _lose_far(points: FloatArray, share: float, rng: Generator, beyond_m: float) -> FloatArray:
    """The points without a share of those whose range is more than `beyond_m`, each lost independently."""
    is_far = np.sqrt((points**2).sum(axis=1)) > beyond_m
    left: FloatArray = points[~(is_far & (rng.random(len(points)) < share))]
    return left


def _cut_holes(points: FloatArray, n_holes: float, rng: Generator, radius_m: float) -> FloatArray:
    """The points without those within `radius_m` of one of so many random points."""
    centres = points[rng.integers(len(points), size=round(n_holes))]
    if not len(centres):
        return points.copy()
    apart, _ = cKDTree(centres).query(points, distance_upper_bound=np.nextafter(radius_m, np.inf))
    left: FloatArray = points[np.isinf(apart)]
    return left


def _blur(points: FloatArray, radius_m: float, rng: Generator) -> FloatArray:
    """The points moved onto the plane of what lies within `radius_m`, along its normal.

    One step of a moving least squares projection (Alexa et al., IEEE Visualization 2001) onto the scan's voxel means,
    four voxels per radius, so that the density of rings has no part in it: planes stay, roughness goes, corners are
    cut, and what is thinner than the radius becomes a sheet.
    """
    if radius_m == 0:
        return points.copy()
    planes = fit_planes(voxel_means(points, radius_m / _BLUR_VOXELS), points, _BLUR_NEIGHBOURS, radius_m)
    off_m = ((planes.mean - points) * planes.normal).sum(axis=1)
    return points + np.where(planes.n_neighbours >= 3, off_m, 0.0)[:, None] * planes.normal


def _misalign_beams(points: FloatArray, std_deg: float, rng: Generator) -> FloatArray:
    """The points as beams of a wrong elevation table would have met the same surfaces.

    Beams are bands of 0.2 degrees of elevation; each is off by one error drawn from N(0, std_deg). A point slides
    along its local plane n . x = n . p into the direction u' of its beam: x = u' (n . p) / (n . u'). Where that
    changes its range by more than a tenth (grazing rays, edges), or where a line of points tells no plane, the range
    stays.
    """
    range_m = np.maximum(np.sqrt((points**2).sum(axis=1)), 1e-9)
    level_m = np.hypot(points[:, 0], points[:, 1])
    elevation = np.arctan2(points[:, 2], level_m)
    bands = np.floor((np.degrees(elevation) + 90.0) / _BEAM_DEG).astype(np.intp)
    errors = np.radians(rng.normal(0.0, std_deg, round(180.0 / _BEAM_DEG) + 1))
    turned = elevation + errors[bands]
    heading = points[:, :2] / np.maximum(level_m, 1e-9)[:, None]
    directions = np.column_stack([np.cos(turned)[:, None] * heading, np.sin(turned)])
    planes = fit_planes(points, points, _NEIGHBOURS)
    with np.errstate(divide="ignore", invalid="ignore"):
        slid_m = (planes.normal * points).sum(axis=1) / (planes.normal * directions).sum(axis=1)
    is_plane = (planes.variance[:, 1] > _THIN * planes.variance[:, 2]) & (planes.scattering < SCATTERED)
    slides = is_plane & (np.abs(slid_m - range_m) <= _MOST_SLIDE * range_m)
    altered: FloatArray = directions * np.where(slides, slid_m, range_m)[:, None]
    return altered


def _shift(points: FloatArray, shift_m: float, rng: Generator) -> FloatArray:
    return move_rigidly(points, 0.0, shift_m, rng)


def _turn(points: FloatArray, angle_deg: float, rng: Generator) -> FloatArray:
    return move_rigidly(points, angle_deg, 0.0, rng)


def _mirror(points: FloatArray, is_mirrored: float, rng: Generator) -> FloatArray:
    altered: FloatArray = points * np.array([1.0, -1.0 if is_mirrored else 1.0, 1.0])
    return altered


_KINDS = (
    Flaw("foliage", "share of the foliage lost, in clumps of 2 m", 0, 1, lose_foliage),
    Flaw("holes", "number of holes", 0, 10_000, _cut_holes, at_m=1.5, at="radius of a hole, metres", is_whole=True),
    Flaw("far-dropout", "share lost beyond a range", 0, 1, _lose_far, at_m=25.0, at="that range, metres"),
    Flaw("dropout", "share of the points lost", 0, 1, drop_points),
    Flaw("density", "factor of the density in regions that hold 30 % of the points", 0, 8, change_density),
    Flaw("beams", "std of each beam's elevation error, degrees", 0, 10, _misalign_beams, is_systematic=True),
    Flaw("blur", "radius within which surfaces are smoothed, metres", 0, 5, _blur),
    Flaw("noise", "std of the noise on each coordinate, metres", 0, 10, add_noise),
    Flaw("ghosts", "points in ghost clusters of 20, per point", 0, 8, add_clusters),
    Flaw("yaw", "turn about the vertical, degrees", -180, 180, _turn, is_systematic=True),
    Flaw("offset", "shift in a random horizontal direction, metres", 0, 100, _shift, is_systematic=True),
    Flaw("mirrored", "1: y is negated; 0: it is not", 0, 1, _mirror, is_systematic=True, is_whole=True),
)
#: Flaws by name, in the order in which several of them are applied to a scan: what is lost, what is distorted, what is
#: invented, then what moves the whole.
FLAWS: dict[str, Flaw] = {flaw.name: flaw for flaw in _KINDS}


def parse_flaws(words: Sequence[str]) -> tuple[ChosenFlaw, ...]:
    """The flaws of words such as `dropout=0.3`, `holes=12:1.5` and `mirrored`, in the order of `FLAWS`.

    Raises
    ------
    FidpipeError
        A word is not of that form, a flaw is unknown or named twice, or an amount is out of bounds.

    Examples
    --------
    >>> parse_flaws(["mirrored", "holes=12:1.5"])
    (ChosenFlaw(name='holes', amount=12.0, at_m=1.5), ChosenFlaw(name='mirrored', amount=1.0, at_m=None))
    """
    chosen: dict[str, ChosenFlaw] = {}
    for word in words:
        name, _, text = word.partition("=")
        if name not in FLAWS:
            raise FidpipeError(f"flaw {name!r}: no such flaw; {suggestion(name, FLAWS)}")
        if name in chosen:
            raise FidpipeError(f"flaw {name}: named twice; once is wanted")
        amount, colon, at_m = text.partition(":")
        if not text and FLAWS[name].is_whole and FLAWS[name].high == 1:
            amount = "1"
        try:
            flaw = ChosenFlaw(name, float(amount), float(at_m) if colon else None)
        except ValueError:
            second = f", and {FLAWS[name].at} after a colon" if FLAWS[name].at_m is not None else ""
            raise FidpipeError(
                f"flaw {word!r}: {name}=AMOUNT is wanted, a number ({FLAWS[name].amount}{second})"
            ) from None
        FLAWS[name].check(flaw.amount, flaw.at_m)
        chosen[name] = flaw
    return tuple(chosen[name] for name in FLAWS if name in chosen)
