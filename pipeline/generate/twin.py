"""`fidpipe twin`: a dataset of posed real scans and their twins: each place re-scanned in a model of the other scans.

A scan's own points never enter its model. A twin depends on the recipe and its frame alone. It is
written atomically, and the manifest comes last, so that an interrupted command resumes with the
missing twins.
"""

from __future__ import annotations

import gc
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from ...schemas.errors import FidpipeError, ScanError, StageError
from ...schemas.sensor_models import SensorModel
from ...schemas.settings import FRAME_AXES, InputSettings
from ...stages.arrays import FloatArray, moved
from ...stages.clean import clean_scan
from ...stages.generate.flaws import FLAWS, carried
from ...stages.generate.ray_casting import fire, require_ray_caster
from ...stages.generate.rescan import (
    EMPTY_MAP,
    RECORDED,
    extend_map,
    recorded_directions,
    rescan,
)
from ..datasets.pairs import Dataset, ScanPair
from ..datasets.readers import read_scan
from ..engine.pool import one_blas_thread
from ..engine.progress import Reporter
from ..run import select_pairs
from ..storage.files import hash_file, key_of, write_whole
from ..storage.run_record import library_versions
from .dataset_folder import GeneratedPair, generate_dataset
from .recordings import square

RECIPE = "twin.toml"
RECIPE_VERSION = 2  # increase it when the same recipe results in other scans
_LIBRARIES = ("numpy", "scipy", "trimesh", "embreex")
_LEAST_OTHERS = 2


@dataclass(frozen=True)
class TwinRecipe:
    """Parameters from which twins are made.

    sensor : of the re-scan, with its range noise and share of lost pulses
    flaws : amounts by name, in the order in which they are applied
    n_others : largest number of other frames, the nearest in time, used for the model of a frame
    seed : of noise, losses and flaws
    settings : for reading and cleaning scans
    """

    sensor: SensorModel = RECORDED
    flaws: Mapping[str, float] = field(default_factory=dict)
    n_others: int = 4
    seed: int = 0
    settings: InputSettings = field(default_factory=InputSettings)

    def rng(self, purpose: str) -> np.random.Generator:
        """Random generator for a purpose, independent of all others."""
        return np.random.default_rng([self.seed, *purpose.encode()])


@dataclass(frozen=True)
class _Task:
    """One frame to be re-scanned; the other frames are sorted by distance in time."""

    recipe: TwinRecipe
    frame: ScanPair
    others: tuple[ScanPair, ...]
    label_names: dict[int, str]
    out: Path


def make_twins(
    recording: Dataset,
    out: Path,
    reporter: Reporter,
    recipe: TwinRecipe,
    *,
    pattern: str | None = None,
    workers: int = 1,
    replace: bool = False,
) -> tuple[int, dict[str, str]]:
    """Write the dataset; existing twins of the same recipe are kept.

    The result is the number of pairs, and the reasons for missing ones by name.

    Parameters
    ----------
    pattern : only frames whose name matches (shell style) are re-scanned; all frames are used for
        models
    workers : processes; they affect only the time
    replace : allow a dataset of another recipe to be replaced

    Raises
    ------
    FidpipeError
        embreex is missing, no frame matches, or the folder holds something else than a dataset of
        this recipe.
    """
    require_ray_caster()
    real_frame = recipe.settings.real_frame
    if real_frame != "ros":
        raise FidpipeError(
            f'input.real_frame: expected "ros", got "{real_frame}": poses and beams of a '
            f"recording require {FRAME_AXES['ros']}; convert its scans and poses first"
        )
    frames = select_pairs(recording, pattern)
    names = recording.label_names
    pairs = []
    for frame in frames:
        distance = np.abs(np.arange(len(recording.pairs)) - recording.pairs.index(frame))
        nearest = np.argsort(distance, kind="stable")[1 : recipe.n_others + 1]
        others = tuple(recording.pairs[other] for other in nearest)
        scan = frame.scans["real"]
        pairs.append(
            GeneratedPair(
                pair_id=frame.pair_id,
                real=scan.file.name,
                sim=f"{scan.stem}.bin",
                task=_Task(recipe, frame, others, names, out),
                timestamp_s=frame.timestamp_s,
                T_world_sensor=frame.T_world_sensor,
            )
        )
    content = _recipe_content(recording, recipe, frames)
    return generate_dataset(
        out,
        RECIPE,
        content,
        pairs,
        names,
        _write_twin,
        reporter,
        workers=workers,
        replace=replace,
    )


