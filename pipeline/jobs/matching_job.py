"""Stage matching: which objects both sides have, and which only one."""

from __future__ import annotations

import numpy as np
import pyarrow as pa

from ...schemas.columns import Row
from ...stages.arrays import FloatArray, IntArray
from ...stages.method import match_objects
from ..stage import OBJECTS, Grain, Inputs, JobResult, Stage
from .points_job import column


def make_matching(inputs: Inputs) -> JobResult:
    """Match the objects of both sides, one row for each.

    The metadata list the matched ones with the number of nodes that both sides will keep.
    """
    real, n_real = _centroids(inputs.table("objects", "real"))
    sim, n_sim = _centroids(inputs.table("objects", "sim"))
    with inputs.step("match"):
        matching = match_objects(real, sim, n_real, n_sim, inputs.settings)
    real_ids = matching.real_ids.tolist()
    sim_ids = matching.sim_ids.tolist()
    n_keep = np.minimum(n_real[matching.real_ids], n_sim[matching.sim_ids])
    rows: list[Row] = []
    for real_id, sim_id, distance_m in zip(
        real_ids, sim_ids, matching.distance_m.tolist(), strict=True
    ):
        both = {"real_id": real_id, "sim_id": sim_id}
        rows.append(both | {"centroid_distance_m": distance_m, "status": "matched"})
    rows += [{"real_id": i, "status": "not_found"} for i in matching.not_found.tolist()]
    rows += [{"sim_id": i, "status": "extra"} for i in matching.extra.tolist()]
    matched = list(zip(real_ids, n_keep.tolist(), strict=True))
    return JobResult({"matching": inputs.rows("matching", rows)}, {OBJECTS: matched})


def _centroids(objects: pa.Table) -> tuple[FloatArray, IntArray]:
    """Centroids of objects, (n, 3) float64 metres, and their numbers of points."""
    centroids = np.column_stack([column(objects, axis) for axis in ("cx", "cy", "cz")])
    return centroids, column(objects, "n_points")


STAGE = Stage(
    name="matching",
    takes={"objects": ("cx", "cy", "cz", "n_points")},
    gives=("matching",),
    settings=("communities", "matching"),
    grain=Grain.PAIR,
    version=2,
    make=make_matching,
)
