"""`fidpipe synth`: a synthetic dataset of ray-cast streets and their flawed twins."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from ...schemas.columns import SIDES
from ...schemas.errors import FidpipeError
from ...schemas.sensor_models import SENSORS
from ...stages.generate.ray_casting import require_ray_caster
from ...stages.generate.street_objects import KINDS
from ...stages.generate.street_scans import make_pair
from ..datasets.pairs import MANIFEST
from ..engine.progress import Reporter
from ..engine.tasks import map_tasks
from ..storage.files import csv_bytes, named_errors, write_whole
from .dataset_folder import Recipe, prepare_folder

RECIPE = "synth.toml"
RECIPE_VERSION = 2  # increase it when the same recipe results in other scans
SECONDS_APART = 75.0
_SUFFIXES = (".bin", ".label")
#: Files of pairs, and temporary files of a killed process.
_OWN_FILE = re.compile(r"\d{4,}\.(bin|label)|\.\d{4,}\.(bin|label)\.[0-9a-f]{8}")


def make_dataset(
    out: Path,
    reporter: Reporter,
    *,
    n_pairs: int = 50,
    seed: int = 0,
    sensor: str = "vlp32c",
    n_points: int | None = None,
    workers: int = 1,
    replace: bool = False,
) -> None:
    """Write the dataset; existing pairs of the same recipe are kept.

    Parameters
    ----------
    n_pairs : number of streets
    seed : of the streets
    sensor : a name in `SENSORS`
    n_points : approximate size of a real scan; by default that of the sensor
    workers : processes; they affect only the time
    replace : allow pairs of a finished dataset to be removed

    Raises
    ------
    FidpipeError
        embreex is missing, or the folder holds something else or a finished dataset whose pairs
        would be removed.
    """
    require_ray_caster()
    recipe = recipe_of(seed, sensor, n_points)
    names = [pair_name(index) for index in range(n_pairs)]
    with named_errors(out):
        files = {path for name in names for path in _files(out, name)}
        prepare_folder(
            out,
            RECIPE,
            recipe,
            _own_files,
            files,
            dict(enumerate(KINDS)),
            replace=replace,
        )
        tasks = {}
        for index, name in enumerate(names):
            if not all(path.exists() for path in _files(out, name)):
                tasks[name] = (out, recipe, index)
        if 0 < len(tasks) < n_pairs:
            reporter.say(f"{n_pairs - len(tasks)} of {n_pairs} pairs already exist")
        _, failures = map_tasks(write_pair, tasks, reporter, n_workers=workers)
        if failures:
            raise FidpipeError(f"dataset {out}: {next(iter(failures.values()))}")
        rows = []
        for index, name in enumerate(names):
            time_s = SECONDS_APART * (index + 1)
            rows.append((name, f"real/{name}.bin", f"sim/{name}.bin", f"{time_s:.3f}"))
        write_whole(out / MANIFEST, csv_bytes(["pair_id", "real", "sim", "timestamp_s"], rows))


def recipe_of(seed: int, sensor: str, n_points: int | None) -> Recipe:
    """Everything that the scans of a pair depend on, except its index."""
    recipe = {"version": RECIPE_VERSION, "seed": seed, "sensor": sensor}
    if n_points is not None:
        recipe["points"] = n_points
    return recipe


def write_pair(task: tuple[Path, Recipe, int]) -> None:
    """Write the four files of a pair, given folder, recipe and index; their content depends on the latter two alone."""
    out, recipe, index = task
    pair = make_pair(recipe["seed"], index, SENSORS[recipe["sensor"]], recipe.get("points"))
    numbers = np.array([KINDS.index(kind) for kind in pair.kinds], dtype="<u4")
    for side, scan in (("real", pair.real), ("sim", pair.sim)):
        stem = out / side / pair_name(index)
        write_whole(stem.with_suffix(".label"), numbers[scan.object_ids].tobytes())
        write_whole(stem.with_suffix(".bin"), scan.rows.astype("<f4").tobytes())


def pair_name(index: int) -> str:
    """The pair_id of the pair of this index."""
    return f"{index:04d}"


def _files(out: Path, name: str) -> list[Path]:
    return [out / side / f"{name}{suffix}" for side in SIDES for suffix in _SUFFIXES]


def _own_files(out: Path, recipe: Recipe) -> set[Path] | None:
    if not {"version", "seed", "sensor"} <= recipe.keys():
        return None
    return {path for side in SIDES for path in (out / side).glob("*") if _OWN_FILE.fullmatch(path.name)}
