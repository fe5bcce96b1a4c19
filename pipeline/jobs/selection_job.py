"""Stage selection: the aligned nodes of matched objects."""

from __future__ import annotations

import numpy as np

from ...stages.selection import select_nodes
from ..stage import Grain, Inputs, JobResult, Stage
from .points_job import MATCHED_OBJECTS, matched_objects


def make_selection(inputs: Inputs) -> JobResult:
    """Keep the most influential nodes of each object on both sides, aligned one to one; one row per node."""
    parts = []
    for match, real, sim in matched_objects(inputs):
        kept = select_nodes(real, sim, inputs.settings.selection, watch=inputs.step)
        columns = {
            "rank": np.arange(len(kept.real_nodes), dtype=np.int32),
            "real_point_id": real.point_ids[kept.real_nodes],
            "sim_point_id": sim.point_ids[kept.sim_nodes],
        }
        parts.append(match | vars(kept) | columns)
    return JobResult(inputs.columns("selection", *parts))


STAGE = Stage(
    name="selection",
    takes=MATCHED_OBJECTS,
    gives=("selection",),
    settings=("selection",),
    grain=Grain.OBJECT,
    version=2,
    make=make_selection,
    libraries=("POT",),
)
