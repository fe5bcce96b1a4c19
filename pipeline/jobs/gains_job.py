"""Stage gains: how much closer the surfaces of a pair come if each cause of the run is corrected.

It is not part of a run: `fidpipe diagnose` requests it, with the mean amounts of the causes that
the run names.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ...stages.causes.gain import Shares, corrections, shares
from ..stage import (
    AMOUNTS,
    DISTANCES,
    OF_PAIR,
    UNEXPLAINED,
    Inputs,
    JobResult,
    Stage,
)
from .causes_job import pair_scans, pose_of

SEED = 20240917  #: of corrections at random


def make_gains(inputs: Inputs) -> JobResult:
    """One row per cause that can be corrected, and one for what remains; arguments: (name, mean amount) of each."""
    amounts = dict(inputs.arguments)
    pose = pose_of(inputs.metadata("causes"))
    if pose is None:
        return _result(inputs, Shares(0.0, 0.0, 0.0, {}))
    scans = pair_scans(inputs)
    rng = np.random.default_rng(SEED)
    causes = inputs.table("causes")
    of_pair = {row["cause"]: row["amount"] for row in causes.to_pylist()}
    with inputs.step("gains"):
        made = corrections(scans, pose, of_pair, amounts, rng)
        best_case_m = inputs.metadata("causes")[OF_PAIR]["surface_best_case_m"]
        gains = shares(scans, made, pose.displacement.seam_deg, rng, best_case_m)
    return _result(inputs, gains)


def _result(inputs: Inputs, gains: Shares) -> JobResult:
    gain_m = gains.by_cause | {UNEXPLAINED: gains.after_m - gains.best_case_m}
    rows = [{"cause": name, "gain_m": value} for name, value in gain_m.items()]
    metadata = {
        DISTANCES: [gains.before_m, gains.after_m, gains.best_case_m],
        AMOUNTS: dict(inputs.arguments),
    }
    return JobResult(inputs.rows("gains", rows), metadata)


def gains_stage(amounts: dict[str, float]) -> Stage:
    """The stage for causes with these mean amounts."""
    return replace(STAGE, arguments=tuple(sorted(amounts.items())))


STAGE = Stage(
    name="gains",
    takes=("ground", "sensor", "causes"),
    gives=("gains",),
    settings=("input",),
    make=make_gains,
    is_wanted=lambda settings: False,
)
