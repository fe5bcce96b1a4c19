"""Stage coverage: how much of each object, and of each side, the other side has."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable
from typing import Any

import numpy as np
import pyarrow.compute as pc

from ...schemas.columns import SIDES, Row
from ...schemas.metrics import COVERAGE_REACHES
from ...schemas.results import SURFACE_STATES
from ...schemas.settings import Settings
from ...schemas.tables import COVERAGE
from ...stages.coverage import Coverage, cover, nearest_distances, surface_state
from ..stage import Context, Facts, Grain, Made, Stage
from ..storage.tables import JobRecord
from .points import POINT_COLUMNS, column, object_points

_MEASURES = (*(f"covered_{reach}" for reach in COVERAGE_REACHES), "median_distance_m")


def make_coverage(context: Context) -> Made:
    """One row for each object of either side, and one for each side as a whole.

    The facts have the pair's columns of `pairs`, and how many unmatched objects have their surface on the other side.
    """
    points = {side: object_points(context, side)[1] for side in SIDES}
    matching = context.table("matching")
    rows: list[Row] = []
    pair: Facts = {}
    unmatched: Facts = {}
    for (side, other), status in zip((SIDES, SIDES[::-1]), ("missing", "hallucinated"), strict=True):
        with context.step("nearest"):
            distance_m = nearest_distances(points[side], points[other])
        labels = column(context.table("communities", side), "community_id")
        each = cover(distance_m, labels, len(column(context.table("objects", side), "n_points")))
        whole = cover(distance_m, np.zeros(len(labels), dtype=np.int32))
        both = {"pair_id": context.pair_id, "side": side}
        rows += [both | {"community_id": i} | row for i, row in enumerate(_rows(each))]
        rows += [both | row for row in _rows(whole)]
        pair |= {f"covered_{side}_{reach}": _rows(whole)[0][f"covered_{reach}"] for reach in COVERAGE_REACHES}
        alone = matching.filter(pc.equal(matching.column("status"), status)).column(f"{side}_id")
        unmatched[status] = dict(Counter(surface_state(each.covered[i, 1]) for i in alone.to_pylist()))
    return Made({"coverage": COVERAGE.from_rows(rows)}, {"pair": pair, "unmatched": unmatched})


def summarise_coverage(records: Iterable[JobRecord], settings: Settings) -> dict[str, Any]:
    """Of the unmatched objects of all pairs, how many have their surface on the other side, wholly, partly, or not."""
    total = {status: dict.fromkeys(SURFACE_STATES, 0) for status in ("missing", "hallucinated")}
    for record in records:
        for status, counts in record.facts["unmatched"].items():
            for state, count in counts.items():
                total[status][state] += count
    return total


def _rows(coverage: Coverage) -> list[Row]:
    """One row per object, without the columns that name it."""
    numbers = np.column_stack([coverage.covered, coverage.median_distance_m]).tolist()
    return [
        {"n_points": n} | {name: None if math.isnan(x) else x for name, x in zip(_MEASURES, values, strict=True)}
        for n, values in zip(coverage.n_points.tolist(), numbers, strict=True)
    ]


STAGE = Stage(
    name="coverage",
    takes={
        "ground": POINT_COLUMNS,
        "communities": ("community_id",),
        "objects": ("n_points",),
        "matching": ("real_id", "sim_id", "status"),
    },
    gives=("coverage",),
    grain=Grain.PAIR,
    make=make_coverage,
    summarise=summarise_coverage,
)
