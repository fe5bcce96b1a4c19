"""Stage coverage: how much of each object, and of each side, the other side has."""

from __future__ import annotations

import numpy as np

from ...schemas.columns import SIDES, Row
from ...schemas.metric_catalogue import COVERAGE_REACHES
from ...schemas.tables import TABLES
from ...stages.coverage import Coverage
from ...stages.method import measure_coverage
from ..stage import OF_PAIR, Grain, Inputs, JobResult, Metadata, Stage
from .points_job import POINT_COLUMNS, column, nulls_for_nan, object_points

_MEASURES = (*(f"covered_{reach}" for reach in COVERAGE_REACHES), "median_distance_m", "road_share")


def make_coverage(inputs: Inputs) -> JobResult:
    """Measure how much of each object the other side has; one row for each object and one for each side."""
    points = [object_points(inputs, side)[1] for side in SIDES]
    labels = [column(inputs.table("communities", side), "community_id") for side in SIDES]
    n_objects = [inputs.table("objects", side).num_rows for side in SIDES]
    grounds = [inputs.metadata("ground", side) for side in SIDES]
    cuts = [(np.array(ground["axis"]), ground["threshold_m"]) for ground in grounds]
    coverage = measure_coverage(points, labels, n_objects, cuts, watch=inputs.step)
    rows: list[Row] = []
    of_pair: Metadata = {}
    for side, (of_objects, of_side) in zip(SIDES, coverage, strict=True):
        both = {"pair_id": inputs.pair_id, "side": side}
        for community_id, row in enumerate(_rows(of_objects)):
            rows.append(both | {"community_id": community_id} | row)
        (whole,) = _rows(of_side)
        rows.append(both | whole)
        for reach in COVERAGE_REACHES:
            of_pair[f"covered_{side}_{reach}"] = whole[f"covered_{reach}"]
    return JobResult({"coverage": TABLES["coverage"].from_rows(rows)}, {OF_PAIR: of_pair})


def _rows(coverage: Coverage) -> list[Row]:
    """One row per object, without the columns that name it."""
    measures = [coverage.covered, coverage.median_distance_m, coverage.road_share]
    numbers = np.column_stack(measures).tolist()
    rows = []
    for n_points, values in zip(coverage.n_points.tolist(), numbers, strict=True):
        row: Row = dict(zip(_MEASURES, nulls_for_nan(values), strict=True))
        rows.append({"n_points": n_points} | row)
    return rows


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
