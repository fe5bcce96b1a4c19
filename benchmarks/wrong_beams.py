"""A flaw of simulators that benchmarks add to scans: beams that look into other directions than they should."""

import numpy as np

from fidpipe.stages.generate.flaws import SCATTERED, Flaw
from fidpipe.stages.surfels import fit_planes

BEAM_DEG = 0.2
NEIGHBOURS = 40
MAX_SLIDE = 0.1
THIN = 1e-3


def misalign_beams(points, std_deg, rng):
    """Points that beams of a wrong elevation table would have measured on the same surfaces.

    Beams are bands of 0.2 degrees of elevation, each with one error drawn from N(0, std_deg). A
    point slides along its local plane n . x = n . p into the direction u' of its beam: x = u' (n .
    p) / (n . u'). If that changes its range by more than a tenth (grazing rays, edges), or if the
    neighbours are on a line, the range does not change.
    """
    range_m = np.maximum(np.linalg.norm(points, axis=1), 1e-9)
    level_m = np.hypot(points[:, 0], points[:, 1])
    elevation = np.arctan2(points[:, 2], level_m)
    bands = np.floor((np.degrees(elevation) + 90.0) / BEAM_DEG).astype(np.intp)
    errors = np.radians(rng.normal(0.0, std_deg, round(180.0 / BEAM_DEG) + 1))
    elevation += errors[bands]
    heading = points[:, :2] / np.maximum(level_m, 1e-9)[:, None]
    directions = np.column_stack([np.cos(elevation)[:, None] * heading, np.sin(elevation)])
    planes = fit_planes(points, points, NEIGHBOURS)
    with np.errstate(divide="ignore", invalid="ignore"):
        slid_m = (planes.normal * points).sum(axis=1) / (planes.normal * directions).sum(axis=1)
    is_plane = (planes.variance[:, 1] > THIN * planes.variance[:, 2]) & (
        planes.scattering < SCATTERED
    )
    slides = is_plane & (np.abs(slid_m - range_m) <= MAX_SLIDE * range_m)
    return directions * np.where(slides, slid_m, range_m)[:, None]


BEAMS = Flaw(
    "std of each beam's elevation error, degrees", 10, misalign_beams, is_systematic=True
)
