"""A flawed digital twin of a street: the geometry that a simulator casts its rays at, and how densely it does.

A twin as the paper has it (sections "Data Collection" and "Real experiments"): a mesh of the street made from
registered scans. Decides the flaws: surfaces displaced and rounded, thin things thickened, foliage merged into lumps
or missing where it is far, far things missing, surface invented near foliage and between far things, and things that
are seen more or less densely than by the real sensor. Leaves to others: how a mesh is blurred (`meshing`), who casts
the rays (`scans`).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from ....stages.arrays import FloatArray
from .meshes import NOTHING, Mesh, grid, join
from .meshing import merged, rounded, smooth_field, thickened, torn, within
from .scene import Thing

DENSITY_BOUNDS = (0.1, 8.0)
GROUND_REACH_M = 45.0
_FOLIAGE = ("tree", "vegetation")


@dataclass(frozen=True)
class Copy:
    """What a twin has of a thing, or surface that it invents beside it.

    thing_id : index of the thing in the scene
    mesh : its surface
    density : points on it per beam of the sensor that meets it
    """

    thing_id: int
    mesh: Mesh
    density: float


def build_twin(things: Sequence[Thing], rng: np.random.Generator) -> tuple[Copy, ...]:
    """The flawed copies of a scene's things; those that the twin misses have none.

    Parameters
    ----------
    things : the scene, sensor frame
    rng : all that the flaws depend on
    """
    copies = []
    for thing_id, thing in enumerate(things):
        mesh = _remeshed(thing, rng)
        if len(mesh.faces):
            copies.append(Copy(thing_id, mesh, _density(thing, rng)))
    copies += _invented(things, copies, rng)
    return _displaced(things, copies, rng)


def _density(thing: Thing, rng: np.random.Generator) -> float:
    """Points per beam: rather too few on what is near, and the farther a thing is the less can be said about it."""
    if thing.kind == "ground":
        return 0.8
    far = min(thing.range_m() / 40.0, 1.0)
    return float(np.clip(rng.lognormal(-0.6, 0.4 + 0.8 * far), *DENSITY_BOUNDS))


def _remeshed(thing: Thing, rng: np.random.Generator) -> Mesh:
    """The thing as it comes out of meshing; empty where nothing does."""
    if thing.kind == "ground":
        return within(thing.solid, GROUND_REACH_M)
    range_m = thing.range_m()
    is_lost = rng.uniform() < np.clip((range_m - 25.0) / 80.0, 0.0, 0.5)
    is_bare = rng.uniform() < np.clip((range_m - 12.0) / 35.0, 0.0, 0.9)
    is_lost |= is_bare and thing.kind == "tree" and rng.uniform() < 0.5
    if is_lost or (is_bare and thing.kind == "vegetation"):
        return NOTHING
    parts = []
    if len(thing.solid.faces):
        is_thin = thing.kind in ("pole", "tree")
        solid = thickened(thing.solid, 0.04 + 0.002 * range_m) if is_thin else rounded(thing.solid)
        parts.append(torn(solid, float(np.clip(0.03 + 0.003 * range_m, 0.0, 0.25)), rng))
    if not is_bare:
        parts.append(merged(thing.leaves, 0.28 + 0.005 * range_m, 0.25, rng.spawn(1)[0]))
    return join(parts)


def _invented(things: Sequence[Thing], copies: Sequence[Copy], rng: np.random.Generator) -> Iterator[Copy]:
    """Sheets that hang from foliage, and sheets between neighbours that are far from the sensor."""
    of_things = [copy for copy in copies if things[copy.thing_id].kind != "ground"]
    middles = np.array([copy.mesh.vertices.mean(axis=0) for copy in of_things]).reshape(-1, 3)
    for copy, middle in zip(of_things, middles, strict=True):
        range_m = float(np.linalg.norm(middle))
        if things[copy.thing_id].kind in _FOLIAGE and rng.uniform() < 0.5:
            upper = _edge(copy.mesh, rng)
            lower = upper + rng.normal(0.0, 0.5, 3) - [0.0, 0.0, rng.uniform(0.6, 2.0)]
            yield Copy(copy.thing_id, _sheet(upper, lower), rng.uniform(0.5, 2.0))
        apart = np.linalg.norm(middles - middle, axis=1)
        near = np.flatnonzero((apart > 0) & (apart < 8.0))
        if len(near) and rng.uniform() < np.clip((range_m - 12.0) / 60.0, 0.0, 0.5):
            other = of_things[int(rng.choice(near))]
            yield Copy(copy.thing_id, _sheet(_edge(copy.mesh, rng), _edge(other.mesh, rng)), rng.uniform(0.5, 2.0))


def _edge(mesh: Mesh, rng: np.random.Generator) -> FloatArray:
    """(2, 3) float64, two places on a mesh."""
    return mesh.vertices[rng.integers(len(mesh.vertices), size=2)]


def _sheet(start: FloatArray, end: FloatArray) -> Mesh:
    """The surface spanned by two edges, in pieces that can be bent."""
    share = np.linspace(0.0, 1.0, 6)
    rails = [edge[0] + share[:, None] * (edge[1] - edge[0]) for edge in (start, end)]
    return grid(rails[0] + share[:, None, None] * (rails[1] - rails[0]), 0.3)


def _displaced(things: Sequence[Thing], copies: Sequence[Copy], rng: np.random.Generator) -> tuple[Copy, ...]:
    """All surfaces shifted by one smooth random field of some centimetres near the sensor and some decimetres afar.

    The ground, which the scanner has passed over, is off by the same few centimetres everywhere.
    """
    vertices = np.concatenate([copy.mesh.vertices for copy in copies])
    is_passed = np.concatenate([np.full(len(c.mesh.vertices), things[c.thing_id].kind == "ground") for c in copies])
    error_m = 0.05 + 0.004 * np.where(is_passed, 0.0, np.linalg.norm(vertices, axis=1))[:, None]
    shifted = vertices + error_m * smooth_field(vertices, rng) * np.array([1.0, 1.0, 0.25])
    ends = np.cumsum([len(copy.mesh.vertices) for copy in copies])
    return tuple(
        Copy(
            copy.thing_id,
            Mesh(shifted[end - len(copy.mesh.vertices) : end], copy.mesh.faces, copy.mesh.reflectivity),
            copy.density,
        )
        for copy, end in zip(copies, ends, strict=True)
    )
