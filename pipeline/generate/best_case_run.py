"""`fidpipe best-case`: scores of a perfect simulator.

Each real scan is compared with a simulated second measurement of itself.

The second measurements are a dataset in the run's folder. A measurement depends on the recipe, the real
scan and the pair's name alone; the manifest is written last.
"""

from __future__ import annotations

from contextlib import suppress
from io import BytesIO
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from ...schemas.columns import FARTHEST_M
from ...schemas.errors import DatasetError, RunError, ScanError
from ...schemas.settings import FrameName, InputSettings, Settings, load
from ...stages.clean import as_ros, clean_scan
from ...stages.generate.perturbations import fill_gaps, remeasure
from ...stages.sensor_description import NO_GAPS, SurfaceGaps, describe_with_gaps
from ..datasets.content import scan_content
from ..datasets.pairs import LABEL_NAMES, MANIFEST, Dataset, ScanPair, read_dataset
from ..datasets.readers import read_scan
from ..datasets.readers.scan import Scan
from ..datasets.readers.scan_ref import ScanRef
from ..engine.engine import Machines
from ..engine.pool import one_blas_thread
from ..engine.progress import Reporter
from ..engine.tasks import counting
from ..results.best_case import (
    AS_MEASURED,
    BEST_CASE_AMOUNTS,
    BEST_CASE_DATASET,
    BEST_CASE_RECIPE,
    BestCaseRecipe,
    read_recipe,
)
from ..results.finished import FinishedRun
from ..run import RunOutcome, run_dataset, select_pairs
from ..storage.files import csv_bytes, key_of, path_exists, refuse_link, write_whole
from ..storage.folder import RunFolder, check_folder, refuse_overwrite
from ..storage.ledger import Ledger
from ..storage.run_record import SETTINGS_TOML, has_ended, read_run
from ..storage.table_files import file_stem
from ..storage.urls import name_in_records, recorded_path
from .recordings import square

RECIPE_VERSION = 3  # increase it when the same recipe results in other measurements
DEFAULT_NOISE_M, DEFAULT_LOST_SHARE = 0.03, 0.03  # if they cannot be measured on a scan
_KEY, _NOISE_M, _LOST_SHARE, _REASON = b"fidpipe.best_case", b"noise_m", b"lost_share", b"reason"
_AMOUNTS = (_NOISE_M, _LOST_SHARE, _REASON)
#: Every measured point: the settings of the run crop both sides in the same way.
_ALL = InputSettings(min_range_m=0.0, max_range_m=FARTHEST_M)


def run_best_case(
    dataset: Path,
    out: Path,
    settings: Settings,
    reporter: Reporter,
    *,
    noise_m: float | None = None,
    lost_share: float | None = None,
    seed: int = 0,
    neighbours: bool = False,
    pattern: str | None = None,
    machines: Machines | None = None,
    replace: bool = False,
) -> RunOutcome:
    """Evaluate each real scan against a second measurement of itself; up-to-date measurements are reused.

    Parameters
    ----------
    settings : of all stages; those of the simulated side are ignored
    noise_m : standard deviation of the noise along the ray; None for that of each scan (`describe_sensor`)
    lost_share : share of the points that the second measurement lacks; None for that of each scan
    seed : of noise and losses
    neighbours : use the next real scan as the second measurement, transformed by the poses
    pattern : only pairs whose name matches (shell style)
    machines : workers
    replace : allow a finished best case of another recipe or other settings to be replaced

    Raises
    ------
    FidpipeError
        The dataset as a whole, a setting or the run's folder is wrong, the folder holds another finished best case,
        or poses are missing; before any work.
    """
    machines = machines or Machines()
    if machines.scheduler:  # workers of a cluster may run in other folders
        dataset, out = dataset.absolute(), out.absolute()
    source = read_dataset(dataset)
    name = name_in_records(dataset)
    if neighbours:
        recipe = BestCaseRecipe(RECIPE_VERSION, "neighbours", 0.0, 0.0, 0, name)
    else:
        noise = AS_MEASURED if noise_m is None else noise_m
        lost = AS_MEASURED if lost_share is None else lost_share
        recipe = BestCaseRecipe(RECIPE_VERSION, "again", noise, lost, seed, name)
    selected = {pair.pair_id for pair in select_pairs(source, pattern)}
    partners = _neighbours(source) if neighbours else {pair.pair_id: pair for pair in source.pairs}
    _refuse_other_recipe(out, recipe, replace=replace)
    check_folder(out, out / BEST_CASE_DATASET)
    folder = RunFolder(out)
    with folder.locked():
        _write_dataset(folder, recipe, source, partners, selected, settings.input, reporter)
    own = settings.input.model_copy(
        update={"sim_flip_y": False, "sim_frame": settings.input.real_frame, "sim_columns": None}
    )
    return run_dataset(
        out / BEST_CASE_DATASET,
        out,
        settings.model_copy(update={"input": own}),
        reporter,
        pattern=pattern,
        machines=machines,
        replace=replace,
    )


