"""`fidpipe floor`: what a perfect simulator would score: each real scan against itself measured again.

The second measurements are a dataset of their own in the run's folder, and the run is one as any other. What a
measurement is depends on the recipe, the real scan and the pair's name alone; the manifest comes last.
"""

from __future__ import annotations

import csv
from collections.abc import Iterator
from dataclasses import dataclass, field
from io import BytesIO, StringIO
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from ...schemas.errors import DatasetError, RunError, ScanError
from ...schemas.settings import FARTHEST_M, FrameName, InputSettings, Settings
from ...stages.arrays import FloatArray
from ...stages.clean import as_ros, clean_scan
from ...stages.generate.perturbations import measure_again
from ...stages.inspect.sensor import describe_sensor
from ..datasets.pairs import LABEL_NAMES, MANIFEST, Dataset, ScanPair, read_dataset
from ..datasets.readers import read_scan
from ..datasets.readers.scan import Scan
from ..engine.engine import Engine, Machines, absolute_paths
from ..engine.plan import Job, PairPlan
from ..engine.progress import Reporter
from ..inspect.scan_checks import file_marks, hash_scan, input_name
from ..results.floor import AS_MEASURED, FLOOR_AMOUNTS, FLOOR_DATASET, FLOOR_RECIPE, FloorRecipe, read_recipe
from ..run import RunOutcome, run_dataset, select_pairs
from ..stage import Context, Grain, Made, Stage
from ..storage.files import key_of, path_exists, refuse_link, write_whole
from ..storage.folder import RunFolder, check_folder, refuse_overwrite
from ..storage.ledger import Ledger
from ..storage.record import has_ended, read_run
from ..storage.tables import file_stem

RECIPE_VERSION = 2  # to be raised when the same recipe gives other measurements
USUAL_NOISE_M, USUAL_LOST_SHARE = 0.03, 0.03  # where a scan does not show its own
_KEY, _NOISE_M, _LOST_SHARE, _REASON = b"fidpipe.floor", b"noise_m", b"lost_share", b"reason"
_AMOUNTS = (_NOISE_M, _LOST_SHARE, _REASON)
#: All that was measured, once each: the settings of the run cut both sides alike.
_ALL = InputSettings(min_range_m=0.0, max_range_m=FARTHEST_M)


@dataclass(frozen=True)
class FloorRequest:
    """What the user asked for.

    dataset, out : folders
    settings : of all stages; what is said there of the simulated side does not count
    noise_m : standard deviation of the noise along the ray; None for that of each scan (`describe_sensor`)
    lost_share : share of the points that the second measurement lacks; None for that of each scan
    seed : another one draws other noise and losses
    neighbours : whether the second measurement is the next real scan instead, put into place by the poses
    pattern : only pairs whose name matches are worked on (shell style)
    machines : where work is done
    replace : whether a finished floor of another recipe or other settings may be replaced
    """

    dataset: Path
    out: Path
    settings: Settings = field(default_factory=Settings)
    noise_m: float | None = None
    lost_share: float | None = None
    seed: int = 0
    neighbours: bool = False
    pattern: str | None = None
    machines: Machines = field(default_factory=Machines)
    replace: bool = False

    @property
    def recipe(self) -> FloorRecipe:
        """How the second measurements are made."""
        kind = "neighbours" if self.neighbours else "again"
        amounts = (self.noise_m, self.lost_share, self.seed)
        noise_m, lost_share, seed = (0.0, 0.0, 0) if self.neighbours else amounts
        dataset = str(self.dataset.resolve())
        own = [AS_MEASURED if amount is None else amount for amount in (noise_m, lost_share)]
        return FloorRecipe(RECIPE_VERSION, kind, own[0], own[1], seed, dataset)


@dataclass(frozen=True)
class _Task:
    """One second measurement: of which pair, from which file, to which file, under which key."""

    pair_id: str
    source: Path
    path: Path
    key: str
    recipe: FloorRecipe
    frame: FrameName
    columns: tuple[str, ...] | None
    label_names: dict[int, str]


