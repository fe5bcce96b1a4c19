"""Stage causes: the amount of every flaw of the catalogue in a pair, and its surface distance."""

from __future__ import annotations

from dataclasses import asdict
from typing import TYPE_CHECKING, Any

import numpy as np
import pyarrow as pa

from ...schemas.cause_catalogue import CAUSES
from ...schemas.columns import SIDES
from ...schemas.tables import TABLES
from ...stages.arrays import FloatArray, transform_of
from ...stages.sensor_description import SensorDescription
from ..stage import FRAMES, OF_PAIR, Grain, Inputs, JobResult, Metadata, Stage
from .points_job import column, coordinates

if TYPE_CHECKING:
    from ...stages.causes.estimates import Amount
    from ...stages.causes.pose import Pose
    from ...stages.causes.sides import PairScans, Side

POSE = "pose"  #: metadata: fields of `Pose`, None without enough surface in common
POINT_COLUMNS = ("x", "y", "z", "is_ground", "height_m")
_TOO_LITTLE = "the scans have too little surface in common"


def make_causes(inputs: Inputs) -> JobResult:
    """One row per cause of the catalogue."""
    from ...stages.causes.estimates import Amount, estimate, only_known

    with inputs.step("causes"):
        estimates = estimate(pair_scans(inputs))
    if estimates is None:
        amounts = {name: Amount(None, reason=_TOO_LITTLE) for name in CAUSES}
        distances: Metadata = {"surface_distance_m": None, "surface_best_case_m": None}
        pose = None
    else:
        amounts = only_known(estimates.amounts | intensity_amounts(inputs), _doubts(inputs))
        distances = {
            "surface_distance_m": estimates.distance_m,
            "surface_best_case_m": estimates.best_case_m,
        }
        pose = asdict(estimates.pose)
        pose["displacement"]["values"] = estimates.pose.displacement.values.tolist()
    unknown = Amount(None, reason="not estimated")
    rows = [_row(inputs.pair_id, name, amounts.get(name, unknown)) for name in CAUSES]
    return JobResult({"causes": TABLES["causes"].from_rows(rows)}, {OF_PAIR: distances, POSE: pose})


def _doubts(inputs: Inputs) -> dict[str, str]:
    """Doubts about the two sensors and their frames."""
    from ...stages.causes.estimates import doubts_of
    from ...stages.frame_search import FrameCheck
    from ...stages.trust import FRAME

    doubts = doubts_of(*(_sensor(inputs, side) for side in SIDES))
    frames = inputs.metadata("sensor", "sim").get(FRAMES)
    if frames and (doubt := FrameCheck(**frames).doubt):
        doubts[FRAME] = doubt
    return doubts


def _row(pair_id: str, name: str, amount: Amount) -> dict[str, float | str | None]:
    return {"pair_id": pair_id, "cause": name, "unit": CAUSES[name].unit} | vars(amount)


def pair_scans(inputs: Inputs) -> PairScans:
    """Both sides of the pair, from the tables ground and sensor."""
    from ...stages.causes.sides import PairScans

    moved = inputs.metadata("ground", "sim").get("T_real_sim")
    T_real_sim = transform_of(moved)
    return PairScans(_side(inputs, "real"), _side(inputs, "sim", T_real_sim))


def pose_of(metadata: dict[str, Any]) -> Pose | None:
    """The pose that the job has left in its metadata."""
    from ...stages.causes.pose import Pose
    from ...stages.displacement import Displacement

    pose = metadata[POSE]
    if pose is None:
        return None
    displacement = pose["displacement"]
    return Pose(
        Displacement(np.array(displacement["values"]), displacement["seam_deg"]),
        pose["elevation_scale"],
        SensorDescription(**pose["sensor"]),
    )


def _side(inputs: Inputs, side: str, T_real_sim: FloatArray | None = None) -> Side:
    settings = inputs.settings.input
    return side_of(
        inputs.table("ground", side),
        _sensor(inputs, side),
        T_real_sim,
        settings.sensor_position,
        settings.voxel_m,
    )


def _sensor(inputs: Inputs, side: str) -> SensorDescription:
    return SensorDescription(**inputs.metadata("sensor", side)["sensor"])


def side_of(
    ground: pa.Table,
    sensor: SensorDescription,
    T_real_sim: FloatArray | None = None,
    position: tuple[float, float, float] | None = None,
    voxel_m: float | None = None,
) -> Side:
    """A side from its table `ground`, see `recorded_side`."""
    from ...stages.causes.sides import recorded_side

    return recorded_side(
        coordinates(ground),
        column(ground, "is_ground"),
        column(ground, "height_m"),
        sensor,
        T_real_sim,
        position,
        voxel_m,
    )


def intensity_amounts(inputs: Inputs) -> dict[str, Amount]:
    """Amounts of the causes of the intensity, from the scores of the rays; shares are those of the rays compared."""
    from ...stages.causes.estimates import Amount

    scores = inputs.metadata("rays")[OF_PAIR]
    reason = scores["rays_reason"] or scores["intensity_note"] or "intensities were not compared"
    unknown = Amount(None, reason=reason)
    amounts = dict.fromkeys(("intensity by range", "intensity ranks", "intensity scale"), unknown)
    real = scores["intensity_real_by_range"]
    sim = scores["intensity_sim_by_range"]
    if real is not None and sim is not None:
        amounts["intensity by range"] = Amount(sim - real, real, sim)
    is_constant = "constant" in (scores["intensity_note"] or "")  # as of files with an empty column
    if scores["intensity_rank_distance"] is not None and not is_constant:
        amounts["intensity ranks"] = Amount(scores["intensity_rank_distance"])
    if scores["intensity_ratio"] is not None and scores["intensity_rmse"] is not None:
        amounts["intensity scale"] = Amount(1.0 - scores["intensity_ratio"])
    return amounts


STAGE = Stage(
    name="causes",
    takes={"ground": POINT_COLUMNS, "sensor": (), "rays": ()},
    gives=("causes",),
    settings=("input",),
    grain=Grain.PAIR,
    make=make_causes,
    version=7,
    libraries=("scikit-learn",),
)
