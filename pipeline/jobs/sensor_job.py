"""Stage sensor: beams, steps, noise and losses of the sensor of a side, estimated from the file's inputs points.

The job of the simulated side also checks whether both scans are in one frame.
"""

from __future__ import annotations

from ...stages.arrays import transform_of
from ...stages.clean import at_sensor
from ...stages.frame_search import FrameCheck, check_frames
from ...stages.sensor_description import describe_sensor, pair_columns, sensor_row
from ..datasets.readers.scan import Scan
from ..stage import FRAMES, OF_PAIR, SCAN, Grain, Inputs, JobResult, Metadata, Stage


def make_sensor(inputs: Inputs) -> JobResult:
    """Estimate the sensor of a side in the side's inputs frame; the metadata contain the whole description."""
    with inputs.step("read"):
        scan = inputs.scans[inputs.part]()
    points = at_sensor(scan.points, inputs.part, inputs.settings.input)
    with inputs.step("sensor"):
        sensor = describe_sensor(points, scan.rings)
    metadata: Metadata = {"sensor": sensor, OF_PAIR: pair_columns(sensor, inputs.part)}
    if inputs.part == "sim" and "real" in inputs.scans:
        metadata[FRAMES] = _frame_check(inputs, scan)
    return JobResult(inputs.rows("sensor", [sensor_row(sensor)]), metadata)


def _frame_check(inputs: Inputs, sim: Scan) -> FrameCheck | None:
    """Comparison of both scans' frames."""
    with inputs.step("read"):
        real = inputs.scans["real"]()
    with inputs.step("frames"):
        T_real_sim = transform_of(inputs.T_real_sim)
        return check_frames(real.points, sim.points, inputs.settings.input, T_real_sim)


STAGE = Stage(
    name="sensor",
    takes=(SCAN,),
    gives=("sensor",),
    settings=("input",),
    grain=Grain.SIDE,
    make=make_sensor,
    takes_real=lambda settings: (SCAN,),
    version=14,
)