def run_floor(request: FloorRequest, reporter: Reporter) -> RunOutcome:
    """Evaluates each real scan against itself measured again; what is there already and still right is not made again.

    Raises
    ------
    FidpipeError
        The dataset as a whole, a setting or the run's folder is wrong, the folder holds another finished floor, or
        poses are wanted and there are none; before any work.
    """
    request = absolute_paths(request)
    dataset = read_dataset(request.dataset)
    selected = {pair.pair_id for pair in select_pairs(dataset, request.pattern)}
    partners = _neighbours(dataset) if request.neighbours else {pair.pair_id: pair for pair in dataset.pairs}
    _refuse_other_recipe(request)
    check_folder(request.out, request.out / FLOOR_DATASET)
    folder = RunFolder(request.out)
    with folder.locked():
        _write_dataset(request, dataset, partners, selected, folder.ledger, reporter)
    own = request.settings.input.model_copy(
        update={"sim_flip_y": False, "sim_frame": request.settings.input.real_frame, "sim_columns": None}
    )
    return run_dataset(
        request.out / FLOOR_DATASET,
        request.out,
        request.settings.model_copy(update={"input": own}),
        reporter,
        pattern=request.pattern,
        machines=request.machines,
        replace=request.replace,
    )


def _neighbours(dataset: Dataset) -> dict[str, ScanPair]:
    """The next real scan of each, by time where it is known, else by name; of the last one that before it."""
    frames = [pair for pair in dataset.pairs if pair.real is not None]
    unposed = next((pair.pair_id for pair in frames if pair.T_world_sensor is None), None)
    if unposed is not None:
        raise DatasetError(
            f"dataset {dataset.folder}: pair {unposed} has no pose; --neighbours wants the column T_world_sensor in "
            f"{MANIFEST} (12 numbers, [R | t] row by row), as fidpipe twin writes it"
        )
    if len(frames) < 2:
        raise DatasetError(f"dataset {dataset.folder}: {len(frames)} real scans found, --neighbours wants two or more")
    if all(pair.timestamp_s is not None for pair in frames):
        frames.sort(key=lambda pair: (pair.timestamp_s, pair.pair_id))
    after = dict(zip((pair.pair_id for pair in frames), [*frames[1:], frames[-2]], strict=True))
    return {pair.pair_id: after.get(pair.pair_id, pair) for pair in dataset.pairs}


def _refuse_other_recipe(request: FloorRequest) -> None:
    """Raises `RunError` where another run, or unasked a finished floor of another recipe, would be replaced."""
    before, record = read_recipe(request.out), read_run(request.out)
    if before is None and record:
        raise RunError(f"run {request.out}: holds a run of {record.get('dataset')}, no floor; give another --out")
    if before is None or before == request.recipe:
        return
    if before.dataset != request.recipe.dataset and path_exists(Path(before.dataset)):
        raise RunError(
            f"run {request.out}: holds the floor of {before.dataset}, not of {request.dataset}; give another --out"
        )
    if before.words != request.recipe.words and has_ended(record) and not request.replace:
        recipes = f"{before.words}; asked for: {request.recipe.words}"
        refuse_overwrite(f"run {request.out}", "its scans", [recipes])


