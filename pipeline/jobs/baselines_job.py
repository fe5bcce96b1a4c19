"""Stage baselines, an extra: the requested baseline metrics of each matched object and of the two whole scans."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import product
from typing import TYPE_CHECKING, Any

import numpy as np

from ...schemas.columns import SIDES, Row
from ...schemas.metric_catalogue import METRIC, scores_of
from ...schemas.record import OF_OBJECTS, OF_SCAN
from ...schemas.settings import Settings
from ...stages.summary import mean_and_std
from ..stage import Inputs, JobResult, Stage
from ..storage.table_files import JobRecord
from .points_job import (
    MATCHED_OBJECTS,
    coordinates,
    kept_nodes,
    matched_objects,
    object_points,
)

if TYPE_CHECKING:
    from ...stages.baselines import Baseline


def make_baselines(inputs: Inputs) -> JobResult:
    """Compare each matched object, and all object points of the two scans; the metadata hold the pair's means."""
    from ...stages.baselines import OF_SCANS, compare_points, nvs

    settings = inputs.settings
    selection = inputs.table("selection")
    rows: list[Row] = []
    for match, real, sim in matched_objects(inputs):
        nodes = kept_nodes(selection, match["real_id"], real, sim)
        values = compare_points(
            real.points, sim.points, settings.metrics, nodes=nodes, watch=inputs.step
        )
        rows += [_row(value, match) for value in values]

    real_points, sim_points = [object_points(inputs, side)[1] for side in SIDES]
    values = compare_points(real_points, sim_points, settings.metrics, watch=inputs.step)
    if OF_SCANS in settings.metrics.baselines:
        with inputs.step(OF_SCANS):
            scans = [coordinates(inputs.table("ground", side)) for side in SIDES]
            values += nvs(*scans)
    rows += [_row(value, {}) for value in values]
    return JobResult(inputs.rows("baselines", rows), {"means": _means(rows)})


def summarise_baselines(records: Iterable[JobRecord], settings: Settings) -> dict[str, Any]:
    """Mean and standard deviation (n - 1) over pairs by baseline and level (objects or scan).

    The value of a pair is the mean over its matched objects, or that of the whole scan.
    """
    groups: dict[tuple[str, str], list[Row]] = {}
    for record in records:
        for mean in record.metadata["means"]:
            groups.setdefault((mean["level"], mean["baseline"]), []).append(mean)
    summary = []
    for level, name in product((OF_OBJECTS, OF_SCAN), scores_of("baseline")):
        pairs = groups.get((level, name))
        if not pairs:
            continue
        mean, std = mean_and_std(np.array([pair["mean"] for pair in pairs], dtype=np.float64))
        summary.append(
            {
                "baseline": name,
                "level": level,
                "unit": METRIC[name].unit,
                "mean": mean,
                "std": std,
                "n": sum(pair["n"] for pair in pairs),
                "n_null": sum(pair["n_null"] for pair in pairs),
            }
        )
    return {"baselines": summary}


def _row(value: Baseline, match: Row) -> Row:
    """The row of a baseline: of a matched object, or of whole scans, which have no ids."""
    return match | {"baseline": value.name, "unit": value.unit} | vars(value)


def _means(rows: list[Row]) -> list[Row]:
    """The pair's mean of each baseline over objects, and its value of the whole scan."""
    groups: dict[tuple[str, str], list[float | None]] = {}
    for row in rows:
        level = OF_OBJECTS if "real_id" in row else OF_SCAN
        groups.setdefault((level, row["baseline"]), []).append(row["value"])
    means = []
    for (level, name), values in groups.items():
        known = [value for value in values if value is not None]
        mean = sum(known) / len(known) if known else None
        counts = {"n": len(known), "n_null": len(values) - len(known)}
        means.append({"level": level, "baseline": name, "mean": mean} | counts)
    return means


STAGE = Stage(
    name="baselines",
    takes=(*MATCHED_OBJECTS, "selection"),
    gives=("baselines",),
    settings=("metrics",),
    version=4,
    make=make_baselines,
    libraries=("POT",),
    is_wanted=lambda settings: bool(settings.metrics.baselines),
    summarise=summarise_baselines,
)
