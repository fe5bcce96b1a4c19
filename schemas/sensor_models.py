"""Known sensor models: beams and measurement properties, used for ray casting and for recognition."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import cycle, islice

import numpy as np

from .data_files import read_data


@dataclass(frozen=True)
class SensorModel:
    """A spinning LiDAR.

    elevation_deg, azimuth_offset_deg : by laser; the offset is added to the azimuth of the firing
    azimuth_step_deg : angle between two firings
    min_range_m, max_range_m : returns outside are not reported
    range_noise_m : standard deviation along the ray
    range_quantum_m : ranges are multiples of it; 0 for any
    lost_share : share of the pulses that are lost on any surface
    signal_range_m : range at which a white surface facing the sensor returns 63 % of the pulses
    title : maker and model
    source : publication of the elevations
    unit_deg : offset of the elevations of a single unit (in its calibration) from the table; 0 if drivers use the table
        for every unit
    focal_m : distance from the axis at which its beams cross, which drivers may correct; 0 if unknown
    column_deg : azimuth steps are multiples of it; 0 if the rotation rate determines them
    """

    name: str
    elevation_deg: tuple[float, ...]
    azimuth_offset_deg: tuple[float, ...]
    azimuth_step_deg: float
    min_range_m: float = 1.0
    max_range_m: float = 100.0
    range_noise_m: float = 0.03
    range_quantum_m: float = 0.002
    lost_share: float = 0.03
    signal_range_m: float = 60.0
    title: str = ""
    source: str = ""
    unit_deg: float = 0.0
    focal_m: float = 0.0
    column_deg: float = 0.0

    @property
    def n_beams(self) -> int:
        """Number of lasers."""
        return len(self.elevation_deg)


def _read_sensors() -> Iterator[SensorModel]:
    for name, values in read_data("sensor_models").items():
        blocks = values.pop("uniform", [])
        elevation = values.pop(
            "elevation_deg",
            [angle for block in blocks for angle in np.linspace(*block).tolist()],
        )
        offset = islice(cycle(values.pop("azimuth_offset_deg", [0.0])), len(elevation))
        yield SensorModel(name, tuple(elevation), tuple(offset), **values)


#: Known sensors by name, from `sensor_models.toml`.
SENSORS = {sensor.name: sensor for sensor in _read_sensors()}
