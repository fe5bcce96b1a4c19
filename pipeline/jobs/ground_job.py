"""Stage ground: the clean points of a side, with ground flags."""

from __future__ import annotations

import numpy as np

from ...schemas.columns import Row
from ...schemas.errors import StageError
from ...schemas.settings import Settings
from ...stages.arrays import FloatArray, transform_of
from ...stages.clean import CleanResult, clean_scan, too_few_left
from ...stages.ground import MIN_OBJECT_POINTS, GroundResult, remove_ground
from ...stages.plausibility import inspect_points
from ..datasets.readers.scan import Scan
from ..stage import (
    INSPECTION,
    N_CLEAN,
    OF_PAIR,
    SCAN,
    Grain,
    Inputs,
    JobResult,
    Metadata,
    Stage,
)
from .points_job import by_axis, cut_scan

_MEASURES = ("peak_m", "threshold_m", "loss", "iterations", "tilt_deg")


def make_ground(inputs: Inputs) -> JobResult:
    """Inspect and clean a scan and cut the road away.

    Raises
    ------
    StageError
        Too few points are left; also names what is implausible about the scan.
    """
    with inputs.step("read"):
        scan = inputs.scans[inputs.part]()
    settings = inputs.settings
    with inputs.step("inspect"):
        T_real_sim = transform_of(inputs.T_real_sim)
        inspection = inspect_points(scan.points, inputs.part, settings.input, T_real_sim)
    with inputs.step("clean"):
        frame = settings.input.frame_of(inputs.part)
        clean = clean_scan(scan.points, settings.input, frame=frame, T_real_sim=T_real_sim)
    try:
        if len(clean.points) < MIN_OBJECT_POINTS:
            raise StageError(too_few_left(clean, MIN_OBJECT_POINTS, settings.input))
        with inputs.step("ground"):
            cut = remove_ground(clean.points, settings.ground, *_real_side(inputs))
    except StageError as error:
        raise StageError("; ".join((str(error), *inspection.warnings))) from error
    metadata = _metadata(inputs.part, scan, clean, cut)
    metadata |= {INSPECTION: inspection, "T_real_sim": inputs.T_real_sim}
    return JobResult(inputs.columns("ground", _columns(scan, clean, cut)), metadata)


def _columns(scan: Scan, clean: CleanResult, cut: GroundResult) -> Row:
    """The clean points with their ground flags."""
    ids = clean.point_ids
    columns = {"point_id": ids} | vars(cut) | by_axis("{}", clean.points)
    optional = {"intensity": scan.intensity, "label": scan.labels, "instance": scan.instances}
    return columns | {
        name: values[ids] for name, values in optional.items() if values is not None
    }


def _metadata(side: str, scan: Scan, clean: CleanResult, cut: GroundResult) -> Metadata:
    """Number of dropped points, the cut, and columns of `pairs`."""
    n_clean = len(clean.points)
    n_ground = int(np.count_nonzero(cut.is_ground))
    counts = {"n_raw": len(scan.points), N_CLEAN: n_clean, "n_points": n_clean - n_ground}
    measures = {name: getattr(cut, name) for name in _MEASURES}
    measures["removed_share"] = n_ground / n_clean
    of_pair = {f"n_{side}_{name[2:]}": count for name, count in counts.items()}
    of_pair |= {f"ground_{side}_{name}": value for name, value in measures.items()}
    others = {
        "dropped": clean.dropped,
        "axis": cut.axis.tolist(),
        "notes": list(cut.notes),
        OF_PAIR: of_pair,
    }
    return counts | measures | others


def _takes_real(settings: Settings) -> tuple[str, ...]:
    return ("ground",) if settings.ground.shared or settings.ground.peak == "real" else ()


def _real_side(inputs: Inputs) -> tuple[GroundResult | None, FloatArray | None]:
    """The real side's cut and its clean points, for the simulated side; None if it is cut without them."""
    if ("ground", "real") not in inputs.tables:
        return None, None
    metadata = inputs.metadata("ground", "real")
    measures = {name: metadata[name] for name in _MEASURES}
    real = cut_scan(inputs.table("ground", "real"))
    cut = GroundResult(real.is_ground, real.height_m, np.array(metadata["axis"]), **measures)
    return cut, None if inputs.settings.ground.shared else real.points


STAGE = Stage(
    name="ground",
    takes=(SCAN,),
    gives=("ground",),
    settings=("input", "ground"),
    grain=Grain.SIDE,
    version=4,
    make=make_ground,
    libraries=("pypatchworkpp",),
    takes_real=_takes_real,
)