def source_of_run(folder: Path) -> tuple[Path, Settings]:
    """The dataset of a run, and the settings of the run.

    Raises
    ------
    FidpipeError
        The folder is not a run that has ended, or its settings cannot be read.
    """
    run = FinishedRun(folder)
    return recorded_path(run.record.dataset), load(folder / SETTINGS_TOML)


def _neighbours(dataset: Dataset) -> dict[str, ScanPair]:
    """The next real scan of each pair, by time if known, else by name; the previous one for the last pair."""
    frames = [pair for pair in dataset.pairs if pair.real is not None]
    unposed = next((pair.pair_id for pair in frames if pair.T_world_sensor is None), None)
    if unposed is not None:
        raise DatasetError(
            f"dataset {dataset.folder}: pair {unposed} has no pose; --neighbours needs the column T_world_sensor in "
            f"{MANIFEST} (12 numbers, [R | t] row by row), as fidpipe twin writes it"
        )
    if len(frames) < 2:
        raise DatasetError(f"dataset {dataset.folder}: --neighbours: expected at least 2 real scans, got {len(frames)}")
    if all(pair.timestamp_s is not None for pair in frames):
        frames.sort(key=lambda pair: (pair.timestamp_s, pair.pair_id))
    after = dict(zip((pair.pair_id for pair in frames), [*frames[1:], frames[-2]], strict=True))
    return {pair.pair_id: after.get(pair.pair_id, pair) for pair in dataset.pairs}


def _refuse_other_recipe(out: Path, recipe: BestCaseRecipe, *, replace: bool) -> None:
    """Raise `RunError` if another run would be replaced, or without `replace` another finished recipe."""
    before, record = read_recipe(out), read_run(out)
    if before is None and record:
        raise RunError(f"run {out}: holds a run of {record.get('dataset')}, not a best case; give another --out")
    if before is None or before == recipe:
        return
    if before.dataset != recipe.dataset and path_exists(recorded_path(before.dataset)):
        raise RunError(
            f"run {out}: holds the best case of {before.dataset}, not of {recipe.dataset}; give another --out"
        )
    if before.words != recipe.words and has_ended(record) and not replace:
        refuse_overwrite(f"run {out}", "its scans", [before.words, f"requested: {recipe.words}"])


def _write_dataset(
    run: RunFolder,
    recipe: BestCaseRecipe,
    source: Dataset,
    partners: dict[str, ScanPair],
    selected: set[str],
    settings: InputSettings,
    reporter: Reporter,
) -> None:
    """Write the dataset: remove files of another recipe or of other real scans, then add the missing ones."""
    folder = run.folder / BEST_CASE_DATASET
    refuse_link(folder / "sim")
    (folder / MANIFEST).unlink(missing_ok=True)
    paths = {pair.pair_id: folder / "sim" / f"{file_stem(pair.pair_id)}.parquet" for pair in source.pairs}
    scans = {name: partner.real for name, partner in partners.items() if partner.real is not None}
    keys = {
        name: _key(recipe, name, scan, settings, source.label_names, run.ledger)
        for name, scan in scans.items()
        if name in selected or paths[name].exists()
    }
    current = {name for name, key in keys.items() if _metadata(paths[name]).get(_KEY, b"").decode() == key}
    for path in {*(folder / "sim").glob("*.parquet")} - {paths[name] for name in current}:
        path.unlink()
    write_whole(folder / BEST_CASE_RECIPE, recipe.to_toml().encode())
    if (label_names := source.folder / LABEL_NAMES).exists():
        write_whole(folder / LABEL_NAMES, label_names.read_bytes())
    else:
        (folder / LABEL_NAMES).unlink(missing_ok=True)
    missing = [name for name in keys if name in selected - current]
    with counting(reporter) as pair_done, one_blas_thread():  # in this process: a hundredth of the run's time
        for n_done, name in enumerate(missing, 1):
            with suppress(ScanError):  # reported by the run, which reads it too
                scan = read_scan(scans[name], settings.columns_of("real"), source.label_names)
                again = _remeasured(scan, name, recipe, settings.frame_of("real"), keys[name])
                content = BytesIO()
                pq.write_table(again, content)
                write_whole(paths[name], content.getbuffer())
            pair_done(n_done, len(missing))
    names = {name: f"sim/{paths[name].name}" for name in keys if paths[name].exists()}
    if AS_MEASURED in (recipe.noise_m, recipe.lost_share):
        _report_amounts({name: _metadata(paths[name]) for name in names}, folder, reporter)
    pairs = [pair for pair in source.pairs if pair.pair_id in selected | current]
    rows = (_row(pair, partners[pair.pair_id], names) for pair in pairs)
    write_whole(folder / MANIFEST, csv_bytes(["pair_id", "real", "sim", "timestamp_s", "T_real_sim"], rows))


