"""`fidpipe perturb`: response of the scores to known alterations of a real scan (paper, Table I and Fig. 2).

Object points are altered after cleaning and ground removal. *Global*: all of them, with everything
from the graph on recomputed. *Object level*: those of one community, with its graph rebuilt from
them alone.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import astuple
from pathlib import Path

import numpy as np
import pyarrow as pa

from ...schemas.columns import Row
from ...schemas.errors import DatasetError, SettingsError
from ...schemas.metric_catalogue import DATASET_SCORES, OBJECT_METRICS
from ...schemas.settings import Settings
from ...schemas.tables import TABLES
from ...stages.arrays import FloatArray
from ...stages.baselines import compare_objects
from ...stages.generate.perturbations import KINDS, Perturbation, perturb
from ...stages.ground import MIN_OBJECT_POINTS
from ...stages.linalg.subgraph import Subgraph
from ...stages.method import (
    PartitionedScan,
    compare,
    describe,
    graph_of,
    n_communities,
    partition,
    score,
)
from ...stages.metrics import MIN_NODES
from ...stages.plausibility import ScanInspection
from ..datasets.pairs import ScanPair
from ..datasets.readers.scan import Scan
from ..engine.plan import plan_jobs
from ..engine.progress import Reporter
from ..engine.worker import run_in_memory
from ..jobs import communities_job, graph_job, ground_job
from ..jobs.points_job import column, edges_in, points_in
from ..pair_checks import pair_warnings
from ..stage import INSPECTION, JobResult
from ..storage.files import key_of
from .experiment import (
    Experiment,
    ExperimentOutcome,
    Request,
    mean_rows,
    read_source,
    run_experiment,
)
from .perturb_objects import ChosenObject, choose_objects, objects_in

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
#: Columns of `perturb_global` from the summary of a comparison.
_SUMMARY = (
    "n_matched",
    "n_identical",
    "n_too_small",
    "match_rate",
    *(f"{metric}_mean" for metric in OBJECT_METRICS),
)
#: Stages that partition a scan.
_PARTITION_STAGES = (ground_job.STAGE, graph_job.STAGE, communities_job.STAGE)


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
    n_workers: int | None = None,
    replace: bool = False,
) -> ExperimentOutcome:
    """Alter scans and objects, score the result, and write the tables.

    Parameters
    ----------
    path : a scan file or the folder of a dataset; without a pattern the real side of its first pair
        is used
    levels : kinds and amounts of perturbations
    repeats, global_repeats : number of repeats of each level, per object and for the whole scan
    seed : seed of all random numbers
    objects : community ids and labels; by default the classes of the paper, or shapes
    n_workers : processes; None for one per core
    replace : allow results of a finished experiment to be replaced by another request

    Raises
    ------
    FidpipeError
        The scan, the dataset, a setting or the folder is invalid.
    """
    source = read_source(path, pattern, first_only=True)
    if objects and any(word.isdigit() for word in objects) and len(source.pairs) > 1:
        raise DatasetError(
            f"--objects {','.join(objects)}: the number of an object requires one scan, got "
            f"{len(source.pairs)}; select one with --pairs, or give labels"
        )
    request = {
        "seed": seed,
        "repeats": {"global": global_repeats, "object": repeats},
        "levels": [list(astuple(level)) for level in levels],
        "objects": None if objects is None else list(objects),
    }
    return run_experiment(
        EXPERIMENT,
        source,
        out,
        settings,
        reporter,
        request,
        n_workers=n_workers,
        replace_finished=replace,
    )


def levels_of(request: Request) -> list[Perturbation]:
    """The levels of a request."""
    return [Perturbation(*values) for values in request["levels"]]


def chosen_objects(outcome: ExperimentOutcome) -> list[ChosenObject]:
    """The altered objects of all scans."""
    chosen = []
    for metadata in outcome.metadata.values():
        chosen += [ChosenObject(**values) for values in metadata["objects"]]
    return chosen


def alter_scan(
    pair: ScanPair,
    scans: Mapping[str, Scan],
    settings: Settings,
    request: Request,
) -> JobResult:
    """All perturbations of the real scan of a pair and of its chosen objects, with all repeats."""
    jobs = plan_jobs(_PARTITION_STAGES, settings)
    real_jobs = {name: job for name, job in jobs.items() if job.part == "real"}
    tables, outputs = run_in_memory(real_jobs, scans, pair)
    point_ids, points = points_in(tables["ground", "real"])
    edges = edges_in(point_ids, tables["graph", "real"])
    labels = column(tables["communities", "real"], "community_id")
    scan = PartitionedScan(points, edges, labels, describe(points, labels, settings))
    repeats = _repeats(request, pair.pair_id, "all", request["repeats"]["global"])
    global_rows = [names | _altered_scan(scan, names, settings) for names in repeats]
    objects = choose_objects(objects_in(tables), pair.pair_id, request["objects"], settings.graph.k)
    object_rows = []
    baseline_rows = []
    for chosen in objects:
        number = chosen.community_id
        before = graph_of(points[labels == number], settings)
        for repeat in _repeats(request, pair.pair_id, number, request["repeats"]["object"]):
            names = repeat | {"community_id": number, "object": chosen.name}
            scores, baselines = _altered_object(before, names, settings)
            object_rows.append(names | scores)
            baseline_rows += [names | baseline for baseline in baselines]
    rows = {
        "perturb_global": global_rows,
        "perturb_objects": object_rows,
        "perturb_baselines": baseline_rows,
    }
    inspection = ScanInspection(**outputs["ground", "real"][INSPECTION])
    return JobResult(
        {name: TABLES[name].from_rows(rows[name]) for name in EXPERIMENT.tables},
        {
            "objects": [vars(chosen) for chosen in objects],
            "warnings": pair_warnings(pair, {"real": inspection}, None),
        },
    )


def _repeats(request: Request, pair_id: str, scope: int | str, n_repeats: int) -> Iterator[Row]:
    """The first columns of the row of each level and repeat.

    The seed is 60 bits of a hash of the request's seed, scan, scope, level and repeat.

    Parameters
    ----------
    scope : id of an object, or "all"
    """
    for level in levels_of(request):
        for repeat in range(n_repeats):
            digits = key_of("perturb", request["seed"], pair_id, scope, *astuple(level), repeat)
            seed = int(digits[:15], 16)
            yield vars(level) | {"pair_id": pair_id, "repeat": repeat, "seed": seed}


def _altered(points: FloatArray, names: Row) -> FloatArray:
    """Points altered as the first columns of a row say."""
    level = Perturbation(names["kind"], names["amount"], names["shift_m"])
    return perturb(points, level, np.random.default_rng(names["seed"]))


def _altered_scan(scan: PartitionedScan, names: Row, settings: Settings) -> Row:
    """Scores of the scan with all object points altered, everything from the graph on recomputed."""
    altered = _altered(scan.points, names)
    row: Row = {
        "n_points": len(scan.points),
        "n_points_altered": len(altered),
        "n_communities": len(scan.objects.n_points),
    }
    if len(altered) < MIN_OBJECT_POINTS:
        reason = f"expected at least {MIN_OBJECT_POINTS} points, got {len(altered)}"
        return row | {"reason": reason}
    used = settings
    if names["kind"] == "null":  # with another Louvain seed
        communities = settings.communities.model_copy(update={"seed": names["seed"] % 2**31})
        used = settings.model_copy(update={"communities": communities})
    altered_scan = partition(altered, used, reference=scan.reference)
    summary = compare(scan, altered_scan, settings).summary  # the unaltered scan is the real side
    row |= {name: summary[name] for name in _SUMMARY}
    row["n_communities_altered"] = n_communities(summary)["n_communities_sim"]
    return row


def _altered_object(before: Subgraph, names: Row, settings: Settings) -> tuple[Row, list[Row]]:
    """Scores of one object with altered points, and a row for each baseline metric.

    Parameters
    ----------
    before : the unaltered object with the graph of its points alone
    """
    altered = _altered(before.points, names)
    row: Row = {"n_points": len(before.points), "n_points_altered": len(altered)}
    if not len(altered):
        reason = f"expected at least {MIN_NODES} points for a spectrum, got 0"
        return row | {"status": "too_small", "reason": reason}, []
    offset = altered.mean(axis=0) - before.points.mean(axis=0)
    row["centroid_distance_m"] = float(np.linalg.norm(offset))
    after = graph_of(altered, settings)
    scored = score(before, after, settings.selection)
    row |= vars(scored.scores)
    baselines = []
    if settings.metrics.baselines:
        nodes = scored.selection
        values = compare_objects(before, after, nodes, settings.selection.t, settings.metrics)
        baselines = [
            {"baseline": value.name, "unit": value.unit, **vars(value)} for value in values
        ]
    return row, baselines


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
    levels: dict[Perturbation, None] = {}
    for word in words:
        kind, equals, amounts = word.partition("=")
        if kind not in KINDS:
            raise SettingsError(
                f"--sweep {word!r}: expected one of {', '.join(KINDS)}; got {kind!r}",
            )
        for text in (amounts if equals else _AMOUNTS[kind]).split(","):
            levels[_level(word, kind, text)] = None
    return tuple(levels)


def _level(word: str, kind: str, text: str) -> Perturbation:
    shift, colon, amount = text.rpartition(":")
    low, high = KINDS[kind].low, KINDS[kind].high
    try:
        level = Perturbation(kind, float(amount), float(shift or 0.0))
        is_valid = low <= level.amount <= high and 0 <= level.shift_m <= 100
    except ValueError:
        is_valid = False
    if not is_valid or (colon and kind != "rigid"):
        raise SettingsError(
            f"--sweep {word!r}: expected {low:g} to {high:g} for {kind} (rigid: metres:degrees), got {text!r}"
        )
    return level


#: All default levels, that of the scan against itself first.
LEVELS = parse_levels([*_AMOUNTS])


def _summary_rows(tables: Mapping[str, pa.Table]) -> list[Row]:
    """The rows of `perturb_summary`: means and standard deviations over the repeats of all scans."""
    level = ["kind", "amount", "shift_m"]
    whole = tables["perturb_global"].to_pandas().melt(level, DATASET_SCORES, "metric")
    single = tables["perturb_objects"].to_pandas()
    single = single.melt(["object", *level], OBJECT_METRICS, "metric")
    baselines = tables["perturb_baselines"].to_pandas().rename(columns={"baseline": "metric"})
    rows = [{"scope": "global"} | row for row in mean_rows(whole, [*level, "metric"])]
    for scores in (single, baselines):
        means = mean_rows(scores, ["object", *level, "metric"])
        rows += [{"scope": "object"} | row for row in means]
    return rows


EXPERIMENT = Experiment(
    name="perturb",
    version=3,
    sides=("real",),
    tables=("perturb_global", "perturb_objects", "perturb_baselines"),
    summary="perturb_summary",
    evaluate=alter_scan,
    summarise=_summary_rows,
)
