"""Stage metrics: the scores of matched objects, and the pair's row of `pairs`."""

from __future__ import annotations

import numpy as np

from ...schemas.columns import SIDES
from ...schemas.metrics import OBJECT_METRICS
from ...schemas.tables import METRICS
from ...stages.arrays import FloatArray
from ...stages.metrics import score_object
from ...stages.summary import summarise_pair
from ..stage import ROW, Context, Facts, Grain, Made, Stage, Tables
from .points import MATCHED_OBJECTS, NODE_COLUMNS, column, kept_nodes, matched_pair, matched_rows

_CUT = ("peak_m", "threshold_m", "loss", "iterations", "removed_share", "tilt_deg")


def make_metrics(context: Context) -> Made:
    """Scores each object: geometry and structure."""
    rows, selection = [], context.table("selection")
    for match in matched_rows(context):
        real, sim = matched_pair(context, match)
        nodes = kept_nodes(selection, match["real_id"], real, sim)
        scores = score_object(real, sim, nodes, watch=context.step)
        sizes = {"n_real": len(real.points), "n_sim": len(sim.points), "n_keep": len(nodes.real_nodes)}
        del match["status"]
        rows.append({"pair_id": context.pair_id} | match | sizes | vars(scores))
    return Made({"metrics": METRICS.from_rows(rows)})


def gather_metrics(context: Context, tables: Tables) -> Facts:
    """The pair's row of `pairs`: counts, match rate, ranges, means over the objects, and what both surfaces say."""
    metrics = tables["metrics"]
    row: Facts = {"pair_id": context.pair_id, "status": "scored"}
    for side in SIDES:
        ground = context.facts("ground", side)
        row |= {f"n_{side}_{name}": ground[f"n_{name}"] for name in ("raw", "clean", "points")}
        row |= {f"ground_{side}_{name}": ground[name] for name in _CUT}
        row[f"n_communities_{side}"] = context.facts("objects", side)["n_communities"]
    ranges = {side: column(context.table("objects", side), "range_m") for side in SIDES}
    matching = context.table("matching")
    statuses = matching.column("status").to_pylist()
    ids = {side: matching.column(f"{side}_id").to_pylist() for side in SIDES}

    def range_of(side: str, status: str) -> FloatArray:
        chosen = [i for i, own in zip(ids[side], statuses, strict=True) if own == status]
        range_m: FloatArray = ranges[side][np.array(chosen, dtype=np.intp)]
        return range_m

    return {
        ROW: row
        | summarise_pair(
            {metric: metrics.column(metric).to_numpy() for metric in OBJECT_METRICS},
            metrics.column("status").to_pylist(),
            range_of("real", "matched"),
            range_of("real", "missing"),
            range_of("sim", "hallucinated"),
        )
        | context.facts("coverage")["pair"]
        | context.facts("surface")
    }


STAGE = Stage(
    name="metrics",
    takes={**MATCHED_OBJECTS, "objects": ("range_m",), "selection": NODE_COLUMNS, "coverage": (), "surface": ()},
    gives=("metrics",),
    grain=Grain.OBJECT,
    version=1,
    make=make_metrics,
    gather=gather_metrics,
)
