"""Stage surface: how far the simulated surface is displaced against the real one, and how rough both are."""

from __future__ import annotations

import numpy as np

from ...schemas.columns import Row
from ...schemas.metric_catalogue import SHIFT_COLUMNS
from ...schemas.tables import TABLES
from ...stages.method import measure_surface
from ...stages.surface import Offsets
from ..stage import OF_PAIR, Grain, Inputs, JobResult, Metadata, Stage
from .points_job import POINT_COLUMNS, column, nulls_for_nan, object_points


def make_surface(inputs: Inputs) -> JobResult:
    """Compare the surfaces of both sides; one row for each real object and one for the whole."""
    _, real = object_points(inputs, "real")
    _, sim = object_points(inputs, "sim")
    labels = column(inputs.table("communities", "real"), "community_id")
    whole, objects, roughness = measure_surface(real, sim, labels, watch=inputs.step)
    (pair,) = _rows(whole)
    rows = [{"real_id": i} | row for i, row in enumerate(_rows(objects))]
    of_pair: Metadata = {name: pair[name] for name in SHIFT_COLUMNS} | roughness
    table = TABLES["surface"].from_rows({"pair_id": inputs.pair_id} | row for row in [*rows, pair])
    return JobResult({"surface": table}, {OF_PAIR: of_pair})


def _rows(offsets: Offsets) -> list[Row]:
    """One row per piece of surface, null for directions that are not observable."""
    values = np.column_stack([offsets.shift_m, offsets.distance_m]).tolist()
    counts = zip(offsets.n_points.tolist(), offsets.n_directions.tolist(), strict=True)
    rows = []
    for (n_points, n_directions), of_piece in zip(counts, values, strict=True):
        row: Row = {"n_points": n_points, "n_directions": n_directions}
        row |= zip(SHIFT_COLUMNS, nulls_for_nan(of_piece), strict=True)
        rows.append(row)
    return rows


STAGE = Stage(
    name="surface",
    takes={"ground": POINT_COLUMNS, "communities": ("community_id",)},
    gives=("surface",),
    grain=Grain.PAIR,
    make=make_surface,
    libraries=("scikit-learn",),
)
