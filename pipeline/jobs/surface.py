"""Stage surface: how far the simulated surface is displaced against the real one, and how rough both are."""

from __future__ import annotations

from ...schemas.columns import SIDES, Row
from ...schemas.metrics import SHIFT_COLUMNS
from ...schemas.settings import Settings
from ...schemas.tables import SURFACE
from ...stages.surface import Offsets, compare_roughness, describe_surface, measure_offsets
from ..stage import Context, Facts, Grain, Made, Stage
from .points import POINT_COLUMNS, column, nulls_for_nan, object_points


def make_surface(context: Context) -> Made:
    """One row for each real object and one for the whole; the facts have the pair's columns of `pairs`."""
    with context.step("planes"):
        real, sim = (describe_surface(object_points(context, side)[1]) for side in SIDES)
    with context.step("offset"):
        whole = measure_offsets(real, sim)
        each = measure_offsets(real, sim, column(context.table("communities", "real"), "community_id"))
    (pair,) = _rows(whole)
    rows = [{"real_id": i} | row for i, row in enumerate(_rows(each))]
    facts: Facts = {name: pair[name] for name in SHIFT_COLUMNS} | compare_roughness(real, sim)
    return Made({"surface": SURFACE.from_rows({"pair_id": context.pair_id} | row for row in [*rows, pair])}, facts)


def _rows(offsets: Offsets) -> list[Row]:
    """One row per piece of surface, nulls for what its normals do not tell."""
    counts = zip(offsets.n_points.tolist(), offsets.n_directions.tolist(), strict=True)
    shifts = zip(offsets.shift_m.tolist(), offsets.distance_m.tolist(), strict=True)
    return [
        {"n_points": n_points, "n_directions": n_directions}
        | dict(zip(SHIFT_COLUMNS, nulls_for_nan((*shift, distance)), strict=True))
        for (n_points, n_directions), (shift, distance) in zip(counts, shifts, strict=True)
    ]


def _libraries(settings: Settings) -> tuple[str, ...]:
    return ("scikit-learn",)


STAGE = Stage(
    name="surface",
    takes={"ground": POINT_COLUMNS, "communities": ("community_id",)},
    gives=("surface",),
    grain=Grain.PAIR,
    make=make_surface,
    libraries=_libraries,
)
