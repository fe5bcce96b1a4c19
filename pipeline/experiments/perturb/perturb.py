"""`fidpipe perturb`: how the scores answer to known alterations of a real scan (paper, Table I and Fig. 3).

What is altered are object points, after cleaning and ground removal. *Global*: all of them, everything from the graph
on is run again. *Object level*: those of one community, its graph rebuilt from them alone. Leaves to others: the
alterations (`stages.perturbations`), the jobs (`perturb_jobs`), means and claims (`perturb_summary`), pictures.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter

import pyarrow as pa

from ....schemas.errors import DatasetError, SettingsError
from ....schemas.settings import Settings
from ....stages.sensing.perturbations import KINDS, Perturbation
from ...engine.costs import object_seconds
from ...engine.progress import Reporter
from ...engine.task import PairTask
from ...engine.workbench import Workbench, as_numpy
from ...run import STAGES
from ...storage.record import run_header
from ...storage.store import key_of
from ..sources import method_key, prepare, read_source
from ..sweep import Part, Sweep, SweepOutcome, sweeping
from .choice import ChosenObject, choose_objects
from .jobs import baseline_rows, global_rows, object_rows
from .summary import summarise

VERSION = 1  # of the alterations and of the jobs; to be raised when the same request gives other numbers
TABLES = ("perturb_global", "perturb_objects", "perturb_baselines")
_BASE_STAGES = ("ground", "graph", "communities")

#: Noise, dropout and rigid motion as in the paper; hallucination and density are ours.
LEVELS = (
    *(Perturbation("noise", std_m) for std_m in (1e-3, 1e-2, 1e-1)),
    *(Perturbation("dropout", share) for share in (0.05, 0.2, 0.4)),
    *(Perturbation("rigid", angle_deg, shift_m) for shift_m, angle_deg in ((0.0, 0.5), (0.0, 1.0), (0.05, 2.0))),
    *(Perturbation("hallucination", share) for share in (0.05, 0.2, 0.4)),
    *(Perturbation("density", factor) for factor in (0.25, 0.5, 2.0, 4.0)),
)

#: Least and largest amount of each kind.
_BOUNDS = {"noise": (0, 10), "dropout": (0, 0.99), "rigid": (-180, 180), "hallucination": (0, 10), "density": (0, 20)}


@dataclass(frozen=True)
class PerturbRequest:
    """What the user asked for.

    source : a scan file, or a dataset of whose real side the first pair is taken
    out : folder of the experiment
    levels : ways and amounts of altering
    repeats, global_repeats : of each level at object level and of the whole scan
    seed : another one gives other random numbers
    objects : community ids and labels; None for the classes of the paper, or shapes
    pattern : all pairs of a dataset whose name matches
    workers, scheduler : as in `RunRequest`
    """

    source: Path
    out: Path
    settings: Settings
    levels: tuple[Perturbation, ...] = LEVELS
    repeats: int = 20
    global_repeats: int = 5
    seed: int = 0
    objects: tuple[str, ...] | None = None
    pattern: str | None = None
    workers: int | None = None
    scheduler: str | None = None


@dataclass(frozen=True, kw_only=True)
class PerturbOutcome(SweepOutcome):
    """What has become of the experiment.

    tasks : the scans that were altered
    objects : the chosen ones of all scans
    summary : rows of `perturb_summary`
    """

    tasks: tuple[PairTask, ...]
    objects: tuple[ChosenObject, ...]
    levels: tuple[Perturbation, ...]
    summary: pa.Table


def perturb_source(request: PerturbRequest, reporter: Reporter) -> PerturbOutcome:
    """Alters scans and objects, scores what came of it, and writes the tables.

    Raises
    ------
    FidpipeError
        The scan, the dataset, a setting or the folder is wrong; before any work.
    """
    start = perf_counter()
    source = read_source(request.source, request.pattern, first_only=True)
    if request.objects and any(word.isdigit() for word in request.objects) and len(source.pairs) > 1:
        raise DatasetError(
            f"--objects {','.join(request.objects)}: an object's number belongs to one scan, {len(source.pairs)} are "
            "chosen; name one with --pairs, or give labels"
        )
    at = (request.source, request.out, request.settings, request.workers, request.scheduler, reporter)
    with sweeping("perturb", *at) as sweep:
        tasks = prepare(sweep, source, request.settings, ("real",), _BASE_STAGES)
        choices = [choose_objects(task, request.objects) for task in tasks]
        for choice in choices:
            for note in choice.notes:
                reporter.say(note)
        sweep.run(
            [
                part
                for task, choice in zip(tasks, choices, strict=True)
                for part in _parts(request, task, choice.objects)
            ],
            TABLES,
        )
        summary = summarise(sweep)
        objects = tuple(of for choice in choices for of in choice.objects)
        wall_s = perf_counter() - start
        _write_record(sweep, request, objects, wall_s)
    return PerturbOutcome(
        folder=request.out,
        tasks=tuple(tasks),
        objects=objects,
        levels=request.levels,
        summary=summary,
        failures=sweep.failures,
        n_made=sweep.n_made,
        n_reused=sweep.n_reused,
        wall_s=wall_s,
    )


def parse_levels(words: Sequence[str]) -> tuple[Perturbation, ...]:
    """Levels from words: `dropout` (those of the paper), `dropout=0.1,0.3`, `rigid=0:0.5,0.05:2` (metres:degrees).

    Raises
    ------
    SettingsError
        The kind is unknown, or an amount is no number or out of bounds.

    Examples
    --------
    >>> parse_levels(["dropout=0.1", "rigid=0.05:2"])[1]
    Perturbation(kind='rigid', amount=2.0, shift_m=0.05)
    """
    levels: dict[Perturbation, None] = {}
    for word in words:
        kind, equals, amounts = word.partition("=")
        if kind not in KINDS:
            raise SettingsError(f"--sweep {word!r}: {kind!r} is no perturbation; known are {', '.join(KINDS)}")
        if equals:
            levels |= dict.fromkeys(_level(word, kind, text) for text in amounts.split(","))
        else:
            levels |= dict.fromkeys(of for of in LEVELS if of.kind == kind)
    return tuple(levels)


def seed_of(*name: object) -> int:
    """A seed from the name of a job: 60 bits of its hash."""
    return int(key_of(*name)[:15], 16)


def _level(word: str, kind: str, text: str) -> Perturbation:
    shift, colon, amount = text.rpartition(":")
    low, high = _BOUNDS[kind]
    try:
        level = Perturbation(kind, float(amount), float(shift) if colon else 0.0)
    except ValueError:
        raise SettingsError(f"--sweep {word!r}: {text!r} found, a number is wanted (rigid: metres:degrees)") from None
    if colon and kind != "rigid":
        raise SettingsError(f"--sweep {word!r}: metres:degrees is for rigid; {kind} takes one number")
    if not low <= level.amount <= high or not 0 <= level.shift_m <= 100:
        raise SettingsError(f"--sweep {word!r}: {text} is out of bounds, {low:g} to {high:g} are allowed for {kind}")
    return level


def _parts(request: PerturbRequest, task: PairTask, objects: Sequence[ChosenObject]) -> list[Part]:
    """The jobs of one scan: each level of the whole scan, and of each chosen object."""
    pair_id, base = task.pair.pair_id, task.jobs[-1].key
    method = method_key(request.settings, [stage.name for stage in STAGES if stage.name != "ground"])
    of_baselines = method_key(request.settings, ["baselines"])
    sizes = as_numpy(Workbench(task).table("objects", "real"), "n_points").tolist()
    parts = []
    for level in request.levels:
        plain = [level.kind, level.amount, level.shift_m]
        seeds = [seed_of("perturb", request.seed, pair_id, "all", *plain, i) for i in range(request.global_repeats)]
        if seeds:
            key = key_of("perturb_global", VERSION, base, method, plain, seeds)
            cost_s = len(seeds) * sum(object_seconds(n) for n in sizes)
            parts.append(Part("perturb_global", pair_id, _name(level), key, global_rows, (task, level, seeds), cost_s))
        for of in objects:
            seeds = [
                seed_of("perturb", request.seed, pair_id, of.community_id, *plain, i) for i in range(request.repeats)
            ]
            named = [of.community_id, of.name, plain, seeds]
            args = (task, of.community_id, of.name, level, seeds)
            name, cost_s = f"{of.community_id}-{_name(level)}", len(seeds) * object_seconds(of.n_points)
            key = key_of("perturb_objects", VERSION, base, method, *named)
            parts.append(Part("perturb_objects", pair_id, name, key, object_rows, args, cost_s))
            if request.settings.metrics.baselines:
                key = key_of("perturb_baselines", VERSION, base, method, of_baselines, *named)
                parts.append(Part("perturb_baselines", pair_id, name, key, baseline_rows, args, 2 * cost_s))
    return parts


def _name(level: Perturbation) -> str:
    """A level as a part's name holds it: amounts in full, since levels may agree to many digits."""
    return f"{level.kind}-{level.amount!r}" + (f"-{level.shift_m!r}" if level.kind == "rigid" else "")


def _write_record(sweep: Sweep, request: PerturbRequest, objects: Sequence[ChosenObject], wall_s: float) -> None:
    sweep.record(
        {
            "experiment": "perturb",
            **run_header(request.source, request.settings, STAGES),
            "seed": request.seed,
            "repeats": {"global": request.global_repeats, "object": request.repeats},
            "levels": [vars(level) for level in request.levels],
            "objects": [vars(of) for of in objects],
            "failures": sweep.failures,
            "jobs": {"made": sweep.n_made, "reused": sweep.n_reused},
            "wall_s": wall_s,
        }
    )
