"""`fidpipe twin`: a dataset of posed real scans and their twins: each place re-scanned in a model of the other scans.

A scan's own points never enter its model. A twin depends on the recipe and its frame alone. It is
written atomically, and the manifest comes last, so that an interrupted command resumes with the
missing twins.
"""

from __future__ import annotations

import gc
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import chain, product
from pathlib import Path
from typing import Any

import numpy as np

from ...schemas.columns import SIDES
from ...schemas.errors import FidpipeError, ScanError, StageError, suggestion
from ...schemas.sensor_models import SensorModel
from ...schemas.settings import FRAME_AXES, InputSettings
from ...stages.arrays import BoolArray, FloatArray
from ...stages.clean import clean_scan
from ...stages.generate.flaws import FLAWS, ChosenFlaw, carried, lose_foliage
from ...stages.generate.ray_casting import fire, require_ray_caster
from ...stages.generate.rescan import EMPTY_MAP, RECORDED, extend_map, recorded_directions, rescan
from ..datasets.pairs import LABEL_NAMES, MANIFEST, ScanPair
from ..datasets.readers import read_scan
from ..engine.progress import Reporter
from ..engine.tasks import map_tasks
from ..run import select_pairs
from ..storage.files import csv_bytes, hash_file, key_of, named_errors, path_exists, write_whole
from ..storage.run_record import library_versions
from .dataset_folder import Recipe, prepare_folder
from .recordings import Recording, square

RECIPE = "twin.toml"
RECIPE_VERSION = 2  # increase it when the same recipe results in other scans
_LIBRARIES = ("numpy", "scipy", "trimesh", "embreex")
_LEAST_OTHERS = 2


@dataclass(frozen=True)
class TwinOutcome:
    """Number of pairs in the dataset, and reasons for missing pairs by name."""

    n_pairs: int
    failures: dict[str, str]


