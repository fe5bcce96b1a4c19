"""Causes that a few pairs of a dataset show: the jobs of a run in memory, and the same rules."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields

import numpy as np

from ...schemas.errors import StageError
from ...schemas.results import Cause, Unknown
from ...schemas.settings import Settings
from ...stages.causes.estimates import Amount
from ...stages.sensor_description import SensorDescription
from ...stages.statistics.comparison import blocks_of
from ..datasets.pairs import ScanPair
from ..datasets.readers.scan import Scan
from ..engine.pool import one_blas_thread
from ..engine.worker import run_in_memory
from ..jobs import STAGES
from ..results.causes import cause_values, named_causes, unknown_causes

#: Most pairs whose causes are estimated: each takes a few seconds.
MOST_PAIRS = 3
_STAGES = ("ground", "sensor", "rays", "causes")


@dataclass(frozen=True)
class CauseCheck:
    """Causes of some pairs.

    pair_ids : pairs that were estimated
    causes : named ones; those that affect most of the surface first
    unknown : causes that cannot be estimated
    """

    pair_ids: tuple[str, ...]
    causes: tuple[Cause, ...]
    unknown: tuple[Unknown, ...]


@dataclass(frozen=True)
class PairSample:
    """Sensors of both sides of a pair, and amounts of its causes.

    content : hash of the real scan; copies count once
    """

    pair: ScanPair
    content: str
    sensors: dict[str, SensorDescription]
    amounts: dict[str, Amount]


def evenly_chosen(pair_ids: Sequence[str]) -> set[str]:
    """A few of some pairs."""
    n_chosen = min(len(pair_ids), MOST_PAIRS)
    rows = np.linspace(0, len(pair_ids) - 1, n_chosen).round().astype(int)
    return {pair_ids[row] for row in rows}


def sample_pair(
    pair: ScanPair, scans: Mapping[str, Scan], content: str, settings: Settings
) -> PairSample | None:
    """Run the jobs of a pair; None if one of them fails."""
    stages = [stage for stage in STAGES if stage.name in _STAGES]
    with one_blas_thread():
        try:
            tables, outputs = run_in_memory(stages, settings, pair=pair, scans=scans)
        except StageError:
            return None
    amounts = {}
    for row in tables["causes", ""].to_pylist():
        amounts[row["cause"]] = Amount(*(row[field.name] for field in fields(Amount)))
    sensors = {side: SensorDescription(**outputs["sensor", side]["sensor"]) for side in scans}
    return PairSample(pair, content, sensors, amounts)


def check_causes(samples: Sequence[PairSample]) -> CauseCheck:
    """The causes that some pairs show."""
    times_s = [sample.pair.timestamp_s for sample in samples]
    blocks = blocks_of([sample.content for sample in samples], times_s)
    values = cause_values([sample.amounts for sample in samples])
    return CauseCheck(
        tuple(sample.pair.pair_id for sample in samples),
        tuple(named_causes(values, blocks)),
        tuple(unknown_causes(values)),
    )