def _write_dataset(
    request: FloorRequest,
    dataset: Dataset,
    partners: dict[str, ScanPair],
    selected: set[str],
    ledger: Ledger,
    reporter: Reporter,
) -> None:
    """Makes the dataset: what another recipe or another real scan left goes first, the manifest comes last."""
    folder = request.out / FLOOR_DATASET
    refuse_link(folder / "sim")
    (folder / MANIFEST).unlink(missing_ok=True)
    paths = {pair.pair_id: folder / "sim" / f"{file_stem(pair.pair_id)}.parquet" for pair in dataset.pairs}
    tasks = {
        pair.pair_id: task
        for pair in dataset.pairs
        if pair.pair_id in selected or paths[pair.pair_id].exists()
        if (task := _task(request, dataset, pair, partners[pair.pair_id], paths[pair.pair_id], ledger))
    }
    current = {name for name, task in tasks.items() if _key_in(task.path) == task.key}
    for path in {*(folder / "sim").glob("*.parquet")} - {paths[name] for name in current}:
        path.unlink()
    write_whole(folder / FLOOR_RECIPE, request.recipe.to_toml().encode())
    if (label_names := dataset.folder / LABEL_NAMES).exists():
        write_whole(folder / LABEL_NAMES, label_names.read_bytes())
    else:
        (folder / LABEL_NAMES).unlink(missing_ok=True)
    _make_all([task for name, task in tasks.items() if name in selected - current], reporter)
    names = {name: f"sim/{task.path.name}" for name, task in tasks.items() if task.path.exists()}
    rows = [pair for pair in dataset.pairs if pair.pair_id in selected | current]
    if AS_MEASURED in (request.recipe.noise_m, request.recipe.lost_share):
        _report_amounts({name: _metadata(paths[name]) for name in names}, folder, reporter)
    write_whole(folder / MANIFEST, _manifest(rows, partners, names).encode())


def _report_amounts(by_pair: dict[str, dict[bytes, bytes]], folder: Path, reporter: Reporter) -> None:
    """Writes and shows noise and losses of the second measurements, and warns of scans that do not show theirs."""
    text = StringIO()
    rows = csv.writer(text, lineterminator="\n")
    rows.writerow(["pair_id", *(name.decode() for name in _AMOUNTS)])
    rows.writerows([pair_id, *(own[name].decode() for name in _AMOUNTS)] for pair_id, own in by_pair.items())
    write_whole(folder / FLOOR_AMOUNTS, text.getvalue().encode())
    amounts = list(by_pair.values())
    if not amounts:
        return
    noise_m, lost_share = (np.median([float(own[name]) for own in amounts]) for name in (_NOISE_M, _LOST_SHARE))
    reporter.say(f"range noise {1e3 * noise_m:.0f} mm, dropout {lost_share:.1%} (median of {len(amounts)} scans)")
    unknown = [own[_REASON].decode() for own in amounts if own[_REASON]]
    if unknown:
        reporter.warn(
            f"{len(unknown)} of {len(amounts)} real scans do not show their noise or losses ({unknown[0]}): "
            f"{USUAL_NOISE_M:g} m and {USUAL_LOST_SHARE:.0%} were used; set --noise-m and --dropout"
        )


def _task(
    request: FloorRequest, dataset: Dataset, pair: ScanPair, source: ScanPair, path: Path, ledger: Ledger
) -> _Task | None:
    """What is to be measured for a pair; None where there is no real scan."""
    if pair.real is None or source.real is None:
        return None
    hashes, known = ("", ""), ledger.input(input_name(source, "real"))
    try:
        if known and known["sha256"] and known["marks"] == file_marks(source.real):
            hashes = known["sha256"], known["label_sha256"]
        else:
            hashes = hash_scan(source.real)
    except OSError:  # the run that follows says so
        pass
    columns, names = request.settings.input.columns_of("real"), dataset.label_names
    frame = request.settings.input.frame_of("real")
    key = key_of(RECIPE_VERSION, request.recipe.words, pair.pair_id, hashes, sorted(names.items()), columns, frame)
    return _Task(pair.pair_id, source.real, path, key, request.recipe, frame, columns, names)


def _key_in(path: Path) -> str:
    """Key of a measurement, or "" if there is none that is intact."""
    return _metadata(path).get(_KEY, b"").decode()


def _metadata(path: Path) -> dict[bytes, bytes]:
    """Key, noise and losses of a measurement; empty if there is none that is intact."""
    try:
        return pq.read_schema(path).metadata or {}
    except (OSError, pa.ArrowInvalid):
        return {}


def _make_all(tasks: list[_Task], reporter: Reporter) -> None:
    """Makes the measurements, in this process: it takes a hundredth of what their run does."""
    if not tasks:
        return
    plans = (PairPlan(ScanPair(task.pair_id, None, None), (_job(task),)) for task in tasks)
    with Engine(Settings(), Machines(workers=1), reporter, [__name__]) as engine:
        with engine.scheduling(plans, len(tasks)) as schedule:
            schedule.run()
        if engine.failures:
            raise RunError(next(iter(engine.failures.values())))


