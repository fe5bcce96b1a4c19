"""`fidpipe twin`: a dataset of posed real scans and their twins: each place re-scanned in a model of the other scans.

A scan's own points never enter its model. A twin depends on the recipe and its frame alone. It is
written atomically, and the manifest comes last, so that an interrupted command resumes with the
missing twins.
"""

from __future__ import annotations

import gc
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ...schemas.errors import FidpipeError, ScanError, StageError
from ...schemas.sensor_models import SensorModel
from ...schemas.settings import FRAME_AXES, InputSettings
from ...stages.arrays import FloatArray
from ...stages.clean import clean_scan
from ...stages.generate.flaws import FLAWS, ChosenFlaw, carried
from ...stages.generate.ray_casting import fire, require_ray_caster
from ...stages.generate.rescan import EMPTY_MAP, RECORDED, extend_map, recorded_directions, rescan
from ..datasets.pairs import ScanPair
from ..datasets.readers import read_scan
from ..engine.progress import Reporter
from ..run import select_pairs
from ..storage.files import hash_file, key_of, write_whole
from ..storage.run_record import library_versions
from .dataset_folder import Generated, GeneratedPair, Recipe, generate_dataset
from .recordings import Recording, square

RECIPE = "twin.toml"
RECIPE_VERSION = 2  # increase it when the same recipe results in other scans
_LIBRARIES = ("numpy", "scipy", "trimesh", "embreex")
_LEAST_OTHERS = 2


@dataclass(frozen=True)
class _Task:
    """One frame to be re-scanned, see `make_twins`; the other frames are sorted by distance in time."""

    frame: ScanPair
    others: tuple[ScanPair, ...]
    label_names: dict[int, str]
    out: Path
    sensor: SensorModel
    flaws: tuple[ChosenFlaw, ...]
    seed: int
    settings: InputSettings


def make_twins(
    recording: Recording,
    out: Path,
    reporter: Reporter,
    *,
    sensor: SensorModel = RECORDED,
    flaws: tuple[ChosenFlaw, ...] = (),
    n_others: int = 4,
    pattern: str | None = None,
    seed: int = 0,
    settings: InputSettings | None = None,
    workers: int = 1,
    replace: bool = False,
) -> Generated:
    """Write the dataset; existing twins of the same recipe are kept.

    Parameters
    ----------
    sensor : of the re-scan, with its range noise and share of lost pulses
    flaws : in the order in which they are applied
    n_others : largest number of other frames, the nearest in time, used for the model of a frame
    pattern : only frames whose name matches (shell style) are re-scanned; all frames are used for
        models
    seed : of noise, losses and flaws
    settings : for reading and cleaning scans
    workers : processes; they affect only the time
    replace : allow a dataset of another recipe to be replaced

    Raises
    ------
    FidpipeError
        embreex is missing, no frame matches, or the folder holds something else than a dataset of
        this recipe.
    """
    settings = settings or InputSettings()
    _check_request(recording, out, settings)
    frames = select_pairs(recording, pattern)
    recipe = _inputs(recording) | {
        "seed": seed,
        "others": n_others,
        "flaw": [flaw.entries() for flaw in flaws],
        "sensor": vars(sensor),
        "input": settings.model_dump(mode="json", exclude_none=True),
        "libraries": library_versions(_LIBRARIES),
        "frames": [frame.pair_id for frame in frames],
    }
    names = recording.label_names
    pairs = []
    for frame in frames:
        others = _nearest(recording.pairs, frame, n_others)
        scan = frame.scans["real"]
        pairs.append(
            GeneratedPair(
                pair_id=frame.pair_id,
                real=scan.file.name,
                sim=f"{scan.stem}.bin",
                task=_Task(frame, others, names, out, sensor, flaws, seed, settings),
                timestamp_s=frame.timestamp_s,
                T_world_sensor=frame.T_world_sensor,
            )
        )
    return generate_dataset(
        out, RECIPE, recipe, pairs, names, _write_twin, reporter, workers=workers, replace=replace
    )


def _check_request(
    recording: Recording,
    out: Path,
    settings: InputSettings,
) -> None:
    """Raise `FidpipeError` if twins of a recording cannot be made with these arguments."""
    require_ray_caster()
    if settings.real_frame != "ros":
        raise FidpipeError(
            f'input.real_frame: expected "ros", got "{settings.real_frame}": poses and beams of a '
            f"recording require {FRAME_AXES['ros']}; convert its scans and poses first"
        )
    if out.resolve() == recording.folder.resolve():
        raise FidpipeError(f"dataset {out}: is the recording; expected a new or empty folder")


def _inputs(recording: Recording) -> Recipe:
    """The entries of a recipe about the recording and fidpipe."""
    inputs = []
    for frame in recording.pairs:
        file = frame.scans["real"].file
        inputs.append([file.name, hash_file(file), frame.T_world_sensor])
    return {
        "version": RECIPE_VERSION,
        **library_versions(("fidpipe",)),
        "recording": str(recording.folder),
        "poses": recording.poses.name,
        "inputs_sha256": key_of(inputs),
    }


def _nearest(frames: Sequence[ScanPair], frame: ScanPair, n: int) -> tuple[ScanPair, ...]:
    """The frames nearest in time to one of them, without it."""
    order = np.argsort(np.abs(np.arange(len(frames)) - frames.index(frame)), kind="stable").tolist()
    return tuple(frames[other] for other in order[1 : n + 1])


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
    from threadpoolctl import threadpool_limits

    with threadpool_limits(1):  # or the last bits would differ between machines
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
            voxels = extend_map(voxels, points @ motion[:3, :3].T + motion[:3, 3], intensity)
            others.append(points)
        if len(others) < _LEAST_OTHERS:
            raise StageError(
                f"expected at least {_LEAST_OTHERS} readable other scans for a model, got {len(others)}",
            )
        rng = _rng(task, task.frame.pair_id)
        if task.sensor.name == RECORDED.name:
            directions = recorded_directions(scan, np.concatenate(others))
        else:
            directions = fire(task.sensor, rng.uniform(0.0, 360.0))
        points, intensity = rescan(voxels, directions, task.sensor, rng)
        for flaw in task.flaws:
            kind = FLAWS[flaw.name]
            purpose = flaw.name if kind.is_systematic else f"{task.frame.pair_id}/{flaw.name}"
            altered = kind(points, flaw.amount, _rng(task, purpose), flaw.at_m)
            intensity = carried(points, intensity, altered)
            points = altered
            if kind.intensity is not None:
                intensity = kind.intensity(points, intensity, flaw.amount)
    if not len(points):
        raise StageError(
            "no points: no ray hits the model, or the flaws remove every point; check the poses and the amounts",
        )
    return points, intensity


def _read(task: _Task, frame: ScanPair) -> tuple[FloatArray, FloatArray]:
    """The cleaned points of a frame and their intensity, NaN if unknown."""
    scan = read_scan(frame.scans["real"], task.settings.columns_of("real"), task.label_names)
    clean = clean_scan(scan.points, task.settings)
    if scan.intensity is None:
        return clean.points, np.full(len(clean.points), np.nan)
    return clean.points, scan.intensity[clean.point_ids]


def _rng(task: _Task, purpose: str) -> np.random.Generator:
    """Random generator for a purpose, independent of all others."""
    return np.random.default_rng([task.seed, *purpose.encode()])
