"""Synthetic pairs: scans of one street by a real sensor, and of its flawed twin by a simulator.

Returns, range noise, density and intensity differ between the two.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..arrays import Float32Array, FloatArray, IndexArray
from ..inspect.sensor_models import SensorModel
from .ray_casting import Beams, RayTarget, fire, measure_ranges, return_probability
from .scene import build_scene
from .street_twin import TwinObject, build_twin
from .things import Mesh, join_meshes

_PILOT = 8  # firings of the sensor per firing of a pilot scan
_SIM_NOISE_M = 0.01
_SIM_RANGE_M = 120.0
_SIM_ATTENUATION_PER_M = 0.004


@dataclass(frozen=True)
class SynthScan:
    """One scan with the object of each point.

    rows : (n, 4) float32, x, y, z in metres, sensor frame, and intensity
    thing_ids : (n,) intp, index in the scene; for invented surface, that of the object to which it is attached
    """

    rows: Float32Array
    thing_ids: IndexArray


@dataclass(frozen=True)
class SynthPair:
    """Scans of one street.

    kinds : class of each object of the scene, by thing id
    """

    real: SynthScan
    sim: SynthScan
    kinds: tuple[str, ...]


def make_pair(seed: int, index: int, sensor: SensorModel, n_points: int | None = None) -> SynthPair:
    """Scans of one street by the real sensor and by the simulator; they depend only on the arguments.

    Parameters
    ----------
    seed, index : seed of the dataset, and index of the pair in it
    sensor : sensor of both sides
    n_points : approximate number of points of the real scan; by default from the sensor's azimuth step
    """
    from threadpoolctl import threadpool_limits

    rngs = [np.random.default_rng(child) for child in np.random.SeedSequence((seed, index)).spawn(4)]
    with threadpool_limits(1):  # or the last bits would differ between machines
        things = build_scene(rngs[0], _leaf_scale(n_points))
        street = _Surface([thing.mesh() for thing in things], list(range(len(things))))
        step_deg = sensor.azimuth_step_deg if n_points is None else _step_for(n_points, street, sensor)
        real = _real_scan(street, sensor, step_deg, rngs[1])
        sim = _simulated_scan(build_twin(things, rngs[2]), sensor, step_deg, rngs[3])
    return SynthPair(real, sim, tuple(thing.kind for thing in things))


def _leaf_scale(n_points: int | None) -> float:
    """Factor for larger, fewer leaves in a sparse scan, which cannot resolve single ones."""
    return 1.0 if n_points is None else float(np.clip(np.sqrt(20_000 / n_points), 1.0, 3.0))


class _Surface:
    """Meshes as one target for rays, with mesh and reflectivity of each triangle."""

    def __init__(self, meshes: Sequence[Mesh], owners: Sequence[int]) -> None:
        whole = join_meshes(meshes)
        self.target = RayTarget(whole.vertices, whole.faces)
        self.reflectivity = whole.reflectivity
        self.owner_of_face = np.repeat(np.asarray(owners, dtype=np.intp), [len(mesh.faces) for mesh in meshes])


def _step_for(n_points: int, street: _Surface, sensor: SensorModel) -> float:
    """Azimuth step in degrees for about `n_points` returns from this scene."""
    beams = fire(sensor, step_deg=_PILOT * sensor.azimuth_step_deg)
    hits = street.target.first_hits(beams.directions())
    probability = return_probability(sensor, hits.range_m, hits.cos_incidence, street.reflectivity[hits.face_ids])
    share = max(float(probability.sum()) / len(beams.azimuth_rad), 0.01)
    return sensor.n_beams * 360.0 * share / n_points


def _real_scan(street: _Surface, sensor: SensorModel, step_deg: float, rng: np.random.Generator) -> SynthScan:
    """Scan of the sensor, with lost returns, range noise and quantum; intensity is reflectivity, 0-255."""
    directions = fire(sensor, rng.uniform(0.0, 360.0), step_deg).directions()
    hits = street.target.first_hits(directions)
    reflectivity = street.reflectivity[hits.face_ids]
    probability = return_probability(sensor, hits.range_m, hits.cos_incidence, reflectivity)
    answered = rng.uniform(size=len(probability)) < probability
    range_m = measure_ranges(sensor, hits.range_m[answered], rng)
    speckled = reflectivity[answered] * rng.normal(1.0, 0.15, len(range_m))
    intensity = np.clip(np.round(255.0 * speckled), 0.0, 255.0)
    seen = (range_m >= sensor.min_range_m) & (range_m <= sensor.max_range_m)
    points = directions[hits.ray_ids[answered]] * range_m[:, None]
    return _scan(points[seen], intensity[seen], street.owner_of_face[hits.face_ids[answered]][seen])


def _simulated_scan(
    twin: Sequence[TwinObject], sensor: SensorModel, step_deg: float, rng: np.random.Generator
) -> SynthScan:
    """Scan of the simulator: each beam with a hit has a return, then the density of each object is adjusted.

    Of the points on an object of density below 1 that share is kept. For an object of higher density further beams are
    cast between those of the sensor; beams that miss it are not reported. Intensity is exp(-a range), as in CARLA.
    """
    surface = _Surface([copy.mesh for copy in twin], list(range(len(twin))))
    density = np.array([copy.density for copy in twin])
    beams = fire(sensor, rng.uniform(0.0, 360.0), step_deg)
    directions = beams.directions()
    hits = surface.target.first_hits(directions)
    copies = surface.owner_of_face[hits.face_ids]
    kept = rng.uniform(size=len(copies)) < density[copies]
    n_more = rng.poisson(np.maximum(density[copies] - 1.0, 0.0))
    more = _between(beams, np.repeat(hits.ray_ids, n_more), sensor, step_deg, rng)
    further = surface.target.first_hits(more)
    on_same = surface.owner_of_face[further.face_ids] == np.repeat(copies, n_more)[further.ray_ids]

    directions = np.concatenate([directions[hits.ray_ids[kept]], more[further.ray_ids[on_same]]])
    range_m = np.concatenate([hits.range_m[kept], further.range_m[on_same]])
    copies = np.concatenate([copies[kept], surface.owner_of_face[further.face_ids[on_same]]])
    range_m = range_m + rng.normal(0.0, _SIM_NOISE_M, len(range_m))
    seen = (range_m >= sensor.min_range_m) & (range_m <= _SIM_RANGE_M)
    thing_ids = np.array([copy.thing_id for copy in twin], dtype=np.intp)[copies]
    intensity = np.exp(-_SIM_ATTENUATION_PER_M * range_m)
    return _scan((directions * range_m[:, None])[seen], intensity[seen], thing_ids[seen])


def _between(
    beams: Beams, ray_ids: IndexArray, sensor: SensorModel, step_deg: float, rng: np.random.Generator
) -> FloatArray:
    """Unit vectors, (n, 3) float64, of random beams half way between the given beams and their neighbours."""
    elevation = np.sort(np.radians(sensor.elevation_deg))
    gap = np.gradient(elevation)[np.searchsorted(elevation, beams.elevation_rad[ray_ids] - 1e-9)]
    shift = rng.uniform(-0.5, 0.5, (2, len(ray_ids)))
    return Beams(
        beams.azimuth_rad[ray_ids] + np.radians(step_deg) * shift[0], beams.elevation_rad[ray_ids] + gap * shift[1]
    ).directions()


def _scan(points: FloatArray, intensity: FloatArray, thing_ids: IndexArray) -> SynthScan:
    return SynthScan(np.column_stack([points, intensity]).astype(np.float32), thing_ids)
