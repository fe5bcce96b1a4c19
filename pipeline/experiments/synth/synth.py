"""The folder of a synthetic dataset: `real/`, `sim/`, labels, a manifest, and the recipe that it was made by.

Each file is written under a name that begins with a dot and renamed, the manifest comes last: what was interrupted can
be run again and goes on with the pairs that are missing. Leaves to others: what the scans hold (`scans`).
"""

from __future__ import annotations

import re
import secrets
import signal
import tomllib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import repeat
from pathlib import Path
from time import monotonic

import numpy as np

from ....schemas.columns import SIDES
from ....schemas.errors import FidpipeError
from ....stages.sensing.ray_casting import SENSORS, need_ray_caster
from ...datasets.pairs import LABEL_NAMES, MANIFEST
from .scans import SynthScan, make_pair
from .scene import KINDS

RECIPE = "synth.toml"
RECIPE_VERSION = 1  # to be raised when the same recipe gives other scans
SECONDS_APART = 75.0
_SECONDS_BETWEEN_LINES = 5.0
_OWN_FILE = re.compile(r"\d{4,}\.(bin|label)|\.\d{4,}\.(bin|label)\.[0-9a-f]{8}")


@dataclass(frozen=True)
class SynthRequest:
    """What dataset is wanted.

    out : its folder
    n_pairs, seed : how many streets, and which
    sensor : a name in `SENSORS`
    n_points : about how many points a real scan has; by default what the sensor gives
    workers : processes; they change nothing but the time
    """

    out: Path
    n_pairs: int = 50
    seed: int = 0
    sensor: str = "vlp32c"
    n_points: int | None = None
    workers: int = 1

    def recipe(self) -> str:
        """TOML text; of two datasets with the same recipe, pairs of the same name are the same."""
        points = "" if self.n_points is None else f"points = {self.n_points}\n"
        return f'version = {RECIPE_VERSION}\nseed = {self.seed}\nsensor = "{self.sensor}"\n{points}'


def make_dataset(request: SynthRequest, say: Callable[[str], None] = lambda text: None) -> None:
    """Writes the dataset; pairs that are there already by the same recipe are left as they are.

    Parameters
    ----------
    request : what is wanted
    say : takes a line about the progress now and then

    Raises
    ------
    FidpipeError
        embreex is missing, the sensor is unknown, or the folder holds something else than a synthetic dataset.
    """
    _check(request)
    need_ray_caster()
    try:
        _make(request, say)
    except OSError as error:
        raise FidpipeError(f"dataset {request.out}: cannot be written ({error.strerror or error})") from error


def make_files(request: SynthRequest, index: int) -> None:
    """Writes the four files of one pair."""
    pair = make_pair(request.seed, index, SENSORS[request.sensor], request.n_points)
    numbers = np.array([KINDS.index(kind) for kind in pair.kinds], dtype="<u4")
    scans: dict[str, SynthScan] = {"real": pair.real, "sim": pair.sim}
    for side, scan in scans.items():
        stem = request.out / side / pair_name(index)
        _put(stem.with_suffix(".label"), numbers[scan.thing_ids].tobytes())
        _put(stem.with_suffix(".bin"), scan.rows.astype("<f4").tobytes())


def pair_name(index: int) -> str:
    """The pair_id of the pair of this index."""
    return f"{index:04d}"


def _check(request: SynthRequest) -> None:
    if request.sensor not in SENSORS:
        raise FidpipeError(f"sensor {request.sensor!r}: no such sensor; known are {', '.join(SENSORS)}")
    for name, found, least in (
        ("pairs", request.n_pairs, 1),
        ("points", request.n_points, 1),
        ("seed", request.seed, 0),
        ("workers", request.workers, 1),
    ):
        if found is not None and found < least:
            raise FidpipeError(f"{name} {found}: at least {least} is wanted")


