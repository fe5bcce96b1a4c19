"""Stage coverage: how much of each object, and of each side, the other side has."""

from __future__ import annotations

import numpy as np

from ...schemas.columns import SIDES, Row
from ...schemas.metric_catalogue import COVERAGE_REACHES
from ...stages.coverage import Coverage, below_cut, cover, nearest_distances
from ..stage import OF_PAIR, Inputs, JobResult, Metadata, Stage
from .points_job import column, object_points

_COVERED = [f"covered_{reach}" for reach in COVERAGE_REACHES]


def make_coverage(inputs: Inputs) -> JobResult:
    """Measure how much of each object the other side has; one row for each object and one for each side."""
    points = {side: object_points(inputs, side)[1] for side in SIDES}
    with inputs.step("nearest"):
        distances_m = nearest_distances(points["real"], points["sim"])
    parts: list[Row] = []
    of_pair: Metadata = {}
    for side, other, distance_m in zip(SIDES, SIDES[::-1], distances_m, strict=True):
        cut = inputs.metadata("ground", other)
        is_road = below_cut(points[side], np.array(cut["axis"]), cut["threshold_m"])
        labels = column(inputs.table("communities", side), "community_id")
        n_objects = inputs.table("objects", side).num_rows
        objects = cover(distance_m, labels, n_objects, is_road)
        whole = cover(distance_m, np.zeros_like(labels), is_road=is_road)
        parts.append(_columns(objects) | {"side": side, "community_id": np.arange(n_objects)})
        parts.append(_columns(whole) | {"side": side})
        for reach, share in zip(COVERAGE_REACHES, whole.covered[0].tolist(), strict=True):
            of_pair[f"covered_{side}_{reach}"] = share
    return JobResult(inputs.columns("coverage", *parts), {OF_PAIR: of_pair})


def _columns(coverage: Coverage) -> Row:
    return vars(coverage) | dict(zip(_COVERED, coverage.covered.T, strict=True))


STAGE = Stage(
    name="coverage",
    takes=("ground", "communities", "objects"),
    gives=("coverage",),
    version=2,
    make=make_coverage,
)
