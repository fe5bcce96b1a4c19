"""Ray casting: directions of a sensor's beams, their first hits, and the measurements of these.

A static scene, a sensor that does not move during its revolution, one return per pulse.
"""

from __future__ import annotations

from dataclasses import dataclass
from importlib.util import find_spec

import numpy as np

from ...schemas.errors import FidpipeError
from ...schemas.sensor_models import SensorModel
from ..arrays import FloatArray, IndexArray


@dataclass(frozen=True)
class Hits:
    """First hits of rays; rays without a hit have no row.

    ray_ids, face_ids : (m,) intp, the ray and the triangle; ray_ids ascend
    range_m : (m,) float64, from the sensor
    cos_incidence : (m,) float64, 1 where the surface faces the sensor, 0 where the ray grazes it
    """

    ray_ids: IndexArray
    face_ids: IndexArray
    range_m: FloatArray
    cos_incidence: FloatArray


def fire(
    sensor: SensorModel, start_deg: float = 0.0, step_deg: float | None = None
) -> FloatArray:
    """The beams of one revolution, clockwise seen from above: (n, 3) unit vectors.

    They come firing by firing, in each firing laser by laser; x is forward, y is left.

    Firing c has the azimuth start - c step; laser i has that plus its azimuth offset, and its
    elevation. The number of firings is the largest that fits into 360 degrees.

    Parameters
    ----------
    sensor : elevations and offsets, by laser
    start_deg : azimuth of the first firing
    step_deg : by default the sensor's own

    Examples
    --------
    >>> from ...schemas.sensor_models import SENSORS
    >>> beams = fire(SENSORS["vlp32c"])
    >>> len(beams) // 32, round(float(np.degrees(np.arcsin(beams[3, 2]))), 3)
    (1808, -15.639)
    """
    step_deg = sensor.azimuth_step_deg if step_deg is None else step_deg
    firing_deg = start_deg - step_deg * np.arange(max(1, int(360.0 / step_deg)))
    azimuth = np.radians(firing_deg[:, None] + np.array(sensor.azimuth_offset_deg)).ravel()
    elevation = np.tile(np.radians(sensor.elevation_deg), len(firing_deg))
    level = np.cos(elevation)
    return np.column_stack(
        [level * np.cos(azimuth), level * np.sin(azimuth), np.sin(elevation)]
    )


def require_ray_caster() -> None:
    """Check that rays can be cast.

    Raises
    ------
    FidpipeError
        embreex, the ray casting library, is not installed.
    """
    if find_spec("embreex") is None:
        raise FidpipeError(
            'ray casting requires embreex, which is not installed; install it with: pip install "fidpipe[synth]"',
        )


def cast_rays(triangles: FloatArray, directions: FloatArray) -> Hits:
    """The first hit of each ray from the origin, on the front or the back of a triangle.

    Parameters
    ----------
    triangles : (f, 3, 3) float64, corners in metres, sensor frame; at least one
    directions : (n, 3) float64, unit vectors; at least one

    Raises
    ------
    FidpipeError
        embreex is not installed.

    Examples
    --------
    >>> wall = np.array([[[10.0, -5, -5], [10, 5, -5], [10, 0, 5]]])
    >>> cast_rays(wall, np.array([[1.0, 0, 0], [-1, 0, 0]])).range_m.round(6).tolist()
    [10.0]
    """
    require_ray_caster()
    from trimesh import Trimesh

    corners = triangles.reshape(-1, 3)
    mesh = Trimesh(corners, np.arange(len(corners)).reshape(-1, 3), process=False)
    places, ray_ids, face_ids = mesh.ray.intersects_location(
        np.zeros_like(directions), directions, multiple_hits=False
    )
    range_m = np.linalg.norm(places, axis=1)
    cos_incidence = np.abs((mesh.face_normals[face_ids] * directions[ray_ids]).sum(axis=1))
    return Hits(ray_ids.astype(np.intp), face_ids.astype(np.intp), range_m, cos_incidence)


def return_probability(
    sensor: SensorModel,
    range_m: FloatArray,
    cos_incidence: FloatArray,
    reflectivity: FloatArray,
) -> FloatArray:
    """The probability that a pulse that hits a surface is detected; it never rises with the range.

    P = (1 - lost_share) (1 - exp(-s)), s = reflectivity sqrt(cos_incidence) (signal_range_m /
    range_m)^2: the signal of a surface that fills the beam (LiDAR equation) against a threshold
    that fluctuates exponentially. The root models roughness: a road returns more of a grazing beam
    than Lambert's law predicts.

    Parameters
    ----------
    range_m, cos_incidence, reflectivity : (n,) float64
    """
    near = sensor.signal_range_m / np.maximum(range_m, sensor.min_range_m)
    signal = reflectivity * np.sqrt(cos_incidence) * near**2
    return (1.0 - sensor.lost_share) * -np.expm1(-signal)


def measure_ranges(
    sensor: SensorModel,
    range_m: FloatArray,
    rng: np.random.Generator,
) -> FloatArray:
    """Measured ranges: with Gaussian noise along the ray, then rounded to the sensor's quantum, if it has one.

    Parameters
    ----------
    range_m : (n,) float64, true ranges
    rng : of the noise
    """
    noisy: FloatArray = range_m + rng.normal(0.0, sensor.range_noise_m, len(range_m))
    if not sensor.range_quantum_m:
        return noisy
    return np.round(noisy / sensor.range_quantum_m) * sensor.range_quantum_m
