"""The two scans of a pair: of a street by the real sensor, and of its flawed twin by a simulator.

Measurement models of both: detection of a hit, range noise, density, intensity.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ...schemas.sensor_models import SensorModel
from ..arrays import Float32Array, FloatArray, IndexArray
from .ray_casting import Beams, RayTarget, fire, measure_ranges, return_probability
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
    object_ids : (n,) intp, index in the scene; for an invented surface, that of the object it hangs on
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

    rngs = [np.random.default_rng(child) for child in np.random.SeedSequence((seed, index)).spawn(4)]
    with threadpool_limits(1):  # or the last bits would differ between machines
        # Individual leaves cannot be distinguished in a sparse scan.
        leaf_scale = 1.0 if n_points is None else float(np.clip(np.sqrt(20_000 / n_points), 1.0, 3.0))
        objects = build_scene(rngs[0], leaf_scale)
        street = _Surface([each.mesh() for each in objects])
        step_deg = sensor.azimuth_step_deg if n_points is None else _step_for(n_points, street, sensor)
        real = _real_scan(street, sensor, step_deg, rngs[1])
        sim = _simulated_scan(build_twin(objects, rngs[2]), sensor, step_deg, rngs[3])
    return SynthPair(real, sim, tuple(each.kind for each in objects))


class _Surface:
    """Meshes as one target for rays, with the reflectivity and the mesh of each triangle."""

    def __init__(self, meshes: Sequence[Mesh]) -> None:
        whole = join_meshes(meshes)
        self.target = RayTarget(whole.vertices, whole.faces)
        self.reflectivity = whole.reflectivity
        self.mesh_of_face = np.repeat(np.arange(len(meshes)), [len(mesh.faces) for mesh in meshes])


def _step_for(n_points: int, street: _Surface, sensor: SensorModel) -> float:
    """The azimuth step in degrees at which this scene has about `n_points` returns."""
    beams = fire(sensor, step_deg=_PILOT * sensor.azimuth_step_deg)
    hits = street.target.first_hits(beams.directions())
    probability = return_probability(sensor, hits.range_m, hits.cos_incidence, street.reflectivity[hits.face_ids])
    share = max(float(probability.sum()) / len(beams.azimuth_rad), 0.01)
    return sensor.n_beams * 360.0 * share / n_points


def _real_scan(street: _Surface, sensor: SensorModel, step_deg: float, rng: np.random.Generator) -> SynthScan:
    """The real scan, with undetected hits, range noise and quantum; intensity is reflectivity, 0-255."""
    directions = fire(sensor, rng.uniform(0.0, 360.0), step_deg).directions()
    hits = street.target.first_hits(directions)
    reflectivity = street.reflectivity[hits.face_ids]
    probability = return_probability(sensor, hits.range_m, hits.cos_incidence, reflectivity)
    detected = rng.uniform(size=len(probability)) < probability
    range_m = measure_ranges(sensor, hits.range_m[detected], rng)
    speckled = reflectivity[detected] * rng.normal(1.0, 0.15, len(range_m))
    intensity = np.clip(np.round(255.0 * speckled), 0.0, 255.0)
    in_range = (range_m >= sensor.min_range_m) & (range_m <= sensor.max_range_m)
    points = directions[hits.ray_ids[detected]] * range_m[:, None]
    return _scan(points[in_range], intensity[in_range], street.mesh_of_face[hits.face_ids[detected]][in_range])


def _simulated_scan(
    twin: Sequence[TwinSurface], sensor: SensorModel, step_deg: float, rng: np.random.Generator
) -> SynthScan:
    """The simulated scan: every hit is detected, then each object gets its own density.

    Of the points on an object of density below 1 that share is kept. At an object of higher density further beams are
    cast between the sensor's own; those that miss it are dropped. Intensity is exp(-a range), as in CARLA.
    """
    surface = _Surface([part.mesh for part in twin])
    density = np.array([part.density for part in twin])
    beams = fire(sensor, rng.uniform(0.0, 360.0), step_deg)
    directions = beams.directions()
    hits = surface.target.first_hits(directions)
    parts = surface.mesh_of_face[hits.face_ids]
    kept = rng.uniform(size=len(parts)) < density[parts]
    n_more = rng.poisson(np.maximum(density[parts] - 1.0, 0.0))
    more = _between(beams, np.repeat(hits.ray_ids, n_more), sensor, step_deg, rng)
    further = surface.target.first_hits(more)
    on_same = surface.mesh_of_face[further.face_ids] == np.repeat(parts, n_more)[further.ray_ids]

    directions = np.concatenate([directions[hits.ray_ids[kept]], more[further.ray_ids[on_same]]])
    range_m = np.concatenate([hits.range_m[kept], further.range_m[on_same]])
    parts = np.concatenate([parts[kept], surface.mesh_of_face[further.face_ids[on_same]]])
    range_m = range_m + rng.normal(0.0, _SIM_NOISE_M, len(range_m))
    in_range = (range_m >= sensor.min_range_m) & (range_m <= _SIM_RANGE_M)
    object_ids = np.array([part.object_id for part in twin], dtype=np.intp)[parts]
    intensity = np.exp(-_SIM_ATTENUATION_PER_M * range_m)
    return _scan((directions * range_m[:, None])[in_range], intensity[in_range], object_ids[in_range])


def _between(
    beams: Beams, ray_ids: IndexArray, sensor: SensorModel, step_deg: float, rng: np.random.Generator
) -> FloatArray:
    """(n, 3) float64, unit vectors: random beams around the given ones, up to half way to their neighbours."""
    elevation = np.sort(np.radians(sensor.elevation_deg))
    gap = np.gradient(elevation)[np.searchsorted(elevation, beams.elevation_rad[ray_ids] - 1e-9)]
    shift = rng.uniform(-0.5, 0.5, (2, len(ray_ids)))
    return Beams(
        beams.azimuth_rad[ray_ids] + np.radians(step_deg) * shift[0], beams.elevation_rad[ray_ids] + gap * shift[1]
    ).directions()


def _scan(points: FloatArray, intensity: FloatArray, object_ids: IndexArray) -> SynthScan:
    return SynthScan(np.column_stack([points, intensity]).astype(np.float32), object_ids)
