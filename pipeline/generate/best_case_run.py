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
from ...schemas.errors import ScanError
from ...schemas.settings import InputSettings, Settings
from ...stages.arrays import FloatArray
from ...stages.clean import as_ros, clean_scan
from ...stages.generate.second_measurement import fill_gaps, remeasure
from ...stages.sensor_description import NO_GAPS, SurfaceGaps, describe_with_gaps
from ..datasets.pairs import LABEL_NAMES, MANIFEST, Dataset, ScanPair, read_dataset
from ..datasets.readers import read_scan
from ..datasets.readers.scan import Scan
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
from ..storage.files import csv_bytes, refuse_link, write_whole
from ..storage.folder import RunFolder, check_folder, refuse_overwrite
from ..storage.ledger import LEDGER
from ..storage.run_record import has_ended, read_run
from ..storage.table_files import file_stem
from ..storage.urls import name_in_records

RECIPE_VERSION = 3  # increase it when the same recipe results in other measurements
_DEFAULTS = (0.03, 0.03)  #: range noise in metres and lost share, if they cannot be measured
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
    """Raise `RunError` if a finished best case of another recipe would be replaced, unless it may be."""
    before = read_recipe(out)
    if before and before != recipe and has_ended(read_run(out)) and not replace:
        words = [f"{made.words}, of {made.dataset}" for made in (before, recipe)]
        refuse_overwrite(f"run {out}", "its scans", [words[0], f"requested: {words[1]}"])


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
            real = sim = ""
            if pair.real is not None:
                real = sim = str(pair.real.absolute())
                used = _write_measurement(path, pair, recipe, settings, source.label_names)
                if used is not None:
                    amounts.append(used)
                    sim = f"sim/{path.name}"
            rows.append((pair.pair_id, real, sim, pair.timestamp_s))
    if amounts and AS_MEASURED in (recipe.noise_m, recipe.lost_share):
        _report_amounts(np.array(amounts), reporter)
    write_whole(folder / MANIFEST, csv_bytes(["pair_id", "real", "sim", "timestamp_s"], rows))


def _write_measurement(
    path: Path,
    pair: ScanPair,
    recipe: BestCaseRecipe,
    settings: InputSettings,
    label_names: dict[int, str],
) -> FloatArray | None:
    """Write the measurement of a pair; returns its range noise and lost share, NaN if unknown.

    None if the scan cannot be read: the run, which reads it on both sides, reports that.
    """
    try:
        scan = read_scan(pair.scans["real"], settings.columns_of("real"), label_names)
    except ScanError:
        path.unlink(missing_ok=True)
        return None
    amounts, gaps = _amounts_of(scan, recipe, settings)
    rng = np.random.default_rng([recipe.seed, *pair.pair_id.encode()])
    content = BytesIO()
    pq.write_table(_remeasured(scan, amounts, gaps, rng), content)
    write_whole(path, content.getbuffer())
    return amounts


def _report_amounts(amounts: FloatArray, reporter: Reporter) -> None:
    """Show the medians of noise and losses of all scans; warn of those where they cannot be measured."""
    is_unknown = np.isnan(amounts)
    noise_m, lost_share = np.median(np.where(is_unknown, _DEFAULTS, amounts), axis=0)
    n_scans = len(amounts)
    reporter.say(
        f"range noise {1e3 * noise_m:.0f} mm, dropout {lost_share:.1%} (median of {n_scans} scans)"
    )
    n_unknown = np.count_nonzero(is_unknown.any(axis=1))
    if n_unknown:
        reporter.warn(
            f"{n_unknown} of {n_scans} real scans: noise or losses cannot be measured; used "
            f"{_DEFAULTS[0]:g} m and {_DEFAULTS[1]:.0%}; set --noise-m and --dropout"
        )


def _amounts_of(
    scan: Scan, recipe: BestCaseRecipe, settings: InputSettings
) -> tuple[FloatArray, SurfaceGaps]:
    """Range noise and lost share of a measurement, NaN if unknown, and the gaps whose pulses return.

    A second measurement loses other pulses than the first. If losses are those of the scan, the
    pulses that it lost within surfaces return; otherwise losses would add up to twice the share.
    """
    points = as_ros(scan.points, settings.frame_of("real"))
    sensor, gaps = describe_with_gaps(points, scan.rings)
    noise_m, lost_share = recipe.noise_m, recipe.lost_share
    is_restored = lost_share == AS_MEASURED and sensor.lost_share is not None
    amounts = [
        sensor.range_noise_m if noise_m == AS_MEASURED else noise_m,
        sensor.lost_share if lost_share == AS_MEASURED else lost_share,
    ]
    return np.array(amounts, dtype=np.float64), gaps if is_restored else NO_GAPS


def _remeasured(
    scan: Scan, amounts: FloatArray, gaps: SurfaceGaps, rng: np.random.Generator
) -> pa.Table:
    """One measurement: x, y, z, labels and instances if the scan has them."""
    noise_m, lost_share = np.where(np.isnan(amounts), _DEFAULTS, amounts)
    clean = clean_scan(scan.points, _ALL)
    filled, filled_ids = fill_gaps(scan.points, *gaps)
    all_points = np.concatenate([clean.points, filled])
    points, kept = remeasure(all_points, noise_m, lost_share, rng)
    rows = np.concatenate([clean.point_ids, filled_ids])[kept]
    columns = dict(zip("xyz", points.T, strict=True))
    if scan.labels is not None:
        columns["label"] = scan.labels[rows]
    if scan.instances is not None:
        columns["instance"] = scan.instances[rows]
    return pa.table(columns)
