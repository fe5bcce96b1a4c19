"""Stage selection: the aligned nodes of matched objects."""

from __future__ import annotations

import numpy as np
import pyarrow as pa

from ...schemas.settings import Settings
from ...schemas.tables import SELECTION
from ...stages.selection import select_nodes
from ..stage import Context, Grain, Made, Stage
from .points import MATCHED_OBJECTS, matched_pair, matched_rows


def make_selection(context: Context) -> Made:
    """Keeps the most influential nodes of each object on both sides, aligned one to one."""
    parts = [SELECTION.from_rows([])]
    for match in matched_rows(context):
        real, sim = matched_pair(context, match)
        kept = select_nodes(real, sim, context.settings.selection, watch=context.step)
        parts.append(
            SELECTION.build(
                {
                    "pair_id": context.pair_id,
                    "real_id": match["real_id"],
                    "sim_id": match["sim_id"],
                    "rank": np.arange(len(kept.real_nodes), dtype=np.int32),
                    "real_point_id": real.point_ids[kept.real_nodes],
                    "sim_point_id": sim.point_ids[kept.sim_nodes],
                    "real_influence": kept.real_influence,
                    "sim_influence": kept.sim_influence,
                },
                len(kept.real_nodes),
            )
        )
    return Made({"selection": pa.concat_tables(parts).combine_chunks()})


def _libraries(settings: Settings) -> tuple[str, ...]:
    return ("POT",)


STAGE = Stage(
    name="selection",
    takes=MATCHED_OBJECTS,
    gives=("selection",),
    settings=("selection",),
    grain=Grain.OBJECT,
    version=1,
    make=make_selection,
    libraries=_libraries,
)