def _recipe_content(
    recording: Dataset, recipe: TwinRecipe, frames: Sequence[ScanPair]
) -> dict[str, Any]:
    """Everything that the twins of some frames depend on."""
    inputs = []
    for frame in recording.pairs:
        file = frame.scans["real"].file
        inputs.append([file.name, hash_file(file), frame.T_world_sensor])
    return {
        "version": RECIPE_VERSION,
        **library_versions(("fidpipe",)),
        "recording": str(recording.folder),
        "inputs_sha256": key_of(inputs),
        "seed": recipe.seed,
        "others": recipe.n_others,
        "flaw": [{"name": name, "amount": amount} for name, amount in recipe.flaws.items()],
        "sensor": vars(recipe.sensor),
        "input": recipe.settings.model_dump(mode="json", exclude_none=True),
        "libraries": library_versions(_LIBRARIES),
        "frames": [frame.pair_id for frame in frames],
    }


def _write_twin(task: _Task) -> None:
    """Write the scans of a pair, and the labels of the real one."""
    points, intensity = _rescan(task)
    gc.collect()  # trimesh surfaces are cyclic: otherwise 80 MB per frame wait for the collector
    scan = task.frame.scans["real"]
    if scan.labels.exists():
        write_whole(task.out / "real" / scan.labels.name, scan.labels.read_bytes())
    write_whole(task.out / "real" / scan.file.name, scan.file.read_bytes())
    rows = np.column_stack([points, np.nan_to_num(intensity)])
    write_whole(task.out / "sim" / f"{scan.stem}.bin", rows.astype("<f4").tobytes())


def _rescan(task: _Task) -> tuple[FloatArray, FloatArray]:
    """The twin of a scan with its flaws, (n, 3) float64, metres, in its frame, and its (n,) intensities.

    Raises
    ------
    ScanError
        The scan cannot be read.
    StageError
        Fewer than two of the other scans can be read, or no point remains.
    """
    with one_blas_thread():  # or the last bits would differ between machines
        scan, _ = _read(task, task.frame)
        T_sensor_world = np.linalg.inv(square(task.frame.T_world_sensor or ()))
        voxels = EMPTY_MAP
        others = []
        for frame in task.others:
            try:
                points, intensity = _read(task, frame)
            except ScanError:  # its own pair fails
                continue
            motion = T_sensor_world @ square(frame.T_world_sensor or ())
            voxels = extend_map(voxels, moved(points, motion[:3]), intensity)
            others.append(points)
        if len(others) < _LEAST_OTHERS:
            raise StageError(
                f"expected at least {_LEAST_OTHERS} readable other scans for a model, got {len(others)}",
            )
        recipe = task.recipe
        rng = recipe.rng(task.frame.pair_id)
        if recipe.sensor.name == RECORDED.name:
            directions = recorded_directions(scan, np.concatenate(others))
        else:
            directions = fire(recipe.sensor, rng.uniform(0.0, 360.0))
        points, intensity = rescan(voxels, directions, recipe.sensor, rng)
        for name, amount in recipe.flaws.items():
            flaw = FLAWS[name]
            purpose = name if flaw.is_systematic else f"{task.frame.pair_id}/{name}"
            altered = flaw(points, amount, recipe.rng(purpose))
            intensity = carried(points, intensity, altered)
            points = altered
    if not len(points):
        raise StageError(
            "no points: no ray hits the model, or the flaws remove every point; check the poses and the amounts",
        )
    return points, intensity


def _read(task: _Task, frame: ScanPair) -> tuple[FloatArray, FloatArray]:
    """The cleaned points of a frame and their intensity, NaN if unknown."""
    settings = task.recipe.settings
    scan = read_scan(frame.scans["real"], settings.columns_of("real"), task.label_names)
    clean = clean_scan(scan.points, settings)
    if scan.intensity is None:
        return clean.points, np.full(len(clean.points), np.nan)
    return clean.points, scan.intensity[clean.point_ids]
