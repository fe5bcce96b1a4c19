"""Stage metrics: the scores of matched objects, and their summary."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
import pyarrow as pa

from ...schemas.metric_catalogue import OBJECT_METRICS
from ...schemas.results import Number
from ...schemas.tables import TABLES
from ...stages.arrays import FloatArray
from ...stages.method import n_communities
from ...stages.metrics import Scores, score_object
from ...stages.summary import summarise_pair
from ..stage import OF_PAIR, Grain, Inputs, JobResult, Metadata, Stage, Tables
from .points_job import MATCHED_OBJECTS, NODE_COLUMNS, column, kept_nodes, matched_objects


def make_metrics(own: Inputs) -> JobResult:
    """Score each object: geometry and structure."""
    selection, scored = own.table("selection"), []
    for match, real, sim in matched_objects(own):
        nodes = kept_nodes(selection, match["real_id"], real, sim)
        sizes = len(real.points), len(sim.points), len(nodes.real_nodes)
        scored.append((match, sizes, score_object(real, sim, nodes, watch=own.step)))
    return metrics_result(own.pair_id, scored)


def metrics_result(
    pair_id: str, objects: Iterable[tuple[Mapping[str, Any], tuple[int, int, int], Scores]]
) -> JobResult:
    """One row per matched object.

    Parameters
    ----------
    objects : of each its row of `matching`, its points on both sides and its kept nodes, and its scores
    """
    names = ("real_id", "sim_id", "centroid_distance_m")
    rows = [
        {"pair_id": pair_id}
        | {name: match[name] for name in names}
        | dict(zip(("n_real", "n_sim", "n_keep"), sizes, strict=True))
        | vars(scores)
        for match, sizes, scores in objects
    ]
    return JobResult({"metrics": TABLES["metrics"].from_rows(rows)})


def gather_metrics(own: Inputs, tables: Tables) -> Metadata:
    """The pair's columns of `pairs`: counts, match rate, ranges, means over the objects."""
    metrics, matching = tables["metrics"], own.table("matching")
    statuses = np.array(matching.column("status").to_pylist(), dtype=object)

    def range_of(side: str, status: str) -> FloatArray:
        ids = matching.column(f"{side}_id").filter(pa.array(statuses == status)).to_numpy()
        range_m: FloatArray = column(own.table("objects", side), "range_m")[ids]
        return range_m

    summary: dict[str, Number] = summarise_pair(
        {metric: metrics.column(metric).to_numpy() for metric in OBJECT_METRICS},
        metrics.column("status").to_pylist(),
        range_of("real", "matched"),
        range_of("real", "missing"),
        range_of("sim", "hallucinated"),
    )
    return {OF_PAIR: summary | n_communities(summary)}


STAGE = Stage(
    name="metrics",
    takes={**MATCHED_OBJECTS, "objects": ("range_m",), "selection": NODE_COLUMNS},
    gives=("metrics",),
    grain=Grain.OBJECT,
    version=1,
    make=make_metrics,
    gather=gather_metrics,
)
