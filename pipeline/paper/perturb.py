"""`fidpipe perturb`: response of the scores to known alterations of a real scan (paper, Table I and Fig. 2).

Object points are altered after cleaning and ground removal. *Global*: all of them, with everything from the graph on
recomputed. *Object level*: those of one community, with its graph rebuilt from them alone.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import astuple, dataclass
from pathlib import Path
from typing import Any

import pyarrow as pa

from ...schemas.columns import Row
from ...schemas.errors import DatasetError, SettingsError
from ...schemas.metric_catalogue import DATASET_SCORES, OBJECT_METRICS
from ...schemas.settings import Settings
from ...schemas.tables import TABLES
from ...stages.arrays import FloatArray, IntArray
from ...stages.generate.perturbations import KINDS, Perturbation
from ...stages.paper.sweep_means import Means
from ...stages.statistics.typical_objects import ChosenObject
from ..engine.engine import Machines
from ..engine.plan import Part
from ..engine.progress import Reporter
from ..jobs.points_job import column, points_in
from ..stage import Stage
from ..storage.files import key_of
from ..storage.folder import RunFolder
from .experiment import Experiment, ExperimentOutcome, experimenting, mean_rows, read_source
from .perturb_jobs import BASELINE, GLOBAL, OBJECT
from .perturb_objects import choose_objects, read_objects

#: Difference of a scan from itself without a change, the first row of every table: one point less, rows in another
#: order, another Louvain seed. Noise and rigid motion keep the order, dropout and the others do not.
NULL = Perturbation("null", 1.0)
#: Amounts by kind. Noise, dropout and rigid motion are those of the paper; hallucination and density are ours.
_AMOUNTS = {
    "null": "1",
    "noise": "0.001,0.01,0.1",
    "dropout": "0.05,0.2,0.4",
    "rigid": "0:0.5,0:1,0.05:2",
    "hallucination": "0.05,0.2,0.4",
    "density": "0.25,0.5,2,4",
}


@dataclass(frozen=True, kw_only=True)
class PerturbOutcome(ExperimentOutcome):
    """Outcome of the experiment.

    scans : names of the altered scans
    objects : chosen objects of all scans
    summary : rows of `perturb_summary`
    """

    scans: tuple[str, ...]
    objects: tuple[ChosenObject, ...]
    levels: tuple[Perturbation, ...]
    summary: pa.Table

    @property
    def means(self) -> Means:
        """The summary by object, level and metric."""
        return Means(self.summary.to_pylist())


def perturb_source(
    path: Path,
    out: Path,
    settings: Settings,
    reporter: Reporter,
    *,
    levels: Sequence[Perturbation],
    repeats: int = 20,
    global_repeats: int = 5,
    seed: int = 0,
    objects: Sequence[str] | None = None,
    pattern: str | None = None,
    machines: Machines | None = None,
    replace: bool = False,
) -> PerturbOutcome:
    """Alter scans and objects, score the result, and write the tables.

    Parameters
    ----------
    path : a scan file or the folder of a dataset; without a pattern the real side of its first pair is used
    levels : kinds and amounts of perturbations
    repeats, global_repeats : number of repeats of each level, per object and for the whole scan
    seed : of the random numbers
    objects : community ids and labels; by default the classes of the paper, or shapes
    machines, replace : see `experimenting`

    Raises
    ------
    FidpipeError
        The scan, the dataset, a setting or the folder is invalid; raised before any work.
    """
    source = read_source(path, pattern, first_only=True, machines=machines)
    if objects and any(word.isdigit() for word in objects) and len(source.pairs) > 1:
        raise DatasetError(
            f"--objects {','.join(objects)}: the number of an object requires one scan, got {len(source.pairs)}; "
            "select one with --pairs, or give labels"
        )
    stages, sides = (GLOBAL, OBJECT, BASELINE), ("real",)
    with experimenting(
        "perturb", source, out, settings, reporter, stages=stages, sides=sides, machines=machines, replace=replace
    ) as experiment:
        chosen = {}
        for plan in experiment.prepare():
            scan = read_objects(experiment.folder, plan.pair_id)
            chosen[plan.pair_id] = choose_objects(scan, objects, settings.graph.k, reporter.say)
        all_chosen = tuple(each for own in chosen.values() for each in own)
        request = {
            "seed": seed,
            "repeats": {"global": global_repeats, "object": repeats},
            "levels": [vars(level) for level in levels],
            "objects": [vars(each) for each in all_chosen],
        }
        own_stages = stages if settings.metrics.baselines else stages[:2]
        parts = {
            name: [part for level in levels for part in _parts(name, level, own, own_stages, request)]
            for name, own in chosen.items()
        }
        experiment.make(parts, request)
        summary = experiment.write_summary(TABLES["perturb_summary"], _summary_rows(experiment))
        return PerturbOutcome(
            **experiment.finish(), scans=tuple(chosen), objects=all_chosen, levels=tuple(levels), summary=summary
        )


def object_points(folder: Path, scan: str) -> tuple[FloatArray, IntArray]:
    """Object points of an unaltered scan, (n, 3) metres, and their communities, from the experiment's folder."""
    run_folder = RunFolder(folder)
    _, points = points_in(run_folder.read_table("ground", scan, "real"))
    return points, column(run_folder.read_table("communities", scan, "real"), "community_id")