def _job(task: _Task) -> Job:
    return Job(_STAGE, "", task.key, Settings(), arguments=(task,))


def _make(context: Context) -> Made:
    """Writes one measurement: x, y, z, and the labels and instances of the points where there are such."""
    (task,) = context.arguments
    try:
        scan = read_scan(task.source, task.columns, task.label_names)
    except ScanError:  # the run reads it too, and says so
        return Made({})
    clean, recipe = clean_scan(scan.points, _ALL), task.recipe
    rng = np.random.default_rng([recipe.seed, *task.pair_id.encode()])
    noise_m, lost_share, reason = _amounts(task, scan)
    points, kept = measure_again(clean.points, noise_m, lost_share, rng)
    rows = clean.point_ids[kept]
    columns = dict(zip("xyz", points.T, strict=True))
    columns |= {} if scan.labels is None else {"label": scan.labels[rows]}
    columns |= {} if scan.instances is None else {"instance": scan.instances[rows]}
    amounts = {_NOISE_M: str(noise_m), _LOST_SHARE: str(lost_share), _REASON: reason}
    table = pa.table(columns).replace_schema_metadata({_KEY: task.key} | amounts)
    content = BytesIO()
    pq.write_table(table, content)
    write_whole(task.path, content.getbuffer())
    return Made({})


def _amounts(task: _Task, scan: Scan) -> tuple[float, float, str]:
    """Noise and losses of a measurement, and the reason if the scan does not show one that is requested."""
    noise_m, lost_share = task.recipe.noise_m, task.recipe.lost_share
    if AS_MEASURED not in (noise_m, lost_share):
        return float(noise_m), float(lost_share), ""
    sensor = describe_sensor(as_ros(scan.points, task.frame), scan.rings)
    reasons = []
    if noise_m == AS_MEASURED:
        reasons += [sensor.untold["range_noise_m"]] if sensor.range_noise_m is None else []
        noise_m = USUAL_NOISE_M if sensor.range_noise_m is None else sensor.range_noise_m
    if lost_share == AS_MEASURED:
        reasons += [sensor.untold["lost_share"]] if sensor.lost_in_all is None else []
        lost_share = USUAL_LOST_SHARE if sensor.lost_in_all is None else sensor.lost_in_all
    return float(noise_m), float(lost_share), "; ".join(dict.fromkeys(reasons))


def _manifest(pairs: list[ScanPair], partners: dict[str, ScanPair], names: dict[str, str]) -> str:
    """The pairs with the names of their measurements; a scan that cannot be read appears on both sides."""
    text = StringIO()
    rows = csv.writer(text, lineterminator="\n")
    rows.writerow(["pair_id", "real", "sim", "timestamp_s", "T_real_sim"])
    for pair in pairs:
        real = str(pair.real.absolute()) if pair.real else ""
        time_s = "" if pair.timestamp_s is None else repr(pair.timestamp_s)
        motion = " ".join(_motion(pair, partners[pair.pair_id]))
        rows.writerow([pair.pair_id, real, names.get(pair.pair_id, real), time_s, motion])
    return text.getvalue()


def _motion(pair: ScanPair, source: ScanPair) -> Iterator[str]:
    """T_real_sim of a neighbour, 12 numbers in words; none where a scan is measured again in its place."""
    if source is pair or pair.T_world_sensor is None or source.T_world_sensor is None:
        return
    T = np.linalg.solve(_square(pair.T_world_sensor), _square(source.T_world_sensor))
    yield from map(repr, T[:3].ravel().tolist())


def _square(motion: tuple[float, ...]) -> FloatArray:
    return np.vstack([np.reshape(motion, (3, 4)), [0.0, 0.0, 0.0, 1.0]])


#: It takes and gives no table: its results are the files of the dataset.
_STAGE = Stage(name="floor", takes={}, gives=(), grain=Grain.PAIR, version=RECIPE_VERSION, make=_make)
