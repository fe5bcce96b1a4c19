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
from ....schemas.metrics import metric_of
from ....stages.arrays import IndexArray
from ..aggregates import plain_rows
from ..clouds import PairTables, Spectra
from ..results import RunResults

#: About so many points of a side are drawn at most, and of each object at least `_FEWEST`, if it has them.
POINTS_PER_SIDE = 9000
_FEWEST = 80
_CURVE_POINTS = 200
_STEPS = 32767

#: Headings of the columns that are no scores; other words stand for themselves.
_HEADINGS = {
    "pair_id": "pair", "range_m": "range (m)", "bearing_deg": "bearing (°, left positive)", "n_points": "points",
    "n_real": "points, real", "n_sim": "points, simulated", "n_keep": "nodes kept",
    **{name: name for name in ("object", "quadrant", "status", "reason")},
}  # fmt: skip
#: What is told of a chosen object.
FACTS = (
    "quadrant", "status", "reason", "group", "range_m", "bearing_deg", "n_points", "n_real", "n_sim", "n_keep", "cdc",
    "r_lambda", "r_gap", "max_eigenvalue_shift", "laplacian_change", "eigenspectrum_distance", "gap_real", "gap_sim",
    "alignment_rms_m", "centroid_distance_m",
)  # fmt: skip
#: Columns of the objects, in the order of their rows in the page.
MATCHED_COLUMNS = ("real_id", "sim_id", *(name for name in FACTS if name != "n_points"))
UNMATCHED_COLUMNS = ("side", "community_id", "group", "status", "range_m", "bearing_deg", "n_points")


def headings(results: RunResults, columns: Iterable[str]) -> dict[str, str]:
    """By column of a table of pairs or objects, its heading: of scores that of the catalogue, class or shape by run."""
    known = {**_HEADINGS, "group": results.class_is}
    return {column: known.get(column) or metric_of(column).label for column in columns}


def pair_view(results: RunResults, pair_id: str) -> dict[str, Any]:
    """One pair for the page: points of both sides, objects, spectra; `RunError` if one of its tables is damaged."""
    tables = PairTables(results, pair_id)
    step_m = max(float(np.abs(cloud.points).max()) for cloud in tables.clouds.values()) / _STEPS
    return {
        "step_m": step_m,
        "sides": {side: _encoded(tables, side, step_m) for side in SIDES},
        "matched": plain_rows(tables.matched, MATCHED_COLUMNS),
        "unmatched": plain_rows(tables.unmatched, UNMATCHED_COLUMNS),
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


def _encoded(tables: PairTables, side: str, step_m: float) -> dict[str, Any]:
    cloud = tables.clouds[side]
    shown = thinned(cloud.community, POINTS_PER_SIDE)
    is_kept = np.isin(cloud.point_ids[shown], tables.selection[f"{side}_point_id"])
    return {
        "n": len(cloud.points),
        "n_shown": len(shown),
        "xyz": _base64(np.rint(cloud.points[shown].T / step_m), "<i2"),
        "community": _base64(cloud.community[shown], "<i4"),
        "kept": _base64(is_kept, "u1"),
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
        "index": _base64(index, "<i4"),
        "real": _base64(spectra.real[index], "<f4"),
        "sim": _base64(spectra.sim[index], "<f4"),
    }


def _base64(values: Any, dtype: str) -> str:
    """Numbers as base64 of a little-endian type."""
    return base64.b64encode(np.ascontiguousarray(values).astype(dtype).tobytes()).decode("ascii")
