"""`fidpipe synth`: a synthetic dataset of ray-cast streets and their flawed twins."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ...schemas.errors import FidpipeError
from ...schemas.sensor_models import SENSORS
from ...stages.generate.ray_casting import require_ray_caster
from ...stages.generate.street_scans import make_pair
from ...stages.generate.streets import KINDS
from ..engine.progress import Reporter
from ..storage.files import write_whole
from .dataset_folder import GeneratedPair, Recipe, generate_dataset

RECIPE = "synth.toml"
RECIPE_VERSION = 3  # increase it when the same recipe results in other scans
SECONDS_APART = 75.0


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
    pairs = []
    for index in range(n_pairs):
        name = f"{index:04d}"
        pairs.append(
            GeneratedPair(
                pair_id=name,
                real=f"{name}.bin",
                sim=f"{name}.bin",
                task=(out, name, recipe, index),
                timestamp_s=SECONDS_APART * (index + 1),
            )
        )
    outcome = generate_dataset(
        out,
        RECIPE,
        recipe,
        pairs,
        dict(enumerate(KINDS)),
        write_pair,
        reporter,
        workers=workers,
        replace=replace,
    )
    for reason in outcome.failures.values():
        raise FidpipeError(f"dataset {out}: {reason}")


def recipe_of(seed: int, sensor: str, n_points: int | None) -> Recipe:
    """Everything that the scans of a pair depend on, except its index."""
    recipe = {"version": RECIPE_VERSION, "seed": seed, "sensor": sensor}
    if n_points is not None:
        recipe["points"] = n_points
    return recipe


def write_pair(task: tuple[Path, str, Recipe, int]) -> None:
    """Write the four files of a pair, given folder, name, recipe and index of the pair."""
    out, name, recipe, index = task
    pair = make_pair(recipe["seed"], index, SENSORS[recipe["sensor"]], recipe.get("points"))
    numbers = np.array([KINDS.index(kind) for kind in pair.kinds], dtype="<u4")
    for side, scan in (("real", pair.real), ("sim", pair.sim)):
        write_whole(out / side / f"{name}.label", numbers[scan.object_ids].tobytes())
        write_whole(out / side / f"{name}.bin", scan.rows.astype("<f4").tobytes())
