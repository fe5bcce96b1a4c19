"""Stage coverage: how much of each object, and of each side, the other side has."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from typing import Any

import numpy as np

from ...schemas.columns import SIDES, Row
from ...schemas.metrics import COVERAGE_REACHES
from ...schemas.record import SurfaceStates
from ...schemas.settings import Settings
from ...schemas.tables import COVERAGE
from ...stages.coverage import ROAD, Coverage, surface_state
from ...stages.method import SideCoverage, measure_coverage
from ..stage import OF_PAIR, Facts, Grain, Inputs, JobResult, Stage
from ..storage.tables import JobRecord
from .points import POINT_COLUMNS, column, nulls_for_nan, object_points

_MEASURES = (*(f"covered_{reach}" for reach in COVERAGE_REACHES), "median_distance_m", "road_share")

#: Status of an object that only this side has.
_UNMATCHED = {"real": "missing", "sim": "hallucinated"}


def make_coverage(own: Inputs) -> JobResult:
    """Measure how much of each object the other side has."""
    points = [object_points(own, side)[1] for side in SIDES]
    labels = [column(own.table("communities", side), "community_id") for side in SIDES]
    n_objects = [own.table("objects", side).num_rows for side in SIDES]
    cuts = [(np.array(cut["axis"]), cut["threshold_m"]) for cut in (own.facts("ground", side) for side in SIDES)]
    coverage = measure_coverage(points, labels, n_objects, cuts, watch=own.step)
    matching = own.table("matching")
    statuses = matching.column("status").to_pylist()
    unmatched = {
        side: [
            own_id
            for own_id, status in zip(matching.column(f"{side}_id").to_pylist(), statuses, strict=True)
            if status == _UNMATCHED[side]
        ]
        for side in SIDES
    }
    return coverage_result(own.pair_id, coverage, unmatched)


def coverage_result(
    pair_id: str, coverage: tuple[SideCoverage, SideCoverage], unmatched: dict[str, list[int]]
) -> JobResult:
    """One row for each object of either side and one for each side; the facts count what unmatched objects are.

    Parameters
    ----------
    unmatched : by side, ids of the objects that only this side has
    """
    rows: list[Row] = []
    of_pair: Facts = {}
    states: Facts = {}
    for side, own in zip(SIDES, coverage, strict=True):
        objects, (whole,) = _rows(own.objects), _rows(own.whole)
        both = {"pair_id": pair_id, "side": side}
        rows += [both | {"community_id": i} | row for i, row in enumerate(objects)]
        rows.append(both | whole)
        of_pair |= {f"covered_{side}_{reach}": whole[f"covered_{reach}"] for reach in COVERAGE_REACHES}
        alone = [objects[i] for i in unmatched[side]]
        states[_UNMATCHED[side]] = dict(Counter(surface_state(row["covered_0p3m"]) for row in alone))
        states[_UNMATCHED[side]]["road"] = sum((row["road_share"] or 0) > ROAD for row in alone)
    return JobResult({"coverage": COVERAGE.from_rows(rows)}, {OF_PAIR: of_pair, "unmatched": states})


def summarise_coverage(records: Iterable[JobRecord], settings: Settings) -> dict[str, Any]:
    """Of the unmatched objects of all pairs, how many have their surface on the other side, and how many are road."""
    total = {status: dict.fromkeys(SurfaceStates.model_fields, 0) for status in _UNMATCHED.values()}
    for record in records:
        for status, counts in record.facts["unmatched"].items():
            for state, count in counts.items():
                total[status][state] += count
    return {"metrics": {"unmatched": total}}


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
        "matching": ("real_id", "sim_id", "status"),
    },
    gives=("coverage",),
    grain=Grain.PAIR,
    version=2,
    make=make_coverage,
    summarise=summarise_coverage,
)
