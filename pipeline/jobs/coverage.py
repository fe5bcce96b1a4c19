"""Stage coverage: how much of each object, and of each side, the other side has."""

from __future__ import annotations

import numpy as np

from ...schemas.columns import SIDES, Row
from ...schemas.metrics import COVERAGE_REACHES
from ...schemas.tables import COVERAGE
from ...stages.coverage import Coverage, below_cut, cover, nearest_distances
from ..stage import Context, Facts, Grain, Made, Stage
from .points import POINT_COLUMNS, column, nulls_for_nan, object_points

_MEASURES = (*(f"covered_{reach}" for reach in COVERAGE_REACHES), "median_distance_m", "road_share")


def make_coverage(context: Context) -> Made:
    """One row for each object of either side and one for each side; the facts have the columns of `pairs`."""
    points = [object_points(context, side)[1] for side in SIDES]
    rows: list[Row] = []
    facts: Facts = {}
    with context.step("nearest"):
        distances_m = nearest_distances(*points)
    for side, other, distance_m in zip(SIDES, reversed(SIDES), distances_m, strict=True):
        cut = context.facts("ground", other)
        is_road = below_cut(object_points(context, side)[1], np.array(cut["axis"]), cut["threshold_m"])
        labels = column(context.table("communities", side), "community_id")
        each = cover(distance_m, labels, len(column(context.table("objects", side), "n_points")), is_road)
        (whole,) = _rows(cover(distance_m, np.zeros(len(labels), dtype=np.int32), is_road=is_road))
        both = {"pair_id": context.pair_id, "side": side}
        rows += [both | {"community_id": i} | row for i, row in enumerate(_rows(each))]
        rows.append(both | whole)
        facts |= {f"covered_{side}_{reach}": whole[f"covered_{reach}"] for reach in COVERAGE_REACHES}
    return Made({"coverage": COVERAGE.from_rows(rows)}, facts)


def _rows(coverage: Coverage) -> list[Row]:
    """One row per object, without the columns that name it."""
    numbers = np.column_stack([coverage.covered, coverage.median_distance_m, coverage.road_share]).tolist()
    return [
        {"n_points": n} | dict(zip(_MEASURES, nulls_for_nan(values), strict=True))
        for n, values in zip(coverage.n_points.tolist(), numbers, strict=True)
    ]


STAGE = Stage(
    name="coverage",
    takes={
        "ground": POINT_COLUMNS,
        "communities": ("community_id",),
        "objects": ("n_points",),
    },
    gives=("coverage",),
    grain=Grain.PAIR,
    version=2,
    make=make_coverage,
)
