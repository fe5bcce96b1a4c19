"""The two scans of a pair: of a street by the real sensor, and of its flawed twin by a simulator."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.random import Generator

from ...schemas.sensor_models import SensorModel
from ..arrays import Float32Array, IndexArray
from .ray_casting import cast_rays, fire, measure_ranges, return_probability
from .streets import MAX_DENSITY, Scene, build_street, build_twin

_PILOT = 8  # a pilot scan has every 8th firing of the sensor
_SPREAD_DEG = 0.3  # of further beams about those of the sensor
_SIM_NOISE_M = 0.01
_SIM_RANGE_M = 120.0
_SIM_ATTENUATION_PER_M = 0.004


@dataclass(frozen=True)
class SynthScan:
    """One scan with the object of each point.

    rows : (n, 4) float32, x, y, z in metres, sensor frame, and intensity
    object_ids : (n,) intp, index in the scene; for an invented surface, that of the object it hangs
        on
    """

    rows: Float32Array
    object_ids: IndexArray


@dataclass(frozen=True)
class SynthPair:
    """The scans of one street.

    kinds : class of each object of the scene, by object id
    """

    real: SynthScan
    sim: SynthScan
    kinds: tuple[str, ...]


def make_pair(
    seed: int, index: int, sensor: SensorModel, n_points: int | None = None
) -> SynthPair:
    """Scans of one street by the real sensor and by the simulator; they depend on the arguments alone.

    Parameters
    ----------
    seed, index : of the dataset, and of the pair in it
    sensor : of both sides
    n_points : approximate size of the real scan; by default as the sensor's azimuth step results in
    """
    from threadpoolctl import threadpool_limits

    scene_seed, real_seed, twin_seed, sim_seed = np.random.SeedSequence((seed, index)).spawn(4)
    with threadpool_limits(1):  # or the last bits would differ between machines
        street = build_street(np.random.default_rng(scene_seed))
        twin = build_twin(street, np.random.default_rng(twin_seed))
        step_deg = sensor.azimuth_step_deg
        if n_points is not None:
            pilot_deg = _PILOT * step_deg
            pilot = _scan_street(street, sensor, pilot_deg, np.random.default_rng(real_seed))
            step_deg = pilot_deg * max(len(pilot.rows), 1) / n_points
        real = _scan_street(street, sensor, step_deg, np.random.default_rng(real_seed))
        sim = _scan_twin(twin, sensor, step_deg, np.random.default_rng(sim_seed))
    return SynthPair(real, sim, street.kinds)


def _scan_street(
    street: Scene, sensor: SensorModel, step_deg: float, rng: Generator
) -> SynthScan:
    """The real scan, with undetected hits, range noise and quantum; intensity is reflectivity, 0-255."""
    directions = fire(sensor, rng.uniform(0.0, 360.0), step_deg)
    hits = cast_rays(street.triangles, directions)
    object_ids = street.object_ids[hits.face_ids]
    reflectivity = street.reflectivity[object_ids]
    detected = return_probability(sensor, hits.range_m, hits.cos_incidence, reflectivity)
    range_m = measure_ranges(sensor, hits.range_m, rng)
    is_kept = rng.uniform(size=len(range_m)) < detected
    is_kept &= (range_m >= sensor.min_range_m) & (range_m <= sensor.max_range_m)
    speckled = reflectivity * rng.normal(1.0, 0.15, len(range_m))
    intensity = np.clip(np.round(255.0 * speckled), 0.0, 255.0)
    points = directions[hits.ray_ids] * range_m[:, None]
    rows = np.column_stack([points, intensity]).astype(np.float32)
    return SynthScan(rows[is_kept], object_ids[is_kept])


def _scan_twin(twin: Scene, sensor: SensorModel, step_deg: float, rng: Generator) -> SynthScan:
    """The simulated scan: every hit is detected, then each object gets its own density.

    Of the points on an object of density below 1 that share is kept. An object of higher density
    gets points of further beams, which are cast around those of the sensor. Intensity is
    exp(-a range), as in CARLA.
    """
    directions = np.repeat(fire(sensor, rng.uniform(0.0, 360.0), step_deg), MAX_DENSITY, axis=0)
    is_further = np.arange(len(directions)) % MAX_DENSITY > 0
    shift = rng.normal(0.0, np.radians(_SPREAD_DEG), directions.shape)
    directions += is_further[:, None] * shift
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    hits = cast_rays(twin.triangles, directions)
    object_ids = twin.object_ids[hits.face_ids]
    density = twin.density[object_ids]
    further_share = (density - 1.0) / (MAX_DENSITY - 1)
    share = np.where(is_further[hits.ray_ids], further_share, density)
    range_m = hits.range_m + rng.normal(0.0, _SIM_NOISE_M, len(hits.range_m))
    is_kept = rng.uniform(size=len(range_m)) < share
    is_kept &= (range_m >= sensor.min_range_m) & (range_m <= _SIM_RANGE_M)
    points = directions[hits.ray_ids] * range_m[:, None]
    intensity = np.exp(-_SIM_ATTENUATION_PER_M * range_m)
    rows = np.column_stack([points, intensity]).astype(np.float32)
    return SynthScan(rows[is_kept], object_ids[is_kept])