def _make(request: SynthRequest, say: Callable[[str], None]) -> None:
    _prepare(request)
    wanted = [index for index in range(request.n_pairs) if not _is_made(request.out, index)]
    n_before = request.n_pairs - len(wanted)
    start = last_line = monotonic()
    if n_before:
        say(f"{n_before} of {request.n_pairs} pairs are there already")
    for n_made, _ in enumerate(_each_made(request, wanted), start=1):
        now = monotonic()
        if now - last_line >= _SECONDS_BETWEEN_LINES:
            last_line = now
            left = (now - start) / n_made * (len(wanted) - n_made)
            say(f"{n_before + n_made} of {request.n_pairs} pairs; about {left:.0f} s left")
    _put(request.out / MANIFEST, _manifest(request).encode())


def _prepare(request: SynthRequest) -> None:
    """Makes the folders; clears away what another recipe left there, and what this one no longer wants."""
    out = request.out
    if out.exists() and not out.is_dir():
        raise FidpipeError(f"dataset {out}: is a file, a folder is wanted")
    out.mkdir(parents=True, exist_ok=True)
    before = _recipe_of(out)
    if before is None and any(not path.name.startswith(".") for path in out.iterdir()):
        raise FidpipeError(
            f"dataset {out}: the folder holds other things than a synthetic dataset (no {RECIPE} of ours in it); "
            "give the name of a new or empty folder"
        )
    if before is None:
        _put(out / RECIPE, request.recipe().encode())  # first of all, so that the folder can be told as ours
    for side in SIDES:
        (out / side).mkdir(exist_ok=True)
    (out / MANIFEST).unlink(missing_ok=True)
    is_same = before == tomllib.loads(request.recipe())
    wanted = {pair_name(index) for index in range(request.n_pairs)} if is_same else set()
    for side in SIDES:
        for path in (out / side).iterdir():
            if _OWN_FILE.fullmatch(path.name) and path.stem not in wanted:
                path.unlink()
    _put(out / RECIPE, request.recipe().encode())  # now, that no pair of another recipe is left
    _put(out / LABEL_NAMES, "".join(f'{number} = "{kind}"\n' for number, kind in enumerate(KINDS)).encode())


def _recipe_of(out: Path) -> dict[str, object] | None:
    """The recipe that a folder was made by; None if it is no synthetic dataset."""
    try:
        recipe = tomllib.loads((out / RECIPE).read_text(encoding="utf-8"))
    except (FileNotFoundError, ValueError):  # TOML and unicode errors are ValueErrors
        return None
    return recipe if {"version", "seed", "sensor"} <= recipe.keys() else None


def _is_made(out: Path, index: int) -> bool:
    return all((out / side / f"{pair_name(index)}{suffix}").exists() for side in SIDES for suffix in (".bin", ".label"))


def _each_made(request: SynthRequest, wanted: list[int]) -> Iterator[None]:
    if request.workers == 1:
        for index in wanted:
            make_files(request, index)
            yield
        return
    from concurrent.futures import ProcessPoolExecutor
    from multiprocessing import get_context

    ignore = (signal.SIGINT, signal.SIG_IGN)  # an interrupt is this process's to deal with
    with ProcessPoolExecutor(request.workers, get_context("spawn"), signal.signal, ignore) as pool:
        yield from pool.map(make_files, repeat(request), wanted)


def _manifest(request: SynthRequest) -> str:
    """The text of pairs.csv; frames are 70 to 80 seconds apart."""
    lines = ["pair_id,real,sim,timestamp_s"]
    for index in range(request.n_pairs):
        late = np.random.default_rng(np.random.SeedSequence((request.seed, index), spawn_key=(99,))).uniform(-2.5, 2.5)
        name, time_s = pair_name(index), SECONDS_APART * (index + 1) + late
        lines.append(f"{name},real/{name}.bin,sim/{name}.bin,{time_s:.3f}")
    return "\n".join(lines) + "\n"


def _put(path: Path, content: bytes) -> None:
    """A whole file in its place or none."""
    temporary = path.with_name(f".{path.name}.{secrets.token_hex(4)}")
    try:
        temporary.write_bytes(content)
        temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)
