"""`fidpipe twin`: a dataset of posed real scans and their twins: each place scanned again in a model of the others.

A scan's own points never enter its model. A twin depends on the recipe and its frame alone; it is whole or not there,
and the manifest comes last, so that what was interrupted goes on with the twins that are missing.
"""

from __future__ import annotations

import csv
import gc
import tomllib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from difflib import get_close_matches
from fnmatch import fnmatchcase
from io import StringIO
from pathlib import Path
from typing import Any

import numpy as np

from ...schemas.columns import SIDES
from ...schemas.errors import DatasetError, FidpipeError, ScanError, StageError
from ...schemas.settings import FRAME_AXES, InputSettings, Settings
from ...stages.arrays import BoolArray, FloatArray
from ...stages.clean import clean_scan
from ...stages.generate.flaws import FLAWS, ChosenFlaw, lose_foliage
from ...stages.generate.ray_casting import fire, need_ray_caster
from ...stages.generate.rescan import EMPTY_MAP, RECORDED, SurfelModel, extend_map, recorded_directions
from ...stages.inspect.sensor_models import SensorModel
from ..datasets.pairs import LABEL_NAMES, MANIFEST, ScanPair
from ..datasets.readers import read_scan, stem_of
from ..datasets.readers.scan import label_path_of
from ..datasets.sequences import Frame, Recording
from ..engine.engine import Engine, Machines
from ..engine.plan import Job, PairPlan
from ..engine.progress import Reporter
from ..stage import Context, Grain, Made, Stage
from ..storage.files import hash_file, key_of, path_exists, refuse_link, write_whole
from ..storage.record import library_versions

RECIPE = "twin.toml"
RECIPE_VERSION = 1  # to be raised when the same recipe gives other scans
_LIBRARIES = ("numpy", "scipy", "trimesh", "embreex")
_FEWEST_OTHERS = 2


@dataclass(frozen=True)
class TwinRequest:
    """What dataset is wanted.

    out : its folder
    recording : the posed scans
    sensor : that scans again, with its range noise and share of lost pulses
    flaws : in the order in which they are applied
    n_others : at most so many other frames, the nearest in time, make the model of each
    foliage : labels that the flaw of that name takes for foliage; none: what is scattered
    pattern : only frames whose name matches (shell style) are scanned again; all of them make models
    seed : another one gives other noise, losses and flaws
    settings : how scans are read and cleaned; the group `input` alone
    workers : processes; they change nothing but the time
    replace : whether a dataset of another recipe may be replaced
    """

    out: Path
    recording: Recording
    sensor: SensorModel = RECORDED
    flaws: tuple[ChosenFlaw, ...] = ()
    n_others: int = 4
    foliage: tuple[str, ...] = ()
    pattern: str | None = None
    seed: int = 0
    settings: InputSettings = field(default_factory=InputSettings)
    workers: int = 1
    replace: bool = False


@dataclass(frozen=True)
class TwinOutcome:
    """What has become of it: pairs of the dataset, and why others are not in it, by name."""

    n_pairs: int
    failures: dict[str, str]


@dataclass(frozen=True)
class _Task:
    """One frame to be scanned again; the others come nearest first."""

    frame: Frame
    others: tuple[Frame, ...]
    label_names: tuple[tuple[int, str], ...]
    out: Path
    sensor: SensorModel
    flaws: tuple[ChosenFlaw, ...]
    foliage: tuple[str, ...]
    seed: int
    settings: InputSettings


