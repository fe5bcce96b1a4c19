"""`fidpipe best-case`: scores of a perfect simulator.

Each real scan is compared with a simulated second measurement of itself.

The second measurements are a dataset in the run's folder. A measurement depends on the recipe, the real
scan and the pair's name alone, so that a repeated command finds the same files; the manifest is written last.
"""

from __future__ import annotations

from io import BytesIO
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from ...schemas.columns import FARTHEST_M
from ...schemas.errors import RunError, ScanError
from ...schemas.settings import InputSettings, Settings
from ...stages.clean import as_ros, clean_scan
from ...stages.generate.second_measurement import fill_gaps, remeasure
from ...stages.sensor_description import NO_GAPS, describe_with_gaps
from ..datasets.pairs import LABEL_NAMES, MANIFEST, Dataset, ScanPair, read_dataset
from ..datasets.readers import read_scan
from ..engine.engine import Machines
from ..engine.pool import one_blas_thread
from ..engine.progress import Reporter
from ..results.best_case import (
    AS_MEASURED,
    BEST_CASE_DATASET,
    BEST_CASE_RECIPE,
    BestCaseRecipe,
    read_recipe,
)
from ..run import RunOutcome, run_dataset, select_pairs
from ..storage.files import csv_bytes, path_exists, refuse_link, write_whole
from ..storage.folder import RunFolder, check_folder, refuse_overwrite
from ..storage.ledger import LEDGER
from ..storage.run_record import has_ended, read_run
from ..storage.table_files import file_stem
from ..storage.urls import name_in_records, recorded_path

