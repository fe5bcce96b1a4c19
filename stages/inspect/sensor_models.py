"""Known sensor models: beams and measurement properties, used for ray casting and for recognition."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np


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


# fmt: off
#: VLP-32C: elevation and azimuth offset in degrees, by laser id, as in both public drivers (velodyne, nebula).
_VLP32C_DEG = (
    (-25.000, -1.4), (-1.000, +4.2), (-1.667, -1.4), (-15.639, +1.4),
    (-11.310, -1.4), (+0.000, +1.4), (-0.667, -4.2), (-8.843, +1.4),
    (-7.254, -1.4), (+0.333, +4.2), (-0.333, -1.4), (-6.148, +1.4),
    (-5.333, -4.2), (+1.333, +1.4), (+0.667, -4.2), (-4.000, +1.4),
    (-4.667, -1.4), (+1.667, +4.2), (+1.000, -1.4), (-3.667, +4.2),
    (-3.333, -4.2), (+3.333, +1.4), (+2.333, -1.4), (-2.667, +1.4),
    (-3.000, -1.4), (+7.000, +1.4), (+4.667, -1.4), (-2.333, +4.2),
    (-2.000, -4.2), (+15.000, +1.4), (+10.333, -1.4), (-1.333, +1.4),
)
#: OS1-128: elevations of one unit of the second generation, from its metadata.
_OS1_128_DEG = (
    20.95, 20.67, 20.36, 20.03, 19.73, 19.41, 19.11, 18.76, 18.47, 18.14, 17.82, 17.50, 17.19, 16.86, 16.53, 16.20,
    15.89, 15.56, 15.23, 14.90, 14.57, 14.23, 13.90, 13.57, 13.25, 12.91, 12.57, 12.22, 11.90, 11.55, 11.20, 10.87,
    10.54, 10.18, 9.84, 9.51, 9.15, 8.81, 8.47, 8.11, 7.78, 7.43, 7.08, 6.74, 6.39, 6.04, 5.70, 5.34,
    4.98, 4.64, 4.29, 3.93, 3.58, 3.24, 2.88, 2.53, 2.17, 1.82, 1.47, 1.12, 0.78, 0.41, 0.07, -0.28,
    -0.64, -0.99, -1.35, -1.70, -2.07, -2.40, -2.75, -3.11, -3.46, -3.81, -4.15, -4.50, -4.86, -5.22, -5.57, -5.90,
    -6.27, -6.61, -6.97, -7.30, -7.67, -8.01, -8.35, -8.69, -9.05, -9.38, -9.71, -10.07, -10.42, -10.76, -11.09, -11.43,
    -11.78, -12.12, -12.46, -12.78, -13.15, -13.46, -13.80, -14.12, -14.48, -14.79, -15.11, -15.46,
    -15.79, -16.12, -16.45, -16.76, -17.11, -17.44, -17.74, -18.06, -18.39, -18.72, -19.02, -19.32,
    -19.67, -19.99, -20.27, -20.57, -20.92, -21.22, -21.54, -21.82,
)
#: Pandar64: design values of elevation.
_PANDAR64_DEG = (
    14.882, 11.032, 8.059, 5.057, 3.040, 2.028, 1.860, 1.688, 1.522, 1.351, 1.184, 1.013, 0.846, 0.675, 0.508, 0.337,
    0.169, 0.000, -0.169, -0.337, -0.508, -0.675, -0.845, -1.013, -1.184, -1.351, -1.522, -1.688, -1.860, -2.028,
    -2.198, -2.365, -2.536, -2.700, -2.873, -3.040, -3.210, -3.375, -3.548, -3.712, -3.884, -4.050, -4.221, -4.385,
    -4.558, -4.720, -4.892, -5.057, -5.229, -5.391, -5.565, -5.726, -5.898, -6.061, -7.063, -8.059, -9.060, -9.885,
    -11.032, -12.006, -12.974, -13.930, -18.889, -24.897,
)
_PANDAR40P_DEG = (
    15.00, 11.00, 8.00, 5.00, 3.00, 2.00, 1.67, 1.33, 1.00, 0.67, 0.33, 0.00, -0.33, -0.67, -1.00, -1.33, -1.66, -2.00,
    -2.33, -2.67, -3.00, -3.33, -3.67, -4.00, -4.33, -4.67, -5.00, -5.33, -5.67, -6.00, -7.00, -8.00, -9.00, -10.00,
    -11.00, -12.00, -13.00, -14.00, -19.00, -25.00,
)
# fmt: on
_DEG_PER_S = 600 / 60 * 360.0


def _even(highest_deg: float, lowest_deg: float, n: int) -> tuple[float, ...]:
    """Evenly spaced elevations."""
    return tuple(np.linspace(highest_deg, lowest_deg, n).tolist())


_VLP16 = SensorModel(
    "vlp16",
    _even(-15.0, 15.0, 16),
    (0.0,) * 16,
    55.296e-6 * _DEG_PER_S,
    title="Velodyne VLP-16",
    source="velodyne_decoder, calibrations/VLP-16.yml; nebula, calibration/velodyne/VLP16.yaml",
    focal_m=0.04191,
)
_PANDAR64 = SensorModel(
    "pandar64",
    _PANDAR64_DEG,
    (-1.042,) * 6 + (1.042, 3.125, 5.208, -5.208, -3.125, -1.042) * 8 + (-1.042,) * 10,
    0.2,
    min_range_m=0.3,
    max_range_m=200.0,
    range_noise_m=0.02,
    range_quantum_m=0.004,
    title="Hesai Pandar64",
    source="HesaiLidar_General_SDK, pandarGeneral_internal.cc",
    unit_deg=0.2,
    column_deg=0.2,
)
_XT32 = SensorModel(
    "xt32",
    _even(15.0, -16.0, 32),
    (0.0,) * 32,
    0.18,
    min_range_m=0.05,
    max_range_m=120.0,
    range_noise_m=0.005,
    range_quantum_m=0.004,
    title="Hesai PandarXT-32",
    source="PandarXT-32 user manual; nebula, calibration PandarXT32.csv",
    unit_deg=0.2,
    column_deg=0.09,
)

#: Sensors by name. Firing cycle at 600 rpm: 55.296 us (VLP-16, VLP-32C), 46.08 us (HDL-32E), 48 us (HDL-64E).
#: HDL-64E: nominal angles, as each unit has its own calibration. Ouster: 2048 columns. CARLA: its ray_cast sensor with
#: default field of view, channels and drop-off; the usual 100 m and 0.2 degrees for 10 m and 2. Range, noise and
#: quantum are those of the data sheets; signal_range_m of what was not measured here is that of the HDL-64E. Focal
#: distances: velodyne_decoder, calib_db.cpp.
_ALL = (
    SensorModel(
        "vlp32c",
        tuple(elevation for elevation, _ in _VLP32C_DEG),
        tuple(offset for _, offset in _VLP32C_DEG),
        55.296e-6 * _DEG_PER_S,
        max_range_m=200.0,
        range_quantum_m=0.004,
        signal_range_m=65.0,
        title="Velodyne VLP-32C",
        source="VLP-32C user manual 63-9325; velodyne_decoder, calibrations/VLP-32C.yml; nebula",
        focal_m=0.0424,
    ),
    SensorModel(
        "hdl64",
        (*_even(2.0, -8.333, 32), *_even(-8.833, -24.333, 32)),
        (0.0,) * 64,
        48e-6 * _DEG_PER_S,
        min_range_m=0.9,
        max_range_m=120.0,
        range_noise_m=0.02,
        title="Velodyne HDL-64E",
        source="HDL-64E S3 manual 63-HDL64ES3 (1/3 degree above, 1/2 degree below)",
        unit_deg=1.0,
    ),
    SensorModel(
        "os1-64",
        _even(16.611, -16.611, 64),
        (-3.164, -1.055, 1.055, 3.164) * 16,
        360.0 / 2048,
        min_range_m=0.8,
        max_range_m=120.0,
        range_quantum_m=0.001,
        signal_range_m=55.0,
        title="Ouster OS1-64 (gen 1)",
        source="ouster-sdk, gen1_altitude_angles",
        unit_deg=0.6,
        column_deg=360.0 / 2048,
    ),
    SensorModel(
        "carla",
        _even(10.0, -30.0, 32),
        (0.0,) * 32,
        0.2,
        min_range_m=0.1,
        range_noise_m=0.0,
        range_quantum_m=0.0,
        lost_share=0.45,
        signal_range_m=1e4,
        title="CARLA's default channels",
        source="CARLA, LidarDescription.h (Channels, UpperFovLimit, LowerFovLimit)",
    ),
    _VLP16,
    replace(
        _VLP16,
        name="vlp16-hires",
        elevation_deg=_even(-10.0, 10.0, 16),
        title="Velodyne Puck Hi-Res",
        source="velodyne_decoder, calibrations/Puck Hi-Res.yml",
    ),
    SensorModel(
        "hdl32",
        tuple((4.0 / 3.0 * np.arange(-23, 9)).tolist()),
        (0.0,) * 32,
        46.08e-6 * _DEG_PER_S,
        range_noise_m=0.02,
        title="Velodyne HDL-32E",
        source="ros-drivers/velodyne, velodyne_pointcloud/params/32db.yaml",
        focal_m=0.02883,
    ),
    SensorModel(
        "os1-128",
        _OS1_128_DEG,
        (4.2, 1.4, -1.4, -4.2) * 32,
        360.0 / 2048,
        min_range_m=0.5,
        max_range_m=120.0,
        range_quantum_m=0.001,
        title="Ouster OS1-128",
        source="ouster-sdk, tests/pcaps/OS-1-128_v2.3.0_1024x10.json (one unit)",
        unit_deg=0.6,
        column_deg=360.0 / 2048,
    ),
    _PANDAR64,
    replace(
        _PANDAR64,
        name="pandar40p",
        elevation_deg=_PANDAR40P_DEG,
        azimuth_offset_deg=(-1.042,) * 6 + (3.125, -5.208, -1.042) * 8 + (-1.042,) * 10,
        title="Hesai Pandar40P",
    ),
    _XT32,
    replace(
        _XT32,
        name="xt16",
        elevation_deg=_even(15.0, -15.0, 16),
        azimuth_offset_deg=(0.0,) * 16,
        title="Hesai PandarXT-16",
        source="PandarXT-16 user manual; nebula, calibration PandarXT16.csv",
    ),
)
SENSORS = {sensor.name: sensor for sensor in _ALL}
