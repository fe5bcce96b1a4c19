"""Stage sensor: beams, steps, noise and losses of the sensor of a side, estimated from the file's own points."""

from __future__ import annotations

from dataclasses import asdict

from ...schemas.tables import SENSOR
from ...stages.clean import as_ros
from ...stages.inspect.sensor import SensorFacts, describe_sensor, pair_columns, sensor_row
from ..stage import OF_PAIR, SCAN, Grain, Inputs, JobResult, Stage


def make_sensor(own: Inputs) -> JobResult:
    """Estimate the sensor of a side in the side's own frame."""
    with own.step("read"):
        scan = own.scans[own.part]()
    points = as_ros(scan.points, own.settings.input.frame_of(own.part))
    with own.step("sensor"):
        sensor = describe_sensor(points, scan.rings, scan.times_s is not None)
    return sensor_result(own.pair_id, own.part, sensor)


def sensor_result(pair_id: str, side: str, sensor: SensorFacts) -> JobResult:
    """One row; the facts have the whole description."""
    row = {"pair_id": pair_id, "side": side} | sensor_row(sensor)
    facts = {"sensor": asdict(sensor), OF_PAIR: pair_columns(sensor, side)}
    return JobResult({"sensor": SENSOR.build(row, 1)}, facts)


STAGE = Stage(
    name="sensor", takes={SCAN: ()}, gives=("sensor",), settings=("input",), grain=Grain.SIDE, make=make_sensor
)
