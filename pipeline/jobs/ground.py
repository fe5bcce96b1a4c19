"""Stage ground: the clean points of a side, with ground flags."""

from __future__ import annotations

import numpy as np

from ...schemas.errors import StageError
from ...schemas.settings import Settings
from ...schemas.tables import GROUND
from ...stages.clean import clean_scan, too_few_left
from ...stages.ground import MIN_OBJECT_POINTS, GroundResult, remove_ground
from ..stage import SCAN, Context, Facts, Grain, Made, Stage
from .points import column

_LIBRARIES = {"pca": ("scikit-learn",), "patchwork": ("pypatchworkpp", "scikit-learn"), "none": ("scikit-learn",)}


def make_ground(context: Context) -> Made:
    """Cleans a scan, cuts the road away, and tells how many points were dropped and where the cut lies."""
    with context.step("read"):
        scan = context.scan()
    side, own = str(context.side), context.settings.input
    T = np.array(context.T_real_sim).reshape(3, 4) if side == "sim" and context.T_real_sim else None
    with context.step("clean"):
        clean = clean_scan(scan.points, own, frame=own.frame_of(side), T_real_sim=T)
    if len(clean.points) < MIN_OBJECT_POINTS:
        raise StageError(too_few_left(len(clean.points), MIN_OBJECT_POINTS, clean.dropped, own))
    shared = real_points = None
    if context.needs_real:
        shared = _cut(context.facts("ground", "real"))
        if not context.settings.ground.shared:
            real = context.table("ground", "real", ("x", "y", "z"))
            real_points = np.column_stack([column(real, axis) for axis in "xyz"])
    with context.step("ground"):
        cut = remove_ground(clean.points, context.settings.ground, shared, real_points)
    x, y, z = clean.points.T
    rows = GROUND.build(
        {
            "pair_id": context.pair_id,
            "side": context.side,
            "point_id": clean.point_ids,
            "x": x,
            "y": y,
            "z": z,
            "height_m": cut.height_m,
            "is_ground": cut.is_ground,
            "intensity": None if scan.intensity is None else scan.intensity[clean.point_ids],
            "label": None if scan.labels is None else scan.labels[clean.point_ids].tolist(),
            "instance": None if scan.instances is None else scan.instances[clean.point_ids],
        },
        len(x),
    )
    n_ground = int(np.count_nonzero(cut.is_ground))
    facts: Facts = {
        "n_raw": len(scan.points),
        "n_clean": len(x),
        "n_points": len(x) - n_ground,
        "dropped": clean.dropped,
        "axis": cut.axis.tolist(),
        "peak_m": cut.peak_m,
        "threshold_m": cut.threshold_m,
        "loss": cut.loss,
        "iterations": cut.iterations,
        "removed_share": n_ground / len(x),
        "tilt_deg": cut.tilt_deg,
        "notes": list(cut.notes),
    }
    return Made({"ground": rows}, facts)


def _libraries(settings: Settings) -> tuple[str, ...]:
    return _LIBRARIES[settings.ground.method]


def _needs_real(settings: Settings) -> bool:
    return settings.ground.shared or settings.ground.peak == "real"


def _cut(facts: Facts) -> GroundResult:
    """The real side's cut, for the simulated side."""
    return GroundResult(
        is_ground=np.empty(0, dtype=np.bool_),
        height_m=np.empty(0),
        axis=np.array(facts["axis"]),
        tilt_deg=facts["tilt_deg"],
        peak_m=facts["peak_m"],
        threshold_m=facts["threshold_m"],
        loss=facts["loss"],
        iterations=facts["iterations"],
    )


STAGE = Stage(
    name="ground",
    takes={SCAN: ()},
    gives=("ground",),
    settings=("input", "ground"),
    grain=Grain.SIDE,
    version=1,
    make=make_ground,
    libraries=_libraries,
    needs_real=_needs_real,
)
