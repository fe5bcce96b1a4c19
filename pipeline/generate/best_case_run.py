"""`fidpipe best-case`: scores of a perfect simulator.

Each real scan is compared with a simulated second measurement of itself.

The second measurements are a dataset in the run's folder. A measurement depends on the recipe, the real
scan and the pair's name alone; the manifest is written last.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from ...schemas.columns import FARTHEST_M
from ...schemas.errors import DatasetError, RunError, ScanError
from ...schemas.settings import InputSettings, Settings, load
from ...stages.clean import as_ros, clean_scan
from ...stages.generate.perturbations import fill_gaps, remeasure
from ...stages.sensor_description import NO_GAPS, describe_with_gaps
from ..datasets.content import scan_content
from ..datasets.pairs import LABEL_NAMES, MANIFEST, Dataset, ScanPair, read_dataset
from ..datasets.readers import read_scan
from ..engine.engine import Machines
from ..engine.pool import one_blas_thread
from ..engine.progress import Reporter
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
from ..storage.run_record import SETTINGS_TOML, has_ended, read_run
from ..storage.table_files import file_stem
from ..storage.urls import name_in_records, recorded_path
from .recordings import square

RECIPE_VERSION = 3  # increase it when the same recipe results in other measurements
DEFAULT_NOISE_M = 0.03  # if it cannot be measured on a scan
DEFAULT_LOST_SHARE = 0.03
_KEY = "fidpipe.best_case"
_AMOUNTS = ("noise_m", "lost_share", "reason")
#: Every measured point: the settings of the run crop both sides in the same way.
_ALL = InputSettings(min_range_m=0.0, max_range_m=FARTHEST_M)


@dataclass(frozen=True)
class _Measurement:
    """A second measurement to be made.

    scan_of : the pair whose real scan it is made of
    path : its file
    key : hash of everything that it depends on
    """

    pair: ScanPair
    scan_of: ScanPair
    path: Path
    key: str

    def metadata(self) -> dict[str, str]:
        """Key, noise and losses of the file; empty if it is missing or damaged."""
        try:
            metadata = pq.read_schema(self.path).metadata or {}
        except (OSError, pa.ArrowInvalid):
            return {}
        return {name.decode(): value.decode() for name, value in metadata.items()}

    def is_current(self) -> bool:
        """True if the file exists and has the key."""
        return self.metadata().get(_KEY) == self.key


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
        dataset = dataset.absolute()
        out = out.absolute()
    source = read_dataset(dataset)
    name = name_in_records(dataset)
    if neighbours:
        recipe = BestCaseRecipe(RECIPE_VERSION, "neighbours", 0.0, 0.0, 0, name)
        scans_of = _neighbours(source)
    else:
        noise = AS_MEASURED if noise_m is None else noise_m
        lost = AS_MEASURED if lost_share is None else lost_share
        recipe = BestCaseRecipe(RECIPE_VERSION, "again", noise, lost, seed, name)
        scans_of = {pair.pair_id: pair for pair in source.pairs}
    selected = {pair.pair_id for pair in select_pairs(source, pattern)}
    _refuse_other_recipe(out, recipe, replace=replace)
    check_folder(out, out / BEST_CASE_DATASET)
    folder = RunFolder(out)
    with folder.locked():
        _write_dataset(folder, recipe, source, scans_of, selected, settings.input, reporter)
    same_on_both_sides = settings.input.model_copy(
        update={"sim_flip_y": False, "sim_frame": settings.input.real_frame, "sim_columns": None}
    )
    return run_dataset(
        out / BEST_CASE_DATASET,
        out,
        settings.model_copy(update={"input": same_on_both_sides}),
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
    for pair in frames:
        if pair.T_world_sensor is None:
            raise DatasetError(
                f"dataset {dataset.folder}: pair {pair.pair_id} has no pose; --neighbours needs the "
                f"column T_world_sensor in {MANIFEST} (12 numbers, [R | t] row by row), as fidpipe "
                "twin writes it"
            )
    if len(frames) < 2:
        raise DatasetError(
            f"dataset {dataset.folder}: --neighbours: expected at least 2 real scans, got {len(frames)}"
        )
    if all(pair.timestamp_s is not None for pair in frames):
        frames.sort(key=lambda pair: (pair.timestamp_s, pair.pair_id))
    nearest = {pair.pair_id: pair for pair in dataset.pairs}
    for pair, after in zip(frames, [*frames[1:], frames[-2]], strict=True):
        nearest[pair.pair_id] = after
    return nearest


def _refuse_other_recipe(out: Path, recipe: BestCaseRecipe, *, replace: bool) -> None:
    """Raise `RunError` if the best case of another dataset, or without `replace` a finished one, would be replaced."""
    before = read_recipe(out)
    if before is None:
        return
    if before.dataset != recipe.dataset and path_exists(recorded_path(before.dataset)):
        raise RunError(
            f"run {out}: holds the best case of {before.dataset}, not of {recipe.dataset}; give another --out"
        )
    if before.words != recipe.words and has_ended(read_run(out)) and not replace:
        changes = [before.words, f"requested: {recipe.words}"]
        refuse_overwrite(f"run {out}", "its scans", changes)


def _write_dataset(
    run: RunFolder,
    recipe: BestCaseRecipe,
    source: Dataset,
    scans_of: dict[str, ScanPair],
    selected: set[str],
    settings: InputSettings,
    reporter: Reporter,
) -> None:
    """Write the selected measurements that are missing, and a manifest of all that are current."""
    folder = run.folder / BEST_CASE_DATASET
    refuse_link(folder / "sim")
    (folder / MANIFEST).unlink(missing_ok=True)
    write_whole(folder / BEST_CASE_RECIPE, recipe.to_toml().encode())
    (folder / LABEL_NAMES).unlink(missing_ok=True)
    if (source.folder / LABEL_NAMES).exists():
        write_whole(folder / LABEL_NAMES, (source.folder / LABEL_NAMES).read_bytes())
    shown = []
    missing = []
    for pair in source.pairs:
        scan_of = scans_of[pair.pair_id]
        path = folder / "sim" / f"{file_stem(pair.pair_id)}.parquet"
        key = ""
        if pair.pair_id in selected or path.exists():
            key = _key(recipe, pair, scan_of, settings, source, run)
        measurement = _Measurement(pair, scan_of, path, key)
        is_current = measurement.is_current()
        if pair.pair_id in selected or is_current:
            shown.append(measurement)
        if not is_current:
            path.unlink(missing_ok=True)
        if pair.pair_id in selected and not is_current and scan_of.real is not None:
            missing.append(measurement)
    with one_blas_thread():  # a hundredth of the run's time
        for measurement in reporter.counted(missing, len(missing)):
            with suppress(ScanError):  # reported by the run, which reads it too
                content = BytesIO()
                table = _remeasured(measurement, recipe, settings, source.label_names)
                pq.write_table(table, content)
                write_whole(measurement.path, content.getbuffer())
    if AS_MEASURED in (recipe.noise_m, recipe.lost_share):
        _report_amounts(shown, folder, reporter)
    columns = ["pair_id", "real", "sim", "timestamp_s", "T_real_sim"]
    write_whole(folder / MANIFEST, csv_bytes(columns, map(_row, shown)))


def _report_amounts(measurements: list[_Measurement], folder: Path, reporter: Reporter) -> None:
    """Write and show noise and losses of the second measurements; warn of scans where they cannot be measured."""
    rows = []
    for measurement in measurements:
        metadata = measurement.metadata()
        if metadata:
            amounts = [metadata[name] for name in _AMOUNTS]
            rows.append((measurement.pair.pair_id, *amounts))
    write_whole(folder / BEST_CASE_AMOUNTS, csv_bytes(["pair_id", *_AMOUNTS], rows))
    if not rows:
        return
    noise_m = np.median([float(row[1]) for row in rows])
    lost_share = np.median([float(row[2]) for row in rows])
    reporter.say(
        f"range noise {1e3 * noise_m:.0f} mm, dropout {lost_share:.1%} (median of {len(rows)} scans)"
    )
    reasons = [row[3] for row in rows if row[3]]
    if reasons:
        reporter.warn(
            f"{len(reasons)} of {len(rows)} real scans: noise or losses cannot be measured ({reasons[0]}); "
            f"used {DEFAULT_NOISE_M:g} m and {DEFAULT_LOST_SHARE:.0%}; set --noise-m and --dropout"
        )


def _key(
    recipe: BestCaseRecipe,
    pair: ScanPair,
    scan_of: ScanPair,
    settings: InputSettings,
    source: Dataset,
    run: RunFolder,
) -> str:
    """Hash of all that the second measurement of a scan depends on."""
    hashes = ("", "")
    if scan_of.real is not None:
        with suppress(ScanError):  # reported by the run that follows
            content = scan_content(scan_of.real, run.ledger.input_hash)
            hashes = (content.sha256, content.label_sha256)
    return key_of(
        RECIPE_VERSION,
        recipe.words,
        pair.pair_id,
        hashes,
        sorted(source.label_names.items()),
        settings.columns_of("real"),
        settings.frame_of("real"),
    )


def _remeasured(
    measurement: _Measurement,
    recipe: BestCaseRecipe,
    settings: InputSettings,
    label_names: dict[int, str],
) -> pa.Table:
    """One measurement: x, y, z, and labels and instances of the points if the scan has them.

    A second measurement loses other pulses than the first. If losses are those of the scan, the
    pulses that it lost within surfaces return; otherwise losses would add up to twice the share.
    """
    real = measurement.scan_of.scans["real"]
    scan = read_scan(real, settings.columns_of("real"), label_names)
    noise_m = recipe.noise_m
    lost_share = recipe.lost_share
    gaps = NO_GAPS
    reasons = []
    if AS_MEASURED in (noise_m, lost_share):
        axes = as_ros(scan.points, settings.frame_of("real"))
        sensor, gaps_of_scan = describe_with_gaps(axes, scan.rings)
        if noise_m == AS_MEASURED:
            noise_m = sensor.range_noise_m or 0.0
            if sensor.range_noise_m is None:
                noise_m = DEFAULT_NOISE_M
                reasons.append(sensor.untold["range_noise_m"])
        if lost_share == AS_MEASURED:
            lost_share = sensor.lost_in_all or 0.0
            gaps = gaps_of_scan
            if sensor.lost_in_all is None:
                lost_share = DEFAULT_LOST_SHARE
                gaps = NO_GAPS
                reasons.append(sensor.untold["lost_share"])
    reason = "; ".join(dict.fromkeys(reasons))
    clean = clean_scan(scan.points, _ALL)
    filled, filled_ids = fill_gaps(scan.points, *gaps)
    rng = np.random.default_rng([recipe.seed, *measurement.pair.pair_id.encode()])
    all_points = np.concatenate([clean.points, filled])
    points, kept = remeasure(all_points, float(noise_m), float(lost_share), rng)
    rows = np.concatenate([clean.point_ids, filled_ids])[kept]
    columns = dict(zip("xyz", points.T, strict=True))
    if scan.labels is not None:
        columns["label"] = scan.labels[rows]
    if scan.instances is not None:
        columns["instance"] = scan.instances[rows]
    metadata = {_KEY: measurement.key, "noise_m": str(noise_m), "lost_share": str(lost_share)}
    return pa.table(columns).replace_schema_metadata({**metadata, "reason": reason})


def _row(measurement: _Measurement) -> tuple[str, ...]:
    """The row of a pair in the manifest; an unreadable scan appears on both sides."""
    pair = measurement.pair
    scan_of = measurement.scan_of
    real = str(pair.real.absolute()) if pair.real else ""
    path = measurement.path
    sim = f"sim/{path.name}" if path.exists() else real
    time_s = "" if pair.timestamp_s is None else repr(pair.timestamp_s)
    motion = ""
    if scan_of is not pair and pair.T_world_sensor and scan_of.T_world_sensor:
        T = np.linalg.solve(square(pair.T_world_sensor), square(scan_of.T_world_sensor))
        motion = " ".join(map(repr, T[:3].ravel().tolist()))
    return pair.pair_id, real, sim, time_s, motion