def make_twins(request: TwinRequest, reporter: Reporter) -> TwinOutcome:
    """Writes the dataset; twins that are there already by the same recipe are left as they are.

    Raises
    ------
    FidpipeError
        embreex is missing, no frame matches, or the folder holds something else than what this recipe gives.
    """
    try:
        need_ray_caster()
        _check_frame(request.settings)
        _check_foliage(request)
        frames = _selected(request)
        _prepare(request, frames)
        tasks = list(_tasks(request, frames))
        missing = [task for task in tasks if not _is_made(task)]
        if len(missing) < len(tasks):
            reporter.say(f"{len(tasks) - len(missing)} of {len(tasks)} twins are there already")
        failures = _make_all(request, missing, reporter) if missing else {}
        made = [task.frame for task in tasks if _is_made(task)]
        write_whole(request.out / MANIFEST, _manifest(made).encode())
    except OSError as error:
        raise FidpipeError(f"dataset {request.out}: cannot be written ({error.strerror or error})") from error
    return TwinOutcome(len(made), failures)


def _check_frame(settings: InputSettings) -> None:
    """Refuses frames in which poses and beams are not."""
    if settings.real_frame != "ros":
        raise FidpipeError(
            f'input.real_frame is "{settings.real_frame}", "ros" is wanted: poses and beams of a recording are '
            f"those of a sensor with {FRAME_AXES['ros']}; turn its scans and poses first"
        )


def _check_foliage(request: TwinRequest) -> None:
    """Refuses labels that no class has."""
    known = list(request.recording.label_names.values())
    for label in request.foliage if known else ():
        if label not in known:
            near = get_close_matches(label, known, 1)
            hint = f"did you mean {near[0]}?" if near else f"known are {', '.join(known)}"
            raise FidpipeError(f"foliage {label!r}: no such label in {LABEL_NAMES}; {hint}")


def _selected(request: TwinRequest) -> list[Frame]:
    frames = request.recording.frames
    if request.pattern is None:
        return list(frames)
    selected = [frame for frame in frames if fnmatchcase(frame.name, request.pattern)]
    if not selected:
        names = ", ".join(frame.name for frame in frames[:5])
        raise DatasetError(f"--pairs {request.pattern!r} matches none of the {len(frames)} frames ({names} ...)")
    return selected


def _recipe(request: TwinRequest, frames: Sequence[Frame]) -> dict[str, Any]:
    """All that the files depend on; of two datasets with the same recipe all files are the same."""
    from ... import __version__

    recording = request.recording
    inputs = [[frame.path.name, hash_file(frame.path), frame.T_world_sensor] for frame in recording.frames]
    return {
        "version": RECIPE_VERSION,
        "fidpipe": __version__,
        "recording": str(recording.folder),
        "poses": recording.poses.name,
        "inputs_sha256": key_of(inputs),
        "seed": request.seed,
        "others": request.n_others,
        "foliage": list(request.foliage),
        "flaw": [_without_none(vars(flaw)) for flaw in request.flaws],
        "sensor": vars(request.sensor),
        "input": request.settings.model_dump(mode="json", exclude_none=True),
        "libraries": library_versions(_LIBRARIES),
        "frames": [frame.name for frame in frames],
        "files": sorted({name for frame in frames for name in _names(frame)}),
    }


def _without_none(values: dict[str, Any]) -> dict[str, Any]:
    return {name: value for name, value in values.items() if value is not None}


def _prepare(request: TwinRequest, frames: Sequence[Frame]) -> None:
    """Makes the folder, with the recipe; of another recipe the files are removed, if they may be."""
    import tomli_w

    out, wanted = request.out, tomli_w.dumps(_recipe(request, frames))
    if out.exists() and not out.is_dir():
        raise FidpipeError(f"dataset {out}: is a file, a folder is wanted")
    if out.resolve() == request.recording.folder.resolve():
        raise FidpipeError(f"dataset {out}: is the recording; give the name of a new or empty folder")
    out.mkdir(parents=True, exist_ok=True)
    for side in SIDES:
        refuse_link(out / side)
    earlier = _read_recipe(out)
    if earlier is None and any(not path.name.startswith(".") for path in out.iterdir()):
        raise FidpipeError(
            f"dataset {out}: the folder holds other things than twins (no {RECIPE} of ours in it); give the name of a "
            "new or empty folder"
        )
    if earlier is not None and _essence(earlier) != _essence(tomllib.loads(wanted)):
        changed = ", ".join(name for name in _essence(earlier) if earlier[name] != tomllib.loads(wanted).get(name))
        if not request.replace and (out / MANIFEST).exists():
            raise FidpipeError(
                f"dataset {out}: holds finished twins of another recipe ({changed}); give the name of another folder, "
                "or --replace"
            )
        for path in (out / LABEL_NAMES, *(out / side / name for side in SIDES for name in earlier["files"])):
            if path_exists(path) and not path.is_dir():
                path.unlink()
    (out / MANIFEST).unlink(missing_ok=True)
    write_whole(out / RECIPE, wanted.encode())
    names = request.recording.label_names
    if names:
        write_whole(out / LABEL_NAMES, tomli_w.dumps({str(number): name for number, name in names.items()}).encode())