@dataclass(frozen=True)
class _Task:
    """One frame to be re-scanned, see `make_twins`; the other frames are sorted by distance in time."""

    frame: ScanPair
    others: tuple[ScanPair, ...]
    label_names: dict[int, str]
    out: Path
    sensor: SensorModel
    flaws: tuple[ChosenFlaw, ...]
    foliage: tuple[str, ...]
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
    foliage: tuple[str, ...] = (),
    pattern: str | None = None,
    seed: int = 0,
    settings: InputSettings | None = None,
    workers: int = 1,
    replace: bool = False,
) -> TwinOutcome:
    """Write the dataset; existing twins of the same recipe are kept.

    Parameters
    ----------
    sensor : of the re-scan, with its range noise and share of lost pulses
    flaws : in the order in which they are applied
    n_others : largest number of other frames, the nearest in time, used for the model of a frame
    foliage : labels of foliage for the flaw of that name; by default scattered points
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
    _check_request(recording, out, foliage, settings)
    frames = select_pairs(recording, pattern)
    paths = [_files(out, frame) for frame in frames]
    recipe = _inputs(recording) | {
        "seed": seed,
        "others": n_others,
        "foliage": list(foliage),
        "flaw": [_without_none(vars(flaw)) for flaw in flaws],
        "sensor": vars(sensor),
        "input": settings.model_dump(mode="json", exclude_none=True),
        "libraries": library_versions(_LIBRARIES),
        "frames": [frame.pair_id for frame in frames],
        "files": sorted({path.name for path in chain(*paths)}),
    }
    names = recording.label_names
    tasks = {}
    for frame in frames:
        others = _nearest(recording.pairs, frame, n_others)
        tasks[frame.pair_id] = _Task(
            frame,
            others,
            names,
            out,
            sensor,
            flaws,
            foliage,
            seed,
            settings,
        )
    with named_errors(out):
        files = {out / side / name for side, name in product(SIDES, recipe["files"])}
        prepare_folder(out, RECIPE, recipe, _own_files, files, names, replace=replace)
        missing = {name: task for name, task in tasks.items() if not _is_done(task)}
        if 0 < len(missing) < len(tasks):
            reporter.say(f"{len(tasks) - len(missing)} of {len(tasks)} twins already exist")
        _, failures = map_tasks(_write_twin, missing, reporter, n_workers=workers)
        done = [task.frame for task in tasks.values() if _is_done(task)]
        columns = ["pair_id", "real", "sim", "timestamp_s", "T_world_sensor"]
        write_whole(out / MANIFEST, csv_bytes(columns, map(_row, done)))
    return TwinOutcome(len(done), failures)


def _check_request(
    recording: Recording,
    out: Path,
    foliage: Sequence[str],
    settings: InputSettings,
) -> None:
    """Raise `FidpipeError` if twins of a recording cannot be made with these arguments."""
    require_ray_caster()
    if settings.real_frame != "ros":
        raise FidpipeError(
            f'input.real_frame: expected "ros", got "{settings.real_frame}": poses and beams of a '
            f"recording require {FRAME_AXES['ros']}; convert its scans and poses first"
        )
    known = list(recording.label_names.values())
    for label in foliage if known else ():
        if label not in known:
            raise FidpipeError(
                f"foliage {label!r}: no such label in {LABEL_NAMES}; {suggestion(label, known)}",
            )
    if out.resolve() == recording.folder.resolve():
        raise FidpipeError(f"dataset {out}: is the recording; expected a new or empty folder")


def _without_none(values: Mapping[str, Any]) -> Recipe:
    """The entries that have a value, as TOML has no null."""
    return {name: value for name, value in values.items() if value is not None}


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


def _own_files(out: Path, recipe: Recipe) -> set[Path] | None:
    """Existing files of a recipe; None if it is not a recipe of twins."""
    names = recipe.get("files")
    is_ours = isinstance(names, list) and all(isinstance(name, str) and Path(name).name == name for name in names)
    if not is_ours or not {"version", "seed", "sensor", "inputs_sha256"} <= recipe.keys():
        return None
    paths = [out / side / name for side, name in product(SIDES, recipe["files"])]
    return {path for path in paths if path_exists(path) and not path.is_dir()}


def _nearest(frames: Sequence[ScanPair], frame: ScanPair, n: int) -> tuple[ScanPair, ...]:
    """The frames nearest in time to one of them, without it."""
    order = np.argsort(np.abs(np.arange(len(frames)) - frames.index(frame)), kind="stable").tolist()
    return tuple(frames[other] for other in order[1 : n + 1])


def _files(out: Path, frame: ScanPair) -> tuple[Path, Path, Path]:
    """The files of a pair: real scan, simulated scan, labels of the real scan."""
    real = out / "real"
    scan = frame.scans["real"]
    return real / scan.file.name, out / "sim" / f"{scan.stem}.bin", real / scan.labels.name


def _is_done(task: _Task) -> bool:
    real, sim, _ = _files(task.out, task.frame)
    return real.exists() and sim.exists()


def _row(frame: ScanPair) -> tuple[str, ...]:
    """The row of a pair in the manifest."""
    time_s = "" if frame.timestamp_s is None else repr(frame.timestamp_s)
    real, sim, _ = _files(Path(), frame)
    return (
        frame.pair_id,
        str(real),
        str(sim),
        time_s,
        " ".join(
            map(repr, frame.T_world_sensor or ()),
        ),
    )


def _write_twin(task: _Task) -> None:
    """Write the scans of a pair, and the labels of the real one."""
    real, sim, labels = _files(task.out, task.frame)
    points, intensity = _rescan(task)
    gc.collect()  # trimesh surfaces are cyclic: otherwise 80 MB per frame wait for the collector
    scan = task.frame.scans["real"]
    if scan.labels.exists():
        write_whole(labels, scan.labels.read_bytes())
    write_whole(real, scan.file.read_bytes())
    write_whole(sim, np.column_stack([points, np.nan_to_num(intensity)]).astype("<f4").tobytes())


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
        scan, _, _ = _read(task, task.frame)
        T_sensor_world = np.linalg.inv(square(task.frame.T_world_sensor or ()))
        voxels = EMPTY_MAP
        others = []
        for frame in task.others:
            try:
                points, is_labelled, brightness = _read(task, frame)
            except ScanError:  # its own pair fails
                continue
            motion = T_sensor_world @ square(frame.T_world_sensor or ())
            voxels = extend_map(
                voxels,
                points @ motion[:3, :3].T + motion[:3, 3],
                is_labelled,
                brightness,
            )
            others.append(points)
        if len(others) < _LEAST_OTHERS:
            raise StageError(
                f"expected at least {_LEAST_OTHERS} readable other scans for a model, got {len(others)}",
            )
        rng = _rng(task, task.frame.pair_id)
        if task.sensor.name == RECORDED.name:
            directions = recorded_directions(scan, np.concatenate(others))
        else:
            directions = fire(task.sensor, rng.uniform(0.0, 360.0)).directions()
        points, is_foliage, intensity = rescan(voxels, directions, task.sensor, rng)
        for flaw in task.flaws:
            kind = FLAWS[flaw.name]
            rng = _rng(
                task,
                flaw.name if kind.is_systematic else f"{task.frame.pair_id}/{flaw.name}",
            )
            if flaw.name == "foliage" and task.foliage:  # the first flaw: no rows are lost yet
                altered = lose_foliage(points, flaw.amount, rng, is_foliage)
            else:
                altered = kind(points, flaw.amount, rng, flaw.at_m)
            intensity = carried(points, intensity, altered)
            points = altered
            if kind.intensity is not None:
                intensity = kind.intensity(points, intensity, flaw.amount)
    if not len(points):
        raise StageError(
            "no points: no ray hits the model, or the flaws remove every point; check the poses and the amounts",
        )
    return points, intensity


def _read(task: _Task, frame: ScanPair) -> tuple[FloatArray, BoolArray | None, FloatArray | None]:
    """The cleaned points of a frame, a mask of those labelled as foliage if the recipe names such labels, intensity."""
    scan = read_scan(frame.scans["real"], task.settings.columns_of("real"), task.label_names)
    clean = clean_scan(scan.points, task.settings)
    intensity = None if scan.intensity is None else scan.intensity[clean.point_ids]
    if not task.foliage:
        return clean.points, None, intensity
    if scan.labels is None:
        raise ScanError(
            f"{frame.real}: has no labels; expected labels for the foliage ({', '.join(task.foliage)})",
        )
    return clean.points, np.isin(scan.labels[clean.point_ids], task.foliage), intensity


def _rng(task: _Task, purpose: str) -> np.random.Generator:
    """Random generator for a purpose, independent of all others."""
    return np.random.default_rng([task.seed, *purpose.encode()])
