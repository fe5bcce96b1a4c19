"""The folder of a synthetic dataset: `real/`, `sim/`, labels, a manifest, and the recipe that it was made by.

`prepare` the folder, `make_files` for each of the `wanted_pairs`, in any order and process, then `finish`: the manifest
comes last, and each file is whole or not there, so that what was interrupted can be run again and goes on with the
pairs that are missing.
"""

from __future__ import annotations

import re
import tomllib
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ...schemas.columns import SIDES
from ...schemas.errors import FidpipeError
from ...schemas.settings import Settings
from ...stages.generate.ray_casting import need_ray_caster
from ...stages.generate.scans import make_pair
from ...stages.generate.things import KINDS
from ...stages.inspect.sensor_models import SENSORS
from ..datasets.pairs import LABEL_NAMES, MANIFEST, ScanPair
from ..engine.engine import Engine, Machines
from ..engine.plan import Job, PairPlan
from ..engine.progress import Reporter
from ..stage import Context, Grain, Made, Stage
from ..storage.files import key_of, refuse_link, write_whole

RECIPE = "synth.toml"
RECIPE_VERSION = 1  # to be raised when the same recipe gives other scans
SECONDS_APART = 75.0
#: The files of pairs, and what a killed process left of one that it was writing.
_OWN_FILE = re.compile(r"\d{4,}\.(bin|label)|\.\d{4,}\.(bin|label)\.[0-9a-f]{8}")


@dataclass(frozen=True)
class SynthRequest:
    """What dataset is wanted.

    out : its folder
    n_pairs, seed : how many streets, and which
    sensor : a name in `SENSORS`
    n_points : about how many points a real scan has; by default what the sensor gives
    workers : processes; they change nothing but the time
    replace : whether pairs of a finished dataset may be removed because another one is wanted
    """

    out: Path
    n_pairs: int = 50
    seed: int = 0
    sensor: str = "vlp32c"
    n_points: int | None = None
    workers: int = 1
    replace: bool = False

    def recipe(self) -> str:
        """TOML text; of two datasets with the same recipe, pairs of the same name are the same."""
        points = "" if self.n_points is None else f"points = {self.n_points}\n"
        return f'version = {RECIPE_VERSION}\nseed = {self.seed}\nsensor = "{self.sensor}"\n{points}'


def make_dataset(request: SynthRequest, reporter: Reporter) -> None:
    """Writes the dataset; pairs that are there already by the same recipe are left as they are.

    Parameters
    ----------
    request : what is wanted
    reporter : told how it goes on

    Raises
    ------
    FidpipeError
        embreex is missing, the sensor is unknown, or the folder holds something else than a synthetic dataset.
    """
    try:
        prepare(request)
        _make_pairs(request, wanted_pairs(request), reporter)
        finish(request)
    except OSError as error:
        raise FidpipeError(f"dataset {request.out}: cannot be written ({error.strerror or error})") from error


def prepare(request: SynthRequest) -> None:
    """Makes the folders; clears away what another recipe left there, and what this one no longer wants.

    Raises
    ------
    FidpipeError
        embreex is missing, the request makes no sense, or the folder holds something else than a synthetic dataset, or
        a finished one whose pairs would go unasked; nothing is written then.
    """
    _check(request)
    need_ray_caster()
    out = request.out
    if out.exists() and not out.is_dir():
        raise FidpipeError(f"dataset {out}: is a file, a folder is wanted")
    out.mkdir(parents=True, exist_ok=True)
    for side in SIDES:
        refuse_link(out / side)
    earlier_recipe = _read_recipe(out)
    if earlier_recipe is None and any(not path.name.startswith(".") for path in out.iterdir()):
        raise FidpipeError(
            f"dataset {out}: the folder holds other things than a synthetic dataset (no {RECIPE} of ours in it); "
            "give the name of a new or empty folder"
        )
    recipe = tomllib.loads(request.recipe())
    if not request.replace:
        _refuse_replacing(request, earlier_recipe or recipe, recipe)
    if earlier_recipe is None:
        write_whole(out / RECIPE, request.recipe().encode())  # first of all, so that the folder can be told as ours
    for side in SIDES:
        (out / side).mkdir(exist_ok=True)
    (out / MANIFEST).unlink(missing_ok=True)
    is_same = earlier_recipe == recipe
    wanted_names = {pair_name(index) for index in range(request.n_pairs)} if is_same else set()
    for side in SIDES:
        for path in (out / side).iterdir():
            if _OWN_FILE.fullmatch(path.name) and path.stem not in wanted_names:
                path.unlink()
    write_whole(out / RECIPE, request.recipe().encode())  # now, that no pair of another recipe is left
    write_whole(out / LABEL_NAMES, "".join(f'{number} = "{kind}"\n' for number, kind in enumerate(KINDS)).encode())


