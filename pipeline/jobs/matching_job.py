"""Stage matching: which objects both sides have, and which only one."""

from __future__ import annotations

import numpy as np
import pyarrow as pa

from ...stages.arrays import FloatArray, IntArray
from ...stages.matching import match_communities, match_reference
from ..stage import OBJECTS, Grain, Inputs, JobResult, Stage
from .points_job import column


def make_matching(inputs: Inputs) -> JobResult:
    """Match the objects of both sides, one row for each.

    The metadata list the matched ones with the number of nodes that both sides will keep.
    """
    real, n_real = _centroids(inputs.table("objects", "real"))
    sim, n_sim = _centroids(inputs.table("objects", "sim"))
    settings = inputs.settings
    with inputs.step("match"):
        if settings.communities.objects == "reference":  # by ids
            least = settings.communities.min_points
            matching = match_reference(real, sim, n_real, n_sim, least)
        else:
            matching = match_communities(real, sim, settings.matching)
    parts = (
        {
            "status": "matched",
            "real_id": matching.real_ids,
            "sim_id": matching.sim_ids,
            "centroid_distance_m": matching.distance_m,
        },
        {"status": "not_found", "real_id": matching.not_found},
        {"status": "extra", "sim_id": matching.extra},
    )
    table = inputs.columns("matching", *parts)["matching"]
    table = table.sort_by([("real_id", "ascending"), ("sim_id", "ascending")])
    n_keep = np.minimum(n_real[matching.real_ids], n_sim[matching.sim_ids])
    matched = list(zip(matching.real_ids.tolist(), n_keep.tolist(), strict=True))
    return JobResult({"matching": table}, {OBJECTS: matched})


def _centroids(objects: pa.Table) -> tuple[FloatArray, IntArray]:
    """Centroids of objects, (n, 3) float64 metres, and their numbers of points."""
    centroids = np.column_stack([column(objects, axis) for axis in ("cx", "cy", "cz")])
    return centroids, column(objects, "n_points")


STAGE = Stage(
    name="matching",
    takes=("objects",),
    gives=("matching",),
    settings=("communities", "matching"),
    grain=Grain.PAIR,
    version=2,
    make=make_matching,
)
