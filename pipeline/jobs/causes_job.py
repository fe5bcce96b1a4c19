"""Stage causes: the amount of every flaw of the catalogue in a pair, and its surface distance."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from ...schemas.cause_catalogue import CAUSES
from ...schemas.columns import SIDES
from ...stages.arrays import transform_of
from ...stages.sensor_description import SensorDescription
from ..stage import FRAMES, OF_PAIR, Inputs, JobResult, Metadata, Stage
from .points_job import cut_scan, sensor_of

if TYPE_CHECKING:
    from ...stages.causes.estimates import Amount
    from ...stages.causes.pose import Pose
    from ...stages.causes.sides import PairScans

POSE = "pose"  #: metadata: fields of `Pose`, None without enough surface in common
_TOO_LITTLE = "the scans have too little surface in common"


def make_causes(inputs: Inputs) -> JobResult:
    """One row per cause of the catalogue."""
    from ...stages.causes.estimates import Amount, estimate, only_known

    with inputs.step("causes"):
        estimates = estimate(pair_scans(inputs))
    unknown = Amount(None, reason=_TOO_LITTLE)
    amounts: dict[str, Amount] = {}
    distances: Metadata = {"surface_distance_m": None, "surface_best_case_m": None}
    pose = None
    if estimates is not None:
        amounts = only_known(estimates.amounts | intensity_amounts(inputs), _doubts(inputs))
        distances["surface_distance_m"] = estimates.distance_m
        distances["surface_best_case_m"] = estimates.best_case_m
        pose = estimates.pose
        unknown = Amount(None, reason="not estimated")
    rows = []
    for name, cause in CAUSES.items():
        rows.append({"cause": name, "unit": cause.unit} | vars(amounts.get(name, unknown)))
    return JobResult(inputs.rows("causes", rows), {OF_PAIR: distances, POSE: pose})


def _doubts(inputs: Inputs) -> dict[str, str]:
    """Doubts about the two sensors and their frames."""
    from ...stages.causes.estimates import doubts_of
    from ...stages.frame_search import FrameCheck
    from ...stages.trust import FRAME

    doubts = doubts_of(*(sensor_of(inputs, side) for side in SIDES))
    frames = inputs.metadata("sensor", "sim").get(FRAMES)
    if frames and (doubt := FrameCheck(**frames).doubt):
        doubts[FRAME] = doubt
    return doubts


def pair_scans(inputs: Inputs) -> PairScans:
    """Both sides of the pair, from the tables ground and sensor."""
    from ...stages.causes.sides import PairScans, recorded_side

    settings = inputs.settings.input
    sides = []
    for side in SIDES:
        scan = cut_scan(inputs.table("ground", side))
        T_real_sim = transform_of(inputs.metadata("ground", side).get("T_real_sim"))
        position = settings.sensor_position
        sensor = sensor_of(inputs, side)
        sides.append(recorded_side(scan, sensor, T_real_sim, position, settings.voxel_m))
    return PairScans(*sides)


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


def intensity_amounts(inputs: Inputs) -> dict[str, Amount]:
    """Amounts of the causes of the intensity, from the scores of the rays; shares are those of the rays compared."""
    from ...stages.causes.estimates import Amount

    scores = inputs.metadata("rays")[OF_PAIR]
    reason = (
        scores["rays_reason"] or scores["intensity_note"] or "intensities were not compared"
    )
    unknown = Amount(None, reason=reason)
    amounts = dict.fromkeys(
        ("intensity by range", "intensity ranks", "intensity scale"), unknown
    )
    real = scores["intensity_real_by_range"]
    sim = scores["intensity_sim_by_range"]
    if real is not None and sim is not None:
        amounts["intensity by range"] = Amount(sim - real, real, sim)
    # as of files with an empty column
    is_constant = "constant" in (scores["intensity_note"] or "")
    if scores["intensity_rank_distance"] is not None and not is_constant:
        amounts["intensity ranks"] = Amount(scores["intensity_rank_distance"])
    if scores["intensity_ratio"] is not None and scores["intensity_rmse"] is not None:
        amounts["intensity scale"] = Amount(1.0 - scores["intensity_ratio"])
    return amounts


STAGE = Stage(
    name="causes",
    takes=("ground", "sensor", "rays"),
    gives=("causes",),
    settings=("input",),
    make=make_causes,
    version=13,
    libraries=("scikit-learn",),
)
