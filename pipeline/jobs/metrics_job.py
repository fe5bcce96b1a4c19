"""Stage metrics: the scores of matched objects, and their summary."""

from __future__ import annotations

import numpy as np
import pyarrow as pa

from ...schemas.metric_catalogue import OBJECT_METRICS
from ...stages.arrays import FloatArray
from ...stages.metrics import score_object
from ...stages.summary import summarise_pair
from ..stage import OF_PAIR, Grain, Inputs, JobResult, Metadata, Stage, Tables
from .points_job import MATCHED_OBJECTS, column, kept_nodes, matched_objects


def make_metrics(inputs: Inputs) -> JobResult:
    """Score each object: geometry and structure; one row for each."""
    selection = inputs.table("selection")
    rows = []
    for match, real, sim in matched_objects(inputs):
        nodes = kept_nodes(selection, match["real_id"], real, sim)
        row = match | {
            "n_real": len(real.points),
            "n_sim": len(sim.points),
            "n_keep": len(nodes.real_nodes),
        }
        rows.append(row | vars(score_object(real, sim, nodes, watch=inputs.step)))
    return JobResult(inputs.rows("metrics", rows))


def gather_metrics(inputs: Inputs, tables: Tables) -> Metadata:
    """The pair's columns of `pairs`: counts, match rate, ranges, and means over the matched objects."""
    metrics = tables["metrics"]
    matching = inputs.table("matching")
    statuses = np.array(matching.column("status").to_pylist(), dtype=object)

    def range_of(side: str, status: str) -> FloatArray:
        ids = matching.column(f"{side}_id").filter(pa.array(statuses == status)).to_numpy()
        return column(inputs.table("objects", side), "range_m")[ids]

    of_pair = summarise_pair(
        {metric: column(metrics, metric) for metric in OBJECT_METRICS},
        metrics.column("status").to_pylist(),
        range_of("real", "matched"),
        range_of("real", "not_found"),
        range_of("sim", "extra"),
    )
    return {OF_PAIR: of_pair}


STAGE = Stage(
    name="metrics",
    takes=(*MATCHED_OBJECTS, "objects", "selection"),
    gives=("metrics",),
    grain=Grain.OBJECT,
    version=2,
    make=make_metrics,
    gather=gather_metrics,
)
