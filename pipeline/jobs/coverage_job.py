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


def make_coverage(own: Inputs) -> JobResult:
    """Measure how much of each object the other side has; one row for each object and one for each side."""
    points = [object_points(own, side)[1] for side in SIDES]
    labels = [column(own.table("communities", side), "community_id") for side in SIDES]
    n_objects = [own.table("objects", side).num_rows for side in SIDES]
    cuts = [(np.array(cut["axis"]), cut["threshold_m"]) for cut in (own.metadata("ground", side) for side in SIDES)]
    coverage = measure_coverage(points, labels, n_objects, cuts, watch=own.step)
    rows: list[Row] = []
    of_pair: Metadata = {}
    for side, found in zip(SIDES, coverage, strict=True):
        objects, (whole,) = map(_rows, found)
        both = {"pair_id": own.pair_id, "side": side}
        rows += [both | {"community_id": i} | row for i, row in enumerate(objects)]
        rows.append(both | whole)
        of_pair |= {f"covered_{side}_{reach}": whole[f"covered_{reach}"] for reach in COVERAGE_REACHES}
    return JobResult({"coverage": TABLES["coverage"].from_rows(rows)}, {OF_PAIR: of_pair})


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
