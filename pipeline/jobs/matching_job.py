"""Stage matching: which objects both sides have, and which only one."""

from __future__ import annotations

import numpy as np

from ...schemas.columns import SIDES
from ...stages.matching import match_communities, match_reference
from ..stage import OBJECTS, Inputs, JobResult, Stage
from .points_job import column, coordinates


def make_matching(inputs: Inputs) -> JobResult:
    """Match the objects of both sides, one row for each.

    The metadata list the matched ones with the number of nodes that both sides will keep.
    """
    objects = [inputs.table("objects", side) for side in SIDES]
    real, sim = [coordinates(table, "c{}") for table in objects]
    n_real, n_sim = [column(table, "n_points") for table in objects]
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


STAGE = Stage(
    name="matching",
    takes=("objects",),
    gives=("matching",),
    settings=("communities", "matching"),
    version=2,
    make=make_matching,
)
