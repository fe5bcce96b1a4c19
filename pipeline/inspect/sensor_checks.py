"""The sensors of both sides of a dataset, estimated from some of its scans."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass

from ...schemas.columns import SIDES
from ...schemas.settings import InputSettings
from ...stages.clean import as_ros
from ...stages.inspect.sensor_description import SensorDescription, describe_sensor, differences, unlike_others
from ..datasets.pairs import ScanPair
from ..datasets.readers.scan import Scan


@dataclass(frozen=True)
class SensorCheck:
    """Sensors of both sides.

    pair_ids : pairs whose scans were described
    sides : by side, the most frequent sensor; a side none of whose files can be read is left out
    differences : one line for each property in which the sides differ
    unlike : one line for each scan whose sensor is not that of the other scans of its side
    """

    pair_ids: tuple[str, ...]
    sides: dict[str, SensorDescription]
    differences: list[str]
    unlike: list[str]


class SensorSamples:
    """Sensors of a sample of pairs.

    Scans are neither cleaned nor moved, only their axes are converted: beams are those of a sensor only in its frame.

    pair_ids : pairs to describe
    """

    def __init__(self, pair_ids: Collection[str], settings: InputSettings) -> None:
        self._pair_ids, self._settings = pair_ids, settings
        self._sensors: dict[str, dict[str, SensorDescription]] = {side: {} for side in SIDES}

    def add(self, pair: ScanPair, scans: Mapping[str, Scan]) -> None:
        """Describe the scans of a pair, if it is in the sample."""
        for side, scan in scans.items():
            if pair.pair_id in self._pair_ids and len(scan.points):
                points = as_ros(scan.points, self._settings.frame_of(side))
                self._sensors[side][pair.pair_id] = describe_sensor(points, scan.rings, scan.times_s is not None)

    def check(self) -> SensorCheck:
        """Compare the sensors of both sides, and those of each side among its pairs."""
        sides, unlike = {}, []
        for side, sensors in self._sensors.items():
            if sensors:
                usual, lines = unlike_others(sensors)
                sides[side] = sensors[usual]
                unlike += [f"{'real' if side == 'real' else 'simulated'} scan of pair {line}" for line in lines]
        found = differences(sides["real"], sides["sim"]) if len(sides) == len(SIDES) else []
        pair_ids = sorted({pair_id for sensors in self._sensors.values() for pair_id in sensors})
        return SensorCheck(tuple(pair_ids), sides, found, unlike)