def _read_recipe(out: Path) -> dict[str, Any] | None:
    """The recipe that a folder was made by; None if it holds no twins."""
    try:
        recipe = tomllib.loads((out / RECIPE).read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError):  # TOML and unicode errors are ValueErrors
        return None
    files = recipe.get("files")
    is_ours = isinstance(files, list) and all(isinstance(name, str) and Path(name).name == name for name in files)
    return recipe if is_ours and {"version", "seed", "sensor", "inputs_sha256"} <= recipe.keys() else None


def _essence(recipe: dict[str, Any]) -> dict[str, Any]:
    """What the files depend on: all but where the recording lies."""
    return {name: value for name, value in recipe.items() if name != "recording"}


def _tasks(request: TwinRequest, frames: Sequence[Frame]) -> Iterator[_Task]:
    everything = request.recording.frames
    place_of = {frame.name: place for place, frame in enumerate(everything)}
    for frame in frames:
        place = place_of[frame.name]
        nearest = np.argsort(np.abs(np.arange(len(everything)) - place), kind="stable").tolist()
        yield _Task(
            frame,
            tuple(everything[other] for other in nearest[1 : request.n_others + 1]),
            tuple(request.recording.label_names.items()),
            request.out,
            request.sensor,
            request.flaws,
            request.foliage,
            request.seed,
            request.settings,
        )


def _names(frame: Frame) -> tuple[str, str, str]:
    """Names of the files of a pair: the real scan, the simulated one, the labels of the former."""
    return frame.path.name, f"{stem_of(frame.path)}.bin", label_path_of(frame.path, stem_of(frame.path)).name


def _files(task: _Task) -> tuple[Path, Path]:
    """The scans of a pair."""
    real, sim, _ = _names(task.frame)
    return task.out / "real" / real, task.out / "sim" / sim


def _is_made(task: _Task) -> bool:
    return all(path.exists() for path in _files(task))


def _manifest(frames: Sequence[Frame]) -> str:
    text = StringIO()
    rows = csv.writer(text, lineterminator="\n")
    rows.writerow(["pair_id", "real", "sim", "timestamp_s", "T_world_sensor"])
    for frame in frames:
        time_s = "" if frame.timestamp_s is None else repr(frame.timestamp_s)
        motion = " ".join(map(repr, frame.T_world_sensor))
        real, sim, _ = _names(frame)
        rows.writerow([frame.name, f"real/{real}", f"sim/{sim}", time_s, motion])
    return text.getvalue()


def _make_all(request: TwinRequest, tasks: Sequence[_Task], reporter: Reporter) -> dict[str, str]:
    """Makes the twins; gives why some could not be made, by name."""
    plans = (_plan(request, task) for task in tasks)
    with Engine(Settings(), Machines(request.workers), reporter, [__name__]) as engine:
        with engine.scheduling(plans, len(tasks)) as schedule:
            schedule.run()
        return engine.failures


def _plan(request: TwinRequest, task: _Task) -> PairPlan:
    """The one job of a frame, which writes the scans of its pair."""
    key = key_of(task.frame.name, str(request.out))
    job = Job(_STAGE, "twin", key, Settings(), arguments=(task,))
    return PairPlan(ScanPair(task.frame.name, None, None), (job,))


