"""Stage matching: which objects both sides have, and which only one."""

from __future__ import annotations

import numpy as np

from ...schemas.columns import SIDES, Row
from ...schemas.tables import TABLES
from ...stages.method import match_objects
from ..stage import OBJECTS, Grain, Inputs, JobResult, Stage
from .points_job import column


def make_matching(own: Inputs) -> JobResult:
    """Match the objects of both sides, one row for each.

    The metadata list the matched ones with the number of nodes that both sides will keep.
    """
    objects = [own.table("objects", side) for side in SIDES]
    real, sim = (np.column_stack([column(table, axis) for axis in ("cx", "cy", "cz")]) for table in objects)
    n_real, n_sim = (column(table, "n_points") for table in objects)
    with own.step("match"):
        matching = match_objects(real, sim, n_real, n_sim, own.settings)
    pairs = zip(matching.real_ids.tolist(), matching.sim_ids.tolist(), matching.distance_m.tolist(), strict=True)
    rows: list[Row] = [{"real_id": a, "sim_id": b, "centroid_distance_m": d, "status": "matched"} for a, b, d in pairs]
    rows += [{"real_id": a, "status": "missing"} for a in matching.missing.tolist()]
    rows += [{"sim_id": b, "status": "hallucinated"} for b in matching.hallucinated.tolist()]
    n_keep = np.minimum(n_real[matching.real_ids], n_sim[matching.sim_ids])
    table = TABLES["matching"].from_rows({"pair_id": own.pair_id} | row for row in rows)
    return JobResult(
        {"matching": table}, {OBJECTS: list(zip(matching.real_ids.tolist(), n_keep.tolist(), strict=True))}
    )


STAGE = Stage(
    name="matching",
    takes={"objects": ("cx", "cy", "cz", "n_points")},
    gives=("matching",),
    settings=("communities", "matching"),
    grain=Grain.PAIR,
    version=1,
    make=make_matching,
)
