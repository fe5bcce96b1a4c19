"""What the page holds of one pair: points thinned for display, its objects with all their numbers, spectra as curves.

Points are whole numbers of a small step, spectra 32-bit floats, both in base64: the page stays small and needs no other
file.
"""

from __future__ import annotations

import base64
from collections.abc import Iterable
from typing import Any

import numpy as np

from ....schemas.columns import SIDES
from ....stages.arrays import IndexArray, IntArray
from ..aggregates import plain_rows
from ..clouds import Cloud, PairTables, Spectra
from ..results import RunResults

#: About so many points of a side are drawn at most, and of each object at least `_FEWEST`, if it has them.
POINTS_PER_SIDE = 9000
_FEWEST = 80
_CURVE_POINTS = 200
_STEPS = 32767

#: Columns of the objects, in the order of their rows in the page.
MATCHED_COLUMNS = (
    "real_id", "sim_id", "group", "quadrant", "status", "range_m", "bearing_deg", "n_real", "n_sim", "n_keep", "cdc",
    "r_lambda", "r_gap", "max_eigenvalue_shift", "laplacian_change", "eigenspectrum_distance", "gap_real", "gap_sim",
    "alignment_rms_m", "centroid_distance_m", "reason",
)  # fmt: skip
UNMATCHED_COLUMNS = ("side", "community_id", "group", "status", "range_m", "bearing_deg", "n_points")
#: What is told of a chosen object, and what it is called; the class has its name from the run.
FACTS = {
    "quadrant": "quadrant", "status": "status", "reason": "reason", "group": "", "range_m": "range (m)",
    "bearing_deg": "bearing (°, left positive)", "n_points": "points", "n_real": "points, real",
    "n_sim": "points, simulated", "n_keep": "nodes kept", "cdc": "CDC", "r_lambda": "r_lambda", "r_gap": "r_gap",
    "max_eigenvalue_shift": "largest eigenvalue shift", "laplacian_change": "Laplacian change",
    "eigenspectrum_distance": "eigenspectrum distance", "gap_real": "spectral gap, real",
    "gap_sim": "spectral gap, simulated", "alignment_rms_m": "alignment r.m.s. (m)",
    "centroid_distance_m": "centroid distance (m)",
}  # fmt: skip


def pair_view(results: RunResults, pair_id: str) -> dict[str, Any]:
    """One pair for the page: points of both sides, objects, spectra; `RunError` if one of its tables is damaged."""
    tables = PairTables(results, pair_id)
    clouds = {side: tables.cloud(side) for side in SIDES}
    step_m = max(float(np.abs(cloud.points).max()) for cloud in clouds.values()) / _STEPS
    matched = results.matched[results.matched.pair_id == pair_id]
    unmatched = results.unmatched[results.unmatched.pair_id == pair_id]
    return {
        "step_m": step_m,
        "sides": {side: _encoded(cloud, step_m, tables.kept(side)) for side, cloud in clouds.items()},
        "matched": plain_rows(matched, MATCHED_COLUMNS),
        "unmatched": plain_rows(unmatched, UNMATCHED_COLUMNS),
        "spectra": {str(real_id): _curve(spectra) for real_id, spectra in tables.spectra()},
    }


def thinned(community: Iterable[int], most: int) -> IndexArray:
    """Indices of about `most` points, of each object the same share but at least `_FEWEST`; for display only.

    Examples
    --------
    >>> import numpy as np
    >>> kept = thinned(np.repeat([0, 1], [10_000, 50]), most=1000)
    >>> np.bincount(np.repeat([0, 1], [10_000, 50])[kept]).tolist()
    [996, 50]
    """
    ids = np.asarray(community)
    share = min(1.0, most / max(1, len(ids)))
    rng = np.random.default_rng(0)
    chosen = []
    for members in np.split(np.argsort(ids, kind="stable"), np.cumsum(np.bincount(ids))[:-1]):
        n = min(len(members), max(_FEWEST, int(np.ceil(share * len(members)))))
        chosen.append(rng.choice(members, n, replace=False))
    kept: IndexArray = np.sort(np.concatenate(chosen))
    return kept


def base64_of(values: Any, dtype: str) -> str:
    """Numbers as base64 of a little-endian type."""
    return base64.b64encode(np.ascontiguousarray(values).astype(dtype).tobytes()).decode("ascii")


def _encoded(cloud: Cloud, step_m: float, kept_ids: IntArray) -> dict[str, Any]:
    shown = thinned(cloud.community, POINTS_PER_SIDE)
    is_kept = np.isin(cloud.point_ids[shown], kept_ids)
    return {
        "n": len(cloud.points),
        "n_shown": len(shown),
        "xyz": base64_of(np.rint(cloud.points[shown].T / step_m), "<i2"),
        "community": base64_of(cloud.community[shown], "<i4"),
        "kept": base64_of(is_kept, "u1"),
    }


def _curve(spectra: Spectra) -> dict[str, Any]:
    if spectra.real is None or spectra.sim is None:
        return {"reason": spectra.reason}
    worst = int(np.argmax(np.abs(spectra.sim - spectra.real)))
    n = len(spectra.real)
    index = np.unique(np.append(np.linspace(0, n - 1, min(n, _CURVE_POINTS)).round(), worst)).astype(np.intp)
    return {
        "n": n,
        "worst": int(np.searchsorted(index, worst)),
        "index": base64_of(index, "<i4"),
        "real": base64_of(spectra.real[index], "<f4"),
        "sim": base64_of(spectra.sim[index], "<f4"),
    }
