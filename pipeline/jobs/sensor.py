"""Stage sensor: beams, steps, noise and losses of the sensor of a side, estimated from the file's own points."""

from __future__ import annotations

from dataclasses import asdict

from ...schemas.tables import SENSOR
from ...stages.clean import as_ros
from ...stages.inspect.sensor import describe_sensor, pair_columns, sensor_row
from ..stage import SCAN, Context, Grain, Made, Stage


def make_sensor(context: Context) -> Made:
    """One row; the facts have the whole description and the side's columns of `pairs`."""
    with context.step("read"):
        scan = context.scan()
    points = as_ros(scan.points, context.settings.input.frame_of(context.side))
    with context.step("sensor"):
        sensor = describe_sensor(points, scan.rings, scan.times_s is not None)
    row = {"pair_id": context.pair_id, "side": context.side} | sensor_row(sensor)
    return Made(
        {"sensor": SENSOR.build(row, 1)}, {"sensor": asdict(sensor), "pairs": pair_columns(sensor, context.side)}
    )


STAGE = Stage(
    name="sensor", takes={SCAN: ()}, gives=("sensor",), settings=("input",), grain=Grain.SIDE, make=make_sensor
)
