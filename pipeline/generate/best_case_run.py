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
from ...stages.clean import as_ros, clean_scan
from ...stages.generate.second_measurement import fill_gaps, remeasure
from ...stages.sensor_description import NO_GAPS, SurfaceGaps, describe_with_gaps
from ..datasets.pairs import MANIFEST, Dataset, read_dataset
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
from .dataset_folder import write_label_names

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
        _write_dataset(
            out / BEST_CASE_DATASET, recipe, source, selected, settings.input, reporter
        )
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
    write_label_names(folder, source.label_names)
    paths = {
        pair: folder / "sim" / f"{file_stem(pair.pair_id)}.parquet" for pair in source.pairs
    }
    wanted = [pair for pair in paths if pair.pair_id in selected or paths[pair].exists()]
    rows = []
    unknown = []
    with one_blas_thread():  # a hundredth of the run's time
        for pair in reporter.counted(wanted, len(wanted)):
            path = paths[pair]
            real = sim = ""
            if pair.real is not None:
                real = sim = str(pair.real.absolute())
                try:
                    scan = read_scan(pair.real, settings.columns_of("real"), source.label_names)
                except ScanError:
                    # reported by the run, which reads the real scan on both sides
                    path.unlink(missing_ok=True)
                else:
                    sim = f"sim/{path.name}"
                    if not _write_measurement(path, pair.pair_id, scan, recipe, settings):
                        unknown.append(pair.pair_id)
            rows.append((pair.pair_id, real, sim, pair.timestamp_s))
    if unknown:
        reporter.warn(
            f"{len(unknown)} of {len(wanted)} real scans: noise or losses cannot be measured; used "
            f"{DEFAULT_NOISE_M:g} m and {DEFAULT_LOST_SHARE:.0%}; set --noise-m and --dropout"
        )
    write_whole(folder / MANIFEST, csv_bytes(["pair_id", "real", "sim", "timestamp_s"], rows))


def _write_measurement(
    path: Path,
    pair_id: str,
    scan: Scan,
    recipe: BestCaseRecipe,
    settings: InputSettings,
) -> bool:
    """Write the measurement of a pair; returns False if noise or losses are to be those of the scan but unknown.

    A second measurement loses other pulses than the first. If losses are those of the scan, the
    pulses that it lost within surfaces return; otherwise losses would add up to twice the share.
    """
    points = as_ros(scan.points, settings.frame_of("real"))
    sensor, gaps = describe_with_gaps(points, scan.rings)
    noise_m = sensor.range_noise_m if recipe.noise_m == AS_MEASURED else recipe.noise_m
    lost_share = sensor.lost_share if recipe.lost_share == AS_MEASURED else recipe.lost_share
    if recipe.lost_share != AS_MEASURED or lost_share is None:
        gaps = NO_GAPS
    is_known = noise_m is not None and lost_share is not None
    noise_m = DEFAULT_NOISE_M if noise_m is None else noise_m
    lost_share = DEFAULT_LOST_SHARE if lost_share is None else lost_share
    rng = np.random.default_rng([recipe.seed, *pair_id.encode()])
    content = BytesIO()
    pq.write_table(_remeasured(scan, gaps, noise_m, lost_share, rng), content)
    write_whole(path, content.getbuffer())
    return is_known


def _remeasured(
    scan: Scan,
    gaps: SurfaceGaps,
    noise_m: float,
    lost_share: float,
    rng: np.random.Generator,
) -> pa.Table:
    """One measurement: x, y, z, labels and instances if the scan has them."""
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
