"""Stage metrics: the scores of matched objects, and the pair's row of `pairs`."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from typing import Any

import numpy as np
import pyarrow as pa

from ...schemas.columns import SIDES
from ...schemas.metrics import OBJECT_METRICS
from ...schemas.record import SurfaceStates
from ...schemas.settings import Settings
from ...schemas.tables import METRICS
from ...stages.arrays import FloatArray
from ...stages.coverage import ROAD, surface_state
from ...stages.metrics import score_object
from ...stages.summary import summarise_pair
from ..stage import ROW, Context, Facts, Grain, Made, Stage, Tables
from ..storage.tables import JobRecord
from .points import MATCHED_OBJECTS, NODE_COLUMNS, column, kept_nodes, matched_pair, matched_rows

_CUT = ("peak_m", "threshold_m", "loss", "iterations", "removed_share", "tilt_deg")

#: What an object is called that only this side has.
_ALONE = {"real": "missing", "sim": "hallucinated"}
_COVERED = ("side", "community_id", "covered_0p3m", "road_share")


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
    ranges = {side: column(context.table("objects", side), "range_m") for side in SIDES}
    matching = context.table("matching")
    statuses = matching.column("status").to_pylist()
    for side, alone in _ALONE.items():
        row[f"n_communities_{side}"] = statuses.count("matched") + statuses.count(alone)
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
        | context.facts("coverage")
        | context.facts("surface")
        | context.facts("pieces")
        | context.facts("sensor", "real")["pairs"]
        | context.facts("sensor", "sim")["pairs"],
        "unmatched": _unmatched_surface(context.table("coverage"), ids, statuses),
    }


def summarise_metrics(records: Iterable[JobRecord], settings: Settings) -> dict[str, Any]:
    """Of the unmatched objects of all pairs, how many have their surface on the other side, and how many are road."""
    total = {alone: dict.fromkeys(SurfaceStates.model_fields, 0) for alone in _ALONE.values()}
    for record in records:
        for alone, counts in record.facts["unmatched"].items():
            for state, count in counts.items():
                total[alone][state] += count
    return {"unmatched": total}


def _unmatched_surface(coverage: pa.Table, ids: dict[str, list[Any]], statuses: list[str]) -> Facts:
    """How many objects that only one side has are covered by the other side, by what they are called and by state."""
    columns = (coverage.column(name).to_pylist() for name in _COVERED)
    shares = {(side, community_id): own for side, community_id, *own in zip(*columns, strict=True)}
    counts = {}
    for side, alone in _ALONE.items():
        own = [shares[side, i] for i, status in zip(ids[side], statuses, strict=True) if status == alone]
        states = Counter(surface_state(covered) for covered, _ in own)
        counts[alone] = dict(states) | {"road": sum((road_share or 0) > ROAD for _, road_share in own)}
    return counts


STAGE = Stage(
    name="metrics",
    takes={
        **MATCHED_OBJECTS,
        "objects": ("range_m",),
        "selection": NODE_COLUMNS,
        "coverage": _COVERED,
        "surface": (),
        "pieces": (),
        "sensor": (),
    },
    gives=("metrics",),
    grain=Grain.OBJECT,
    version=1,
    make=make_metrics,
    gather=gather_metrics,
    summarise=summarise_metrics,
)
