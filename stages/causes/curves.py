"""Evidence of causes as curves of both sides: for an engineer to look at before acting on a number."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ...schemas.columns import SIDES
from ..arrays import FloatArray
from ..surface import describe_surface, signed_distances
from .axes import AXES
from .estimates import Pose, find_unmatched, foliage_steps
from .sides import PairScans

_POINTS = 4000  # of the simulated side, evenly
_REACH_M = 0.5


def curves(scans: PairScans, pose: Pose, kind: str) -> Mapping[str, FloatArray]:
    """The curve of each side over the bins of an axis, per cent.

    Of parts: the points that only one side has. Of foliage: the steps of the simulated side. Of a displacement: the
    simulated points as they are ("sim") and without it ("corrected"), signed distances to the real planes next to
    them. Of all others: both sides ("real", "sim").
    """
    real, sim, edges = scans.real, scans.sim, AXES[kind]["edges"]
    corrected = pose.undisplaced(sim)
    if kind in ("road", "objects"):
        rows = np.flatnonzero(sim.is_ground == (kind == "road"))
        rows = rows[np.unique(np.linspace(0, len(rows) - 1, min(len(rows), _POINTS)).round().astype(int))]
        sets = {"sim": sim.points[rows], "corrected": corrected.points[rows]}
        values = {name: signed_distances(points, real.points, _REACH_M) for name, points in sets.items()}
        return {name: _percent(own, edges, np.isfinite(own).sum()) for name, own in values.items()}
    if kind == "foliage":
        _, step_m = foliage_steps(real, corrected)
        return {"sim": _percent(step_m, edges, len(step_m))}
    if kind == "pieces":
        return {
            name: _percent(side.range_m[own.is_part | own.is_moved | own.is_clutter], edges, len(side.points))
            for name, side, own in zip(SIDES, (real, corrected), find_unmatched(real, corrected), strict=True)
        }
    sides = {"real": real, "sim": sim}
    if kind == "roughness":
        surfaces = {name: describe_surface(side.points) for name, side in sides.items()}
        values = {name: own.roughness_m[own.is_plane] for name, own in surfaces.items()}
        return {name: _percent(own, edges, len(own)) for name, own in values.items()}
    values = {name: own.range_m if kind == "range" else getattr(own, f"{kind}_deg") for name, own in sides.items()}
    return {name: _percent(own, edges, len(real.points)) for name, own in values.items()}


def _percent(values: FloatArray, edges: FloatArray, n_all: int) -> FloatArray:
    return 100.0 * np.histogram(values, edges)[0] / max(1, n_all)