def _make(context: Context) -> Made:
    (task,) = context.arguments
    real, sim = _files(task)
    points = _scan_again(task)
    gc.collect()  # a surface of trimesh refers to itself: 80 MB a frame would wait for the collector
    labels = label_path_of(task.frame.path, stem_of(task.frame.path))
    if labels.exists():
        write_whole(real.with_name(labels.name), labels.read_bytes())
    write_whole(real, task.frame.path.read_bytes())
    rows = np.zeros((len(points), 4), dtype="<f4")
    rows[:, :3] = points
    write_whole(sim, rows.tobytes())
    return Made({})


def _scan_again(task: _Task) -> FloatArray:
    """The twin of a scan, (n, 3) float64, metres, in its frame, with the flaws that are wanted.

    Raises
    ------
    ScanError
        The scan cannot be read.
    StageError
        Fewer than two of the other scans can be read, or no ray meets anything.
    """
    from threadpoolctl import threadpool_limits

    with threadpool_limits(1):  # or the last bits would differ between machines
        own, _ = _read(task, task.frame)
        T_sensor_world = np.linalg.inv(_square(task.frame))
        voxels, others = EMPTY_MAP, []
        for frame in task.others:
            try:
                points, is_foliage = _read(task, frame)
            except ScanError:  # its own pair fails
                continue
            motion = T_sensor_world @ _square(frame)
            voxels = extend_map(voxels, points @ motion[:3, :3].T + motion[:3, 3], is_foliage)
            others.append(points)
        if len(others) < _FEWEST_OTHERS:
            raise StageError(f"{len(others)} other scans can be read, at least {_FEWEST_OTHERS} are wanted for a model")
        rng = _rng(task, task.frame.name)
        if task.sensor.name == RECORDED.name:
            directions = recorded_directions(own, np.concatenate(others))
        else:
            directions = fire(task.sensor, rng.uniform(0.0, 360.0)).directions()
        rescan = SurfelModel(voxels).scan(directions, task.sensor, rng)
        points = rescan.points
        for flaw in task.flaws:
            rng = _rng(task, flaw.name if FLAWS[flaw.name].is_systematic else f"{task.frame.name}/{flaw.name}")
            if flaw.name == "foliage" and task.foliage:
                points = lose_foliage(points, flaw.amount, rng, rescan.is_foliage)  # the first flaw: all rows are there
            else:
                points = FLAWS[flaw.name](points, flaw.amount, rng, flaw.at_m)
    if not len(points):
        raise StageError("no ray of the sensor meets the model, or flaws leave nothing; see the poses and the amounts")
    return points


def _read(task: _Task, frame: Frame) -> tuple[FloatArray, BoolArray | None]:
    """The measurements of a frame, and which of them are labelled as foliage, where labels are to tell."""
    scan = read_scan(frame.path, task.settings.columns_of("real"), dict(task.label_names))
    clean = clean_scan(scan.points, task.settings)
    if not task.foliage:
        return clean.points, None
    if scan.labels is None:
        raise ScanError(f"{frame.path}: has no labels, which are wanted to tell foliage ({', '.join(task.foliage)})")
    return clean.points, np.isin(scan.labels[clean.point_ids], task.foliage)


def _square(frame: Frame) -> FloatArray:
    """(4, 4) float64, T_world_sensor."""
    return np.vstack([np.reshape(frame.T_world_sensor, (3, 4)), [0.0, 0.0, 0.0, 1.0]])


def _rng(task: _Task, purpose: str) -> np.random.Generator:
    """Random numbers for a purpose; whatever is made before or beside it."""
    return np.random.default_rng([task.seed, *purpose.encode()])


#: It takes and gives no table: its results are the files of the dataset.
_STAGE = Stage(name="twin", takes={}, gives=(), grain=Grain.PAIR, version=RECIPE_VERSION, make=_make)
