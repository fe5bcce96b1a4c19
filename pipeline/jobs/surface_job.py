"""Stage surface: how far the simulated surface is displaced against the real one, and how rough both are."""

from __future__ import annotations

import numpy as np

from ...schemas.columns import SIDES, Row
from ...schemas.metric_catalogue import SHIFT_COLUMNS
from ...stages.surface import Offsets, compare_roughness, describe_surface, measure_offsets
from ..stage import OF_PAIR, Inputs, JobResult, Stage
from .points_job import column, object_points


def make_surface(inputs: Inputs) -> JobResult:
    """Compare the surfaces of both sides; one row for each real object and one for the whole."""
    labels = column(inputs.table("communities", "real"), "community_id")
    with inputs.step("planes"):
        points = [object_points(inputs, side)[1] for side in SIDES]
        real_surface, sim_surface = map(describe_surface, points)
    with inputs.step("offset"):
        whole = measure_offsets(real_surface, sim_surface)
        objects = measure_offsets(real_surface, sim_surface, labels)
    ids = np.arange(len(objects.n_points))
    of_objects = _columns(objects) | {"real_id": ids}
    tables = inputs.columns("surface", of_objects, _columns(whole))
    (shift,) = tables["surface"].select(SHIFT_COLUMNS).slice(len(ids)).to_pylist()
    roughness = compare_roughness(real_surface, sim_surface)
    return JobResult(tables, {OF_PAIR: shift | roughness})


def _columns(offsets: Offsets) -> Row:
    shifts = zip(SHIFT_COLUMNS, (*offsets.shift_m.T, offsets.distance_m), strict=True)
    return vars(offsets) | dict(shifts)


STAGE = Stage(
    name="surface",
    takes=("ground", "communities"),
    gives=("surface",),
    make=make_surface,
    libraries=("scikit-learn",),
)
