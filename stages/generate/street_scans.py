"""The two scans of a pair: of a street by the real sensor, and of its flawed twin by a simulator.

Measurement models of both: detection of a hit, range noise, density, intensity.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ...schemas.sensor_models import SensorModel
from ..arrays import Float32Array, FloatArray, IndexArray
from .ray_casting import Beams, Hits, RayTarget, fire, measure_ranges, return_probability
from .street_objects import Mesh, join_meshes
from .street_scene import build_scene
from .street_twin import TwinSurface, build_twin

_PILOT = 8  # a pilot scan has every 8th firing of the sensor
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


def make_pair(seed: int, index: int, sensor: SensorModel, n_points: int | None = None) -> SynthPair:
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
        objects = build_scene(np.random.default_rng(scene_seed))
        street = _Surface([item.mesh() for item in objects])
        step_deg = sensor.azimuth_step_deg
        if n_points is not None:
            step_deg = _step_for(n_points, street, sensor)
        twin = build_twin(objects, np.random.default_rng(twin_seed))
        real = _scan_street(street, sensor, step_deg, np.random.default_rng(real_seed))
        sim = _scan_twin(twin, sensor, step_deg, np.random.default_rng(sim_seed))
    return SynthPair(real, sim, tuple(item.kind for item in objects))


class _Surface:
    """Meshes as one target for rays, with the reflectivity and the mesh of each triangle."""

    def __init__(self, meshes: Sequence[Mesh]) -> None:
        whole = join_meshes(meshes)
        self.target = RayTarget(whole.vertices, whole.faces)
        self.reflectivity = whole.reflectivity
        self.mesh_of_face = np.repeat(np.arange(len(meshes)), [len(mesh.faces) for mesh in meshes])

    def probability(self, sensor: SensorModel, hits: Hits) -> FloatArray:
        """The probability that each hit is detected."""
        reflectivity = self.reflectivity[hits.face_ids]
        return return_probability(sensor, hits.range_m, hits.cos_incidence, reflectivity)


def _step_for(n_points: int, street: _Surface, sensor: SensorModel) -> float:
    """The azimuth step in degrees at which this scene has about `n_points` returns."""
    directions = fire(sensor, step_deg=_PILOT * sensor.azimuth_step_deg).directions()
    hits = street.target.first_hits(directions)
    share = float(street.probability(sensor, hits).sum()) / len(directions)
    return sensor.n_beams * 360.0 * max(share, 0.01) / n_points


def _scan_street(
    street: _Surface,
    sensor: SensorModel,
    step_deg: float,
    rng: np.random.Generator,
) -> SynthScan:
    """The real scan, with undetected hits, range noise and quantum; intensity is reflectivity, 0-255."""
    directions = fire(sensor, rng.uniform(0.0, 360.0), step_deg).directions()
    hits = street.target.first_hits(directions)
    probability = street.probability(sensor, hits)
    range_m = measure_ranges(sensor, hits.range_m, rng)
    is_kept = rng.uniform(size=len(probability)) < probability
    is_kept &= (range_m >= sensor.min_range_m) & (range_m <= sensor.max_range_m)
    speckled = street.reflectivity[hits.face_ids] * rng.normal(1.0, 0.15, len(range_m))
    intensity = np.clip(np.round(255.0 * speckled), 0.0, 255.0)
    points = directions[hits.ray_ids] * range_m[:, None]
    rows = np.column_stack([points, intensity]).astype(np.float32)
    return SynthScan(rows[is_kept], street.mesh_of_face[hits.face_ids[is_kept]])


def _scan_twin(
    twin: Sequence[TwinSurface], sensor: SensorModel, step_deg: float, rng: np.random.Generator
) -> SynthScan:
    """The simulated scan: every hit is detected, then each object gets its own density.

    Of the points on an object of density below 1 that share is kept. At an object of higher density
    further beams are cast between the sensor's own; those that miss it are dropped. Intensity is
    exp(-a range), as in CARLA.
    """
    surface = _Surface([part.mesh for part in twin])
    beams = fire(sensor, rng.uniform(0.0, 360.0), step_deg)
    beam_hits = surface.target.first_hits(beams.directions())
    hit_parts = surface.mesh_of_face[beam_hits.face_ids]
    density = np.array([part.density for part in twin])[hit_parts]
    is_kept = rng.uniform(size=len(density)) < density
    n_further = rng.poisson(np.maximum(density - 1.0, 0.0))

    kept = beams.directions()[beam_hits.ray_ids[is_kept]]
    further = _between(beams, np.repeat(beam_hits.ray_ids, n_further), sensor, step_deg, rng)
    directions = np.concatenate([kept, further])
    aimed_at = np.concatenate([hit_parts[is_kept], np.repeat(hit_parts, n_further)])
    hits = surface.target.first_hits(directions)
    parts = surface.mesh_of_face[hits.face_ids]
    range_m = hits.range_m + rng.normal(0.0, _SIM_NOISE_M, len(hits.range_m))
    is_valid = parts == aimed_at[hits.ray_ids]
    is_valid &= (range_m >= sensor.min_range_m) & (range_m <= _SIM_RANGE_M)
    points = directions[hits.ray_ids] * range_m[:, None]
    intensity = np.exp(-_SIM_ATTENUATION_PER_M * range_m)
    rows = np.column_stack([points, intensity]).astype(np.float32)
    object_ids = np.array([part.object_id for part in twin], dtype=np.intp)
    return SynthScan(rows[is_valid], object_ids[parts[is_valid]])


def _between(
    beams: Beams,
    ray_ids: IndexArray,
    sensor: SensorModel,
    step_deg: float,
    rng: np.random.Generator,
) -> FloatArray:
    """(n, 3) float64, unit vectors: random beams around the given ones, up to half way to their neighbours."""
    elevation_rad = np.sort(np.radians(sensor.elevation_deg))
    laser = np.searchsorted(elevation_rad, beams.elevation_rad[ray_ids] - 1e-9)
    gap_rad = np.gradient(elevation_rad)[laser]
    azimuth_shift, elevation_shift = rng.uniform(-0.5, 0.5, (2, len(ray_ids)))
    return Beams(
        beams.azimuth_rad[ray_ids] + np.radians(step_deg) * azimuth_shift,
        beams.elevation_rad[ray_ids] + gap_rad * elevation_shift,
    ).directions()