def wanted_pairs(request: SynthRequest) -> list[int]:
    """The indices of the pairs that are not there yet, ascending; after `prepare`."""
    return [index for index in range(request.n_pairs) if not _is_made(request.out, index)]


def make_files(request: SynthRequest, index: int) -> None:
    """Writes the four files of one pair; they depend on the recipe and the index alone.

    Raises
    ------
    RunError
        A file cannot be written.
    """
    pair = make_pair(request.seed, index, SENSORS[request.sensor], request.n_points)
    numbers = np.array([KINDS.index(kind) for kind in pair.kinds], dtype="<u4")
    for side, scan in (("real", pair.real), ("sim", pair.sim)):
        stem = request.out / side / pair_name(index)
        write_whole(stem.with_suffix(".label"), numbers[scan.thing_ids].tobytes())
        write_whole(stem.with_suffix(".bin"), scan.rows.astype("<f4").tobytes())


def finish(request: SynthRequest) -> None:
    """Writes the manifest, which says that all pairs are there; frames are 70 to 80 seconds apart."""
    lines = ["pair_id,real,sim,timestamp_s"]
    for index in range(request.n_pairs):
        late = np.random.default_rng(np.random.SeedSequence((request.seed, index), spawn_key=(99,))).uniform(-2.5, 2.5)
        name, time_s = pair_name(index), SECONDS_APART * (index + 1) + late
        lines.append(f"{name},real/{name}.bin,sim/{name}.bin,{time_s:.3f}")
    write_whole(request.out / MANIFEST, ("\n".join(lines) + "\n").encode())


def pair_name(index: int) -> str:
    """The pair_id of the pair of this index."""
    return f"{index:04d}"


def _check(request: SynthRequest) -> None:
    if request.sensor not in SENSORS:
        raise FidpipeError(f"sensor {request.sensor!r}: no such sensor; known are {', '.join(SENSORS)}")
    for name, value, least in (
        ("pairs", request.n_pairs, 1),
        ("points", request.n_points, 1),
        ("seed", request.seed, 0),
        ("workers", request.workers, 1),
    ):
        if value is not None and value < least:
            raise FidpipeError(f"{name} {value}: at least {least} is wanted")


def _refuse_replacing(request: SynthRequest, before: dict[str, object], now: dict[str, object]) -> None:
    """Refuses with `FidpipeError` to remove pairs of a finished dataset; the manifest says that it is finished."""
    out = request.out
    if not (out / MANIFEST).exists():
        return
    names = {path.stem for path in (out / SIDES[0]).iterdir() if _OWN_FILE.fullmatch(path.name)}
    why = [
        f"{name} was {before.get(name, 'not given')}, is {now.get(name, 'not given')}"
        for name in before | now
        if before.get(name) != now.get(name)
    ]
    lost = names if why else names - {pair_name(index) for index in range(request.n_pairs)}
    if lost:
        raise FidpipeError(
            f"dataset {out}: is finished, and {len(lost)} of its {len(names)} pairs would be removed "
            f"({'; '.join(why) or f'pairs was {len(names)}, is {request.n_pairs}'}); add --replace, or name another "
            "folder"
        )


def _read_recipe(out: Path) -> dict[str, object] | None:
    """The recipe that a folder was made by; None if it is no synthetic dataset."""
    try:
        recipe = tomllib.loads((out / RECIPE).read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError):  # TOML and unicode errors are ValueErrors
        return None
    return recipe if {"version", "seed", "sensor"} <= recipe.keys() else None


def _is_made(out: Path, index: int) -> bool:
    return all((out / side / f"{pair_name(index)}{suffix}").exists() for side in SIDES for suffix in (".bin", ".label"))


def _make_pairs(request: SynthRequest, wanted: list[int], reporter: Reporter) -> None:
    """Makes the wanted pairs; one that a worker process cannot make is an error of the whole."""
    if not wanted:
        return
    if len(wanted) < request.n_pairs:
        reporter.say(f"{request.n_pairs - len(wanted)} of {request.n_pairs} pairs are there already")
    plans = (_plan(request, index) for index in wanted)
    with Engine(Settings(), Machines(request.workers), reporter, [__name__]) as engine:
        with engine.scheduling(plans, len(wanted)) as schedule:
            schedule.run()
        if engine.failures:
            raise FidpipeError(f"dataset {request.out}: {next(iter(engine.failures.values()))}")


def _plan(request: SynthRequest, index: int) -> PairPlan:
    """The one job of a pair, which writes its files."""
    key = key_of(request.recipe(), index)
    job = Job(_STAGE, "files", key, Settings(), arguments=(request, index))
    return PairPlan(ScanPair(pair_name(index), None, None), (job,))


def _make(context: Context) -> Made:
    make_files(*context.arguments)
    return Made({})


#: It takes and gives no table: its results are the files of the dataset.
_STAGE = Stage(name="synth", takes={}, gives=(), grain=Grain.PAIR, version=RECIPE_VERSION, make=_make)
