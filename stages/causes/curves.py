"""Evidence of causes as curves of both sides: for an engineer to look at before acting on a number."""

from __future__ import annotations

import numpy as np

from ..arrays import FloatArray
from ..surface import describe_surface, signed_distances
from .axes import AXES
from .shapes import foliage_steps
from .sides import PairScans, Side
from .unmatched import Unmatched, find_unmatched

_POINTS = 4000  # of the simulated side, evenly
_REACH_M = 0.5


def curves(scans: PairScans, aligned: Side, kind: str) -> dict[str, FloatArray]:
    """The curve of each side over the bins of an axis, per cent.

    Of parts: the points that only one side has. Of foliage: the steps of the simulated side. Of a displacement: the
    simulated points as they are ("sim") and without it ("corrected"), signed distances to the real planes next to
    them. Of all others: both sides ("real", "sim").

    Parameters
    ----------
    aligned : the simulated side without its displacement
    """
    real, sim = scans.real, scans.sim
    edges = AXES[kind]["edges"]
    if kind in ("road", "objects"):
        rows = np.flatnonzero(sim.is_ground == (kind == "road"))
        sample = np.linspace(0, len(rows) - 1, min(len(rows), _POINTS)).round().astype(int)
        rows = rows[np.unique(sample)]
        return {
            "sim": _distance_curve(sim.points[rows], real, edges),
            "corrected": _distance_curve(aligned.points[rows], real, edges),
        }
    if kind == "foliage":
        _, step_m = foliage_steps(real, aligned)
        return {"sim": _percent(step_m, edges, len(step_m))}
    if kind == "pieces":
        missing, invented = find_unmatched(real, aligned)
        return {
            "real": _piece_curve(real, missing, edges),
            "sim": _piece_curve(aligned, invented, edges),
        }
    if kind == "roughness":
        return {"real": _roughness_curve(real, edges), "sim": _roughness_curve(sim, edges)}
    name = "range_m" if kind == "range" else f"{kind}_deg"
    n_real = len(real.points)
    return {
        "real": _percent(getattr(real, name), edges, n_real),
        "sim": _percent(getattr(sim, name), edges, n_real),
    }


def _distance_curve(points: FloatArray, real: Side, edges: FloatArray) -> FloatArray:
    distance_m = signed_distances(points, real.points, _REACH_M)
    return _percent(distance_m, edges, np.isfinite(distance_m).sum())


def _piece_curve(side: Side, unmatched: Unmatched, edges: FloatArray) -> FloatArray:
    is_alone = unmatched.is_part | unmatched.is_moved | unmatched.is_clutter
    return _percent(side.range_m[is_alone], edges, len(side.points))


def _roughness_curve(side: Side, edges: FloatArray) -> FloatArray:
    surface = describe_surface(side.points)
    roughness_m = surface.roughness_m[surface.is_plane]
    return _percent(roughness_m, edges, len(roughness_m))


def _percent(values: FloatArray, edges: FloatArray, n_all: int) -> FloatArray:
    return 100.0 * np.histogram(values, edges)[0] / max(1, n_all)