RECIPE_VERSION = 3  # increase it when the same recipe results in other measurements
DEFAULT_NOISE_M = 0.03  # if it cannot be measured on a scan
DEFAULT_LOST_SHARE = 0.03
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
    pattern: str | None = None,
    machines: Machines | None = None,
    replace: bool = False,
) -> RunOutcome:
    """Evaluate each real scan against a second measurement of itself.

    Parameters
    ----------
    settings : of all stages; those of the simulated side are ignored
    noise_m : standard deviation of the noise along the ray; None for that of each scan (`describe_sensor`)
    lost_share : share of the points that the second measurement lacks; None for that of each scan
    seed : of noise and losses
    pattern : only pairs whose name matches (shell style)
    machines : workers
    replace : allow a finished best case of another recipe or other settings to be replaced

    Raises
    ------
    FidpipeError
        The dataset as a whole, a setting or the run's folder is wrong, or the folder holds another finished best
        case; before any work.
    """
    source = read_dataset(dataset)
    recipe = BestCaseRecipe(
        RECIPE_VERSION,
        AS_MEASURED if noise_m is None else noise_m,
        AS_MEASURED if lost_share is None else lost_share,
        seed,
        name_in_records(dataset),
    )
    selected = {pair.pair_id for pair in select_pairs(source, pattern)}
    _refuse_other_recipe(out, recipe, replace=replace)
    check_folder(out, out / BEST_CASE_DATASET)
    folder = RunFolder(out)
    with folder.locked():
        (out / LEDGER).mkdir(exist_ok=True)  # from now on it is the folder of a run
        _write_dataset(out / BEST_CASE_DATASET, recipe, source, selected, settings.input, reporter)
    same_on_both_sides = settings.input.model_copy(
        update={"sim_frame": settings.input.real_frame, "sim_columns": None}
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


def _refuse_other_recipe(out: Path, recipe: BestCaseRecipe, *, replace: bool) -> None:
    """Raise `RunError` if the best case of another dataset, or without `replace` a finished one, would be replaced."""
    before = read_recipe(out)
    if before is None:
        return
    if before.dataset != recipe.dataset and path_exists(recorded_path(before.dataset)):
        raise RunError(f"run {out}: holds the best case of {before.dataset}; give another --out")
    if before.words != recipe.words and has_ended(read_run(out)) and not replace:
        refuse_overwrite(f"run {out}", "its scans", [before.words, f"requested: {recipe.words}"])


def _write_dataset(
    folder: Path,
    recipe: BestCaseRecipe,
    source: Dataset,
    selected: set[str],
    settings: InputSettings,
    reporter: Reporter,
) -> None:
    """Write the measurements of the selected pairs and of those that already have one, then the manifest."""
    refuse_link(folder / "sim")
    (folder / MANIFEST).unlink(missing_ok=True)
    write_whole(folder / BEST_CASE_RECIPE, recipe.to_toml().encode())
    (folder / LABEL_NAMES).unlink(missing_ok=True)
    if (source.folder / LABEL_NAMES).exists():
        write_whole(folder / LABEL_NAMES, (source.folder / LABEL_NAMES).read_bytes())
    wanted = []
    for pair in source.pairs:
        path = folder / "sim" / f"{file_stem(pair.pair_id)}.parquet"
        if pair.pair_id in selected or path.exists():
            wanted.append((pair, path))
    rows = []
    amounts = []
    with one_blas_thread():  # a hundredth of the run's time
        for pair, path in reporter.counted(wanted, len(wanted)):
            real = sim = str(pair.real.absolute()) if pair.real else ""
            try:
                table, used = _remeasured(pair, recipe, settings, source.label_names)
            except ScanError:  # reported by the run, which reads the real scan on both sides
                path.unlink(missing_ok=True)
            else:
                content = BytesIO()
                pq.write_table(table, content)
                write_whole(path, content.getbuffer())
                amounts.append(used)
                sim = f"sim/{path.name}"
            rows.append((pair.pair_id, real, sim, pair.timestamp_s))
    if amounts and AS_MEASURED in (recipe.noise_m, recipe.lost_share):
        _report_amounts(amounts, reporter)
    write_whole(folder / MANIFEST, csv_bytes(["pair_id", "real", "sim", "timestamp_s"], rows))


def _report_amounts(amounts: list[tuple[float, float, str]], reporter: Reporter) -> None:
    """Show the medians of noise and losses; warn of scans where they cannot be measured."""
    n_scans = len(amounts)
    noise_m, lost_share = np.median([row[:2] for row in amounts], axis=0)
    reporter.say(
        f"range noise {1e3 * noise_m:.0f} mm, dropout {lost_share:.1%} (median of {n_scans} scans)"
    )
    reasons = [row[2] for row in amounts if row[2]]
    if reasons:
        reporter.warn(
            f"{len(reasons)} of {n_scans} real scans: noise or losses cannot be measured ({reasons[0]}); "
            f"used {DEFAULT_NOISE_M:g} m and {DEFAULT_LOST_SHARE:.0%}; set --noise-m and --dropout"
        )


def _remeasured(
    pair: ScanPair,
    recipe: BestCaseRecipe,
    settings: InputSettings,
    label_names: dict[int, str],
) -> tuple[pa.Table, tuple[float, float, str]]:
    """One measurement: x, y, z, labels and instances if the scan has them; its noise, losses and what was assumed.

    A second measurement loses other pulses than the first. If losses are those of the scan, the
    pulses that it lost within surfaces return; otherwise losses would add up to twice the share.
    """
    scan = read_scan(pair.scans["real"], settings.columns_of("real"), label_names)
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
                reasons.append(sensor.why_unknown("range_noise_m"))
        if lost_share == AS_MEASURED:
            lost_share = sensor.lost_share or 0.0
            gaps = gaps_of_scan
            if sensor.lost_share is None:
                lost_share = DEFAULT_LOST_SHARE
                gaps = NO_GAPS
                reasons.append(sensor.why_unknown("lost_share"))
    clean = clean_scan(scan.points, _ALL)
    filled, filled_ids = fill_gaps(scan.points, *gaps)
    rng = np.random.default_rng([recipe.seed, *pair.pair_id.encode()])
    all_points = np.concatenate([clean.points, filled])
    points, kept = remeasure(all_points, float(noise_m), float(lost_share), rng)
    rows = np.concatenate([clean.point_ids, filled_ids])[kept]
    columns = dict(zip("xyz", points.T, strict=True))
    if scan.labels is not None:
        columns["label"] = scan.labels[rows]
    if scan.instances is not None:
        columns["instance"] = scan.instances[rows]
    known_reasons = dict.fromkeys(filter(None, reasons))
    return pa.table(columns), (float(noise_m), float(lost_share), "; ".join(known_reasons))