def _report_amounts(by_pair: dict[str, dict[bytes, bytes]], folder: Path, reporter: Reporter) -> None:
    """Write and show noise and losses of the second measurements; warn of scans where they cannot be measured."""
    rows = []
    for pair_id, metadata in by_pair.items():
        rows.append([pair_id, *(metadata[name].decode() for name in _AMOUNTS)])
    write_whole(folder / BEST_CASE_AMOUNTS, csv_bytes(["pair_id", *(name.decode() for name in _AMOUNTS)], rows))
    amounts = list(by_pair.values())
    if not amounts:
        return
    noise_m = np.median([float(metadata[_NOISE_M]) for metadata in amounts])
    lost_share = np.median([float(metadata[_LOST_SHARE]) for metadata in amounts])
    reporter.say(f"range noise {1e3 * noise_m:.0f} mm, dropout {lost_share:.1%} (median of {len(amounts)} scans)")
    unknown = [own[_REASON].decode() for own in amounts if own[_REASON]]
    if unknown:
        reporter.warn(
            f"{len(unknown)} of {len(amounts)} real scans: noise or losses cannot be measured ({unknown[0]}); "
            f"used {DEFAULT_NOISE_M:g} m and {DEFAULT_LOST_SHARE:.0%}; set --noise-m and --dropout"
        )


def _key(
    recipe: BestCaseRecipe,
    pair_id: str,
    scan: ScanRef,
    settings: InputSettings,
    label_names: dict[int, str],
    ledger: Ledger,
) -> str:
    """Hash of all that the second measurement of a scan depends on."""
    hashes = ("", "")
    with suppress(ScanError):  # reported by the run that follows
        content = scan_content(scan, ledger.input_hash)
        hashes = content.sha256, content.label_sha256
    reading = settings.columns_of("real"), settings.frame_of("real")
    return key_of(RECIPE_VERSION, recipe.words, pair_id, hashes, sorted(label_names.items()), *reading)


def _metadata(path: Path) -> dict[bytes, bytes]:
    """Key, noise and losses of a measurement; empty if it is missing or damaged."""
    try:
        return pq.read_schema(path).metadata or {}
    except (OSError, pa.ArrowInvalid):
        return {}


def _remeasured(scan: Scan, pair_id: str, recipe: BestCaseRecipe, frame: FrameName, key: str) -> pa.Table:
    """One measurement: x, y, z, and labels and instances of the points if the scan has them."""
    clean = clean_scan(scan.points, _ALL)
    rng = np.random.default_rng([recipe.seed, *pair_id.encode()])
    noise_m, lost_share, reason, gaps = _amounts(recipe, scan, frame)
    filled, filled_ids = fill_gaps(scan.points, *gaps)
    points, kept = remeasure(np.concatenate([clean.points, filled]), noise_m, lost_share, rng)
    rows = np.concatenate([clean.point_ids, filled_ids])[kept]
    columns = dict(zip("xyz", points.T, strict=True))
    columns |= {} if scan.labels is None else {"label": scan.labels[rows]}
    columns |= {} if scan.instances is None else {"instance": scan.instances[rows]}
    amounts = {_NOISE_M: str(noise_m), _LOST_SHARE: str(lost_share), _REASON: reason}
    return pa.table(columns).replace_schema_metadata({_KEY: key} | amounts)


def _amounts(recipe: BestCaseRecipe, scan: Scan, frame: FrameName) -> tuple[float, float, str, SurfaceGaps]:
    """Noise and losses of a measurement, the reason if one of them cannot be measured, and the gaps that it fills.

    A second measurement loses other pulses than the first. If losses are those of the scan, the pulses that it lost
    within surfaces return; otherwise losses would add up to twice the share.
    """
    noise_m, lost_share = recipe.noise_m, recipe.lost_share
    if AS_MEASURED not in (noise_m, lost_share):
        return float(noise_m), float(lost_share), "", NO_GAPS
    sensor, gaps = describe_with_gaps(as_ros(scan.points, frame), scan.rings)
    if lost_share != AS_MEASURED or sensor.lost_in_all is None:
        gaps = NO_GAPS
    reasons, amounts = [], []
    for name, amount, measured, default in (
        ("range_noise_m", noise_m, sensor.range_noise_m, DEFAULT_NOISE_M),
        ("lost_share", lost_share, sensor.lost_in_all, DEFAULT_LOST_SHARE),
    ):
        reasons += [sensor.untold[name]] if amount == AS_MEASURED and measured is None else []
        usual = default if measured is None else measured
        amounts.append(float(usual if amount == AS_MEASURED else amount))
    return amounts[0], amounts[1], "; ".join(dict.fromkeys(reasons)), gaps


def _row(pair: ScanPair, source: ScanPair, names: dict[str, str]) -> tuple[str, ...]:
    """The row of a pair in the manifest; an unreadable scan appears on both sides."""
    real = str(pair.real.absolute()) if pair.real else ""
    time_s = "" if pair.timestamp_s is None else repr(pair.timestamp_s)
    own, other, motion = pair.T_world_sensor, source.T_world_sensor, ""
    if source is not pair and own is not None and other is not None:
        motion = " ".join(map(repr, np.linalg.solve(square(own), square(other))[:3].ravel().tolist()))
    return pair.pair_id, real, names.get(pair.pair_id, real), time_s, motion
