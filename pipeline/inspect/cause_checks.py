"""Causes that a few pairs of a dataset show: the jobs of a run in memory, and the same rules."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields

from ...schemas.errors import StageError
from ...schemas.settings import Settings
from ...stages.causes.estimates import Amount
from ...stages.sensor_description import SensorDescription
from ..datasets.pairs import ScanPair
from ..datasets.readers.scan import Scan
from ..engine.pool import one_blas_thread
from ..engine.worker import run_in_memory
from ..jobs import STAGES

#: Most pairs whose causes are estimated: each takes a few seconds.
MOST_PAIRS = 3
_STAGES = ("ground", "sensor", "rays", "causes")


def estimate_causes(
    pair: ScanPair, scans: Mapping[str, Scan], settings: Settings
) -> tuple[dict[str, Amount], dict[str, SensorDescription]]:
    """Amounts of the causes of a pair, and the sensors of both sides; {} if one of its jobs fails."""
    stages = [stage for stage in STAGES if stage.name in _STAGES]
    with one_blas_thread():
        try:
            tables, outputs = run_in_memory(stages, settings, pair=pair, scans=scans)
        except StageError:
            return {}, {}
    amounts = {}
    for row in tables["causes", ""].to_pylist():
        amounts[row["cause"]] = Amount(*(row[field.name] for field in fields(Amount)))
    sensors = {side: SensorDescription(**outputs["sensor", side]["sensor"]) for side in scans}
    return amounts, sensors
