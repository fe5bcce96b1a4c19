"""Stage selection: the aligned nodes of matched objects."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
import pyarrow as pa

from ...schemas.tables import TABLES
from ...stages.arrays import IntArray
from ...stages.selection import Selection, select_nodes
from ..stage import Grain, Inputs, JobResult, Stage
from .points_job import MATCHED_OBJECTS, matched_objects


def make_selection(own: Inputs) -> JobResult:
    """Keep the most influential nodes of each object on both sides, aligned one to one."""
    kept = [
        (match, real.point_ids, sim.point_ids, select_nodes(real, sim, own.settings.selection, watch=own.step))
        for match, real, sim in matched_objects(own)
    ]
    return selection_result(own.pair_id, kept)


def selection_result(
    pair_id: str, objects: Iterable[tuple[Mapping[str, Any], IntArray, IntArray, Selection]]
) -> JobResult:
    """One row per kept node.

    Parameters
    ----------
    objects : of each matched object its row of `matching`, the ids of its points on both sides, and its kept nodes
    """
    parts = [TABLES["selection"].from_rows([])]
    for match, real_ids, sim_ids, kept in objects:
        columns = {
            "rank": np.arange(len(kept.real_nodes), dtype=np.int32),
            "real_point_id": real_ids[kept.real_nodes],
            "sim_point_id": sim_ids[kept.sim_nodes],
            "real_influence": kept.real_influence,
            "sim_influence": kept.sim_influence,
        }
        ids = {"pair_id": pair_id, "real_id": match["real_id"], "sim_id": match["sim_id"]}
        parts.append(TABLES["selection"].build(ids | columns, len(kept.real_nodes)))
    return JobResult({"selection": pa.concat_tables(parts).combine_chunks()})


STAGE = Stage(
    name="selection",
    takes=MATCHED_OBJECTS,
    gives=("selection",),
    settings=("selection",),
    grain=Grain.OBJECT,
    version=1,
    make=make_selection,
    libraries=("POT",),
)