def parse_levels(words: Sequence[str]) -> tuple[Perturbation, ...]:
    """Parse levels: `dropout` (the default levels), `dropout=0.1,0.3`, `rigid=0:0.5,0.05:2` (metres:degrees).

    Raises
    ------
    SettingsError
        The kind is unknown, or an amount is not a number or out of bounds.

    Examples
    --------
    >>> parse_levels(["dropout=0.1", "rigid=0.05:2"])[1]
    Perturbation(kind='rigid', amount=2.0, shift_m=0.05)
    """
    levels = []
    for word in words:
        kind, equals, amounts = word.partition("=")
        if kind not in KINDS:
            raise SettingsError(f"--sweep {word!r}: expected one of {', '.join(KINDS)}; got {kind!r}")
        levels += [_level(word, kind, text) for text in (amounts if equals else _AMOUNTS[kind]).split(",")]
    return tuple(dict.fromkeys(levels))


def _level(word: str, kind: str, text: str) -> Perturbation:
    shift, colon, amount = text.rpartition(":")
    low, high = KINDS[kind].low, KINDS[kind].high
    try:
        level = Perturbation(kind, float(amount), float(shift) if colon else 0.0)
    except ValueError:
        raise SettingsError(f"--sweep {word!r}: expected a number (rigid: metres:degrees), got {text!r}") from None
    if colon and kind != "rigid":
        raise SettingsError(
            f"--sweep {word!r}: expected one number for {kind}, got {text!r}; metres:degrees is for rigid"
        )
    if not low <= level.amount <= high or not 0 <= level.shift_m <= 100:
        raise SettingsError(f"--sweep {word!r}: expected {low:g} to {high:g} for {kind}, got {text}")
    return level


#: All default levels, that of the scan against itself first.
LEVELS = parse_levels([*_AMOUNTS])


def _parts(
    scan: str, level: Perturbation, objects: Sequence[ChosenObject], stages: Sequence[Stage], request: Mapping[str, Any]
) -> Iterator[Part]:
    """The parts of one level: the whole scan and each chosen object."""

    def seeds_of(scope: int | str, n: int) -> list[int]:
        """Seeds of n repeats: 60 bits of a hash of scan, scope, level and repeat."""
        return [int(key_of("perturb", request["seed"], scan, scope, *astuple(level), i)[:15], 16) for i in range(n)]

    if seeds := seeds_of("all", request["repeats"]["global"]):
        yield Part(GLOBAL, _name(level), (level, seeds))
    for chosen in objects:
        number = chosen.community_id
        arguments = (number, chosen.name, level, seeds_of(number, request["repeats"]["object"]))
        for stage in stages[1:]:
            yield Part(stage, f"{number}-{_name(level)}", arguments)


def _name(level: Perturbation) -> str:
    """The level in the name of a part, with all digits, since levels may agree to many of them."""
    return f"{level.kind}-{level.amount!r}" + (f"-{level.shift_m!r}" if level.kind == "rigid" else "")


def _summary_rows(experiment: Experiment) -> list[Row]:
    """The rows of `perturb_summary`: means and standard deviations over the repeats of all scans."""
    level = ["kind", "amount", "shift_m"]
    whole, single = (experiment.rows(stage.name).to_pandas() for stage in (GLOBAL, OBJECT))
    baselines = experiment.rows(BASELINE.name).to_pandas().rename(columns={"baseline": "metric"})
    rows = [
        {"scope": "global"} | row for row in mean_rows(whole.melt(level, DATASET_SCORES, "metric"), [*level, "metric"])
    ]
    for scores in (single.melt(["object", *level], OBJECT_METRICS, "metric"), baselines):
        rows += [{"scope": "object"} | row for row in mean_rows(scores, ["object", *level, "metric"])]
    return rows
