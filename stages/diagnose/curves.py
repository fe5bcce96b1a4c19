"""Evidence of causes as curves of both sides: for an engineer to look at before acting on a number."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from ...schemas.data_files import read_data
from ..arrays import FloatArray
from ..surface import describe_surface, signed_distances
from .evidence import PairEstimates, PairScans, find_unmatched, foliage_steps

_POINTS = 4000  # of the simulated side, evenly
_REACH_M = 0.5


@dataclass(frozen=True)
class Axis:
    """Axis of a curve: its label, that of the values, and the edges of its bins."""

    label: str
    values: str
    edges: FloatArray


#: Axes by kind of curve.
AXES = {
    kind: Axis(own["label"], own["values"], np.linspace(*own["edges"])) for kind, own in read_data("curves").items()
}


def curves(scans: PairScans, found: PairEstimates, kind: str) -> Mapping[str, FloatArray]:
    """The curve of each side over the bins of an axis, per cent.

    Of pieces: the points that only one side has. Of foliage: the steps of the simulated side. Of a displacement: the
    simulated points as they are ("sim") and without it ("corrected"), signed distances to the real planes next to
    them. Of all others: both sides ("real", "sim").
    """
    edges = AXES[kind].edges
    if kind in ("road", "objects"):
        rows = np.flatnonzero(scans.sim_is_ground == (kind == "road"))
        rows = rows[np.unique(np.linspace(0, len(rows) - 1, min(len(rows), _POINTS)).round().astype(int))]
        corrected = found.displacement.undo(scans.sim[rows], scans.sim_is_ground[rows])
        sets = {"sim": scans.sim[rows], "corrected": corrected}
        values = {name: signed_distances(points, scans.real, _REACH_M) for name, points in sets.items()}
        return {name: _percent(own, edges, np.isfinite(own).sum()) for name, own in values.items()}
    if kind == "roughness":
        surfaces = {"real": describe_surface(scans.real), "sim": describe_surface(scans.sim)}
        values = {side: own.roughness_m[own.is_plane] for side, own in surfaces.items()}
        return {side: _percent(own, edges, len(own)) for side, own in values.items()}
    if kind in ("pieces", "foliage"):
        real, sim = scans.sides(found.displacement)
        if kind == "foliage":
            _, step_m = foliage_steps(real, sim)
            return {"sim": _percent(step_m, edges, len(step_m))}
        alone = find_unmatched(real, sim, found.step_deg)
        return {
            name: _percent(side.range_m[own.is_piece | own.is_moved | own.is_clutter], edges, len(side.points))
            for name, side, own in zip(("real", "sim"), (real, sim), alone, strict=True)
        }
    return {side: _percent(_along(kind, own), edges, len(scans.real)) for side, own in scans.by_side.items()}


def _along(kind: str, points: FloatArray) -> FloatArray:
    range_m: FloatArray = np.linalg.norm(points, axis=1)
    if kind == "range":
        return range_m
    if kind == "azimuth":
        return np.degrees(np.arctan2(points[:, 1], points[:, 0]))
    return np.degrees(np.arcsin(points[:, 2] / np.maximum(range_m, 1e-9)))


def _percent(values: FloatArray, edges: FloatArray, n_all: int) -> FloatArray:
    return 100.0 * np.histogram(values, edges)[0] / max(1, n_all)
