"""`fidpipe perturb`: response of the scores to known alterations of a real scan (paper, Table I and Fig. 2).

Object points are altered after cleaning and ground removal. *Global*: all of them, with everything
from the graph on recomputed. *Object level*: those of one community, with its graph rebuilt from
them alone.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import astuple, dataclass
from pathlib import Path

import numpy as np
import pyarrow as pa

from ...schemas.columns import Row
from ...schemas.errors import DatasetError, SettingsError
from ...schemas.metric_catalogue import DATASET_SCORES, OBJECT_METRICS
from ...schemas.settings import Settings
from ...schemas.tables import TABLES
from ...stages.arrays import FloatArray, IntArray
from ...stages.baselines import Baseline, compare_objects
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
from ...stages.paper.sweep_means import Means
from ...stages.plausibility import ScanInspection
from ...stages.statistics.typical_objects import ChosenObject
from ..datasets.pairs import ScanPair
from ..datasets.readers.scan import Scan
from ..engine.memory import PairTables, run_in_memory
from ..engine.plan import Planner
from ..engine.progress import Reporter
from ..jobs import STAGES, baselines_job, communities_job, graph_job, ground_job
from ..jobs.points_job import column, edges_in, points_in
from ..pair_checks import pair_warnings
from ..stage import INSPECTION, JobResult
from ..storage.files import key_of
from ..storage.folder import RunFolder
from .experiment import (
    Experiment,
    ExperimentOutcome,
    Request,
    mean_rows,
    read_source,
    run_experiment,
)
from .perturb_objects import choose_objects, objects_in

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


@dataclass(frozen=True, kw_only=True)
class PerturbOutcome(ExperimentOutcome):
    """Outcome of the experiment."""

    levels: tuple[Perturbation, ...]

    @property
    def scans(self) -> tuple[str, ...]:
        """Names of the altered scans."""
        return tuple(self.metadata)

    @property
    def objects(self) -> tuple[ChosenObject, ...]:
        """Chosen objects of all scans."""
        chosen = []
        for metadata in self.metadata.values():
            chosen += [ChosenObject(**values) for values in metadata["objects"]]
        return tuple(chosen)

    @property
    def summary(self) -> pa.Table:
        """The table `perturb_summary`."""
        return self.tables["perturb_summary"]

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
    n_workers: int | None = None,
    replace: bool = False,
) -> PerturbOutcome:
    """Alter scans and objects, score the result, and write the tables.

    Parameters
    ----------
    path : a scan file or the folder of a dataset; without a pattern the real side of its first pair
        is used
    levels : kinds and amounts of perturbations
    repeats, global_repeats : number of repeats of each level, per object and for the whole scan
    seed : of the random numbers
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
    outcome = run_experiment(
        EXPERIMENT,
        source,
        out,
        settings,
        reporter,
        request,
        n_workers=n_workers,
        replace_finished=replace,
    )
    return PerturbOutcome(**vars(outcome), levels=tuple(levels))


def alter_scan(
    pair: ScanPair,
    scans: Mapping[str, Scan],
    settings: Settings,
    request: Request,
) -> JobResult:
    """All perturbations of the real scan of a pair and of its chosen objects, with all repeats.

    Parameters
    ----------
    request : seed, repeats, levels, and names of objects
    """
    jobs = Planner(_PARTITION_STAGES, settings, {}).jobs()
    real_jobs = [job for job in jobs if job.part == "real"]
    tables, outputs = run_in_memory(real_jobs, scans, pair.pair_id)
    scan = _partition_of(tables, settings)
    notes: list[str] = []
    names = request["objects"]
    objects = choose_objects(
        objects_in(tables, pair.pair_id),
        names,
        settings.graph.k,
        notes.append,
    )
    object_rows, baseline_rows = _object_rows(scan, objects, settings, request)
    inspection = ScanInspection(**outputs["ground", "real"][INSPECTION])
    return JobResult(
        {
            "perturb_global": TABLES["perturb_global"].from_rows(
                _whole_rows(scan, pair.pair_id, settings, request),
            ),
            "perturb_objects": TABLES["perturb_objects"].from_rows(object_rows),
            "perturb_baselines": TABLES["perturb_baselines"].from_rows(baseline_rows),
            "ground": tables["ground", "real"],
            "communities": tables["communities", "real"],
        },
        {
            "objects": [vars(chosen) for chosen in objects],
            "notes": notes,
            "warnings": pair_warnings(pair, {"real": inspection}, None),
        },
    )


def _levels(request: Request) -> list[Perturbation]:
    return [Perturbation(*values) for values in request["levels"]]


def _whole_rows(
    scan: PartitionedScan,
    scan_id: str,
    settings: Settings,
    request: Request,
) -> list[Row]:
    """One row of `perturb_global` per level and repeat."""
    rows = []
    for level in _levels(request):
        for repeat in _repeats(scan_id, "all", level, request["repeats"]["global"], request):
            row = _altered_scan(scan, level, repeat["seed"], settings)
            rows.append(repeat | row)
    return rows


def _object_rows(
    scan: PartitionedScan, objects: Sequence[ChosenObject], settings: Settings, request: Request
) -> tuple[list[Row], list[Row]]:
    """The rows of `perturb_objects` and `perturb_baselines`: one object altered, its graph rebuilt from it alone."""
    graphs = {}
    for chosen in objects:
        points = scan.points[scan.labels == chosen.community_id]
        graphs[chosen.community_id] = graph_of(points, settings)
    object_rows = []
    baseline_rows = []
    n_repeats = request["repeats"]["object"]
    for level in _levels(request):
        for chosen in objects:
            number = chosen.community_id
            names = {"community_id": number, "object": chosen.name}
            for repeat in _repeats(chosen.pair_id, number, level, n_repeats, request):
                rng = np.random.default_rng(repeat["seed"])
                altered = perturb(graphs[number].points, level, rng)
                scores, baselines = _altered_object(graphs[number], altered, settings)
                object_rows.append(repeat | names | scores)
                baseline_rows += [repeat | names | baseline for baseline in baselines]
    return object_rows, baseline_rows


def _partition_of(tables: PairTables, settings: Settings) -> PartitionedScan:
    """The unaltered scan with its partition."""
    point_ids, points = points_in(tables["ground", "real"])
    labels = column(tables["communities", "real"], "community_id")
    objects = describe(points, labels, settings)
    return PartitionedScan(points, edges_in(point_ids, tables["graph", "real"]), labels, objects)


def _repeats(
    scan: str,
    scope: int | str,
    level: Perturbation,
    n_repeats: int,
    request: Request,
) -> list[Row]:
    """The first columns of the row of each repeat.

    The seed is 60 bits of a hash of the request's seed, scan, scope, level and repeat.

    Parameters
    ----------
    scan : name of the scan
    scope : id of an object, or "all"
    """
    rows = []
    for repeat in range(n_repeats):
        digits = key_of("perturb", request["seed"], scan, scope, *astuple(level), repeat)
        seed = int(digits[:15], 16)
        rows.append(vars(level) | {"pair_id": scan, "repeat": repeat, "seed": seed})
    return rows


def _altered_scan(scan: PartitionedScan, level: Perturbation, seed: int, settings: Settings) -> Row:
    """Scores of the scan with all object points altered, everything from the graph on recomputed."""
    altered = perturb(scan.points, level, np.random.default_rng(seed))
    row: Row = {
        "n_points": len(scan.points),
        "n_points_altered": len(altered),
        "n_communities": len(scan.objects.n_points),
    }
    if len(altered) < MIN_OBJECT_POINTS:
        reason = f"expected at least {MIN_OBJECT_POINTS} points, got {len(altered)}"
        return row | {"reason": reason}
    used = settings
    if level.kind == "null":  # with another Louvain seed
        communities = settings.communities.model_copy(update={"seed": seed % 2**31})
        used = settings.model_copy(update={"communities": communities})
    altered_scan = partition(altered, used, reference=scan.reference)
    summary = compare(scan, altered_scan, settings).summary  # the unaltered scan is the real side
    row |= {name: summary[name] for name in _SUMMARY}
    row["n_communities_altered"] = n_communities(summary)["n_communities_sim"]
    return row


def _altered_object(
    before: Subgraph,
    altered: FloatArray,
    settings: Settings,
) -> tuple[Row, list[Row]]:
    """Scores of one object with altered points, and a row for each baseline metric.

    Parameters
    ----------
    before : the unaltered object with the graph of its points alone
    altered : (n, 3) float64, metres
    """
    row: Row = {
        "n_points": len(before.points),
        "n_points_altered": len(altered),
    }
    if not len(altered):
        reason = f"expected at least {MIN_NODES} points for a spectrum, got 0"
        return row | {"status": "too_small", "reason": reason}, []
    offset = altered.mean(axis=0) - before.points.mean(axis=0)
    row["centroid_distance_m"] = float(np.linalg.norm(offset))
    after = graph_of(altered, settings)
    scored = score(before, after, settings.selection)
    row |= vars(scored.scores)
    if not settings.metrics.baselines:
        return row, []
    nodes = scored.selection
    baselines = compare_objects(before, after, nodes, settings.selection.t, settings.metrics)
    return row, [_baseline_row(baseline) for baseline in baselines]


def _baseline_row(baseline: Baseline) -> Row:
    return {
        "baseline": baseline.name,
        "unit": baseline.unit,
        "value": baseline.value,
        "reason": baseline.reason,
    }


def object_points(folder: Path, scan: str) -> tuple[FloatArray, IntArray]:
    """Object points of an unaltered scan, (n, 3) metres, and their communities, from the experiment's folder."""
    run_folder = RunFolder(folder)
    _, points = points_in(run_folder.read_table("ground", scan))
    return points, column(run_folder.read_table("communities", scan), "community_id")


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
            raise SettingsError(
                f"--sweep {word!r}: expected one of {', '.join(KINDS)}; got {kind!r}",
            )
        levels += [_level(word, kind, text) for text in (amounts if equals else _AMOUNTS[kind]).split(",")]
    return tuple(dict.fromkeys(levels))


def _level(word: str, kind: str, text: str) -> Perturbation:
    shift, colon, amount = text.rpartition(":")
    low, high = KINDS[kind].low, KINDS[kind].high
    try:
        level = Perturbation(kind, float(amount), float(shift) if colon else 0.0)
    except ValueError:
        raise SettingsError(
            f"--sweep {word!r}: expected a number (rigid: metres:degrees), got {text!r}",
        ) from None
    if colon and kind != "rigid":
        raise SettingsError(
            f"--sweep {word!r}: expected one number for {kind}, got {text!r}; metres:degrees is for rigid",
        )
    if not low <= level.amount <= high or not 0 <= level.shift_m <= 100:
        raise SettingsError(
            f"--sweep {word!r}: expected {low:g} to {high:g} for {kind}, got {text}",
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
    stages=(*STAGES, baselines_job.STAGE),
    tables=("perturb_global", "perturb_objects", "perturb_baselines"),
    summary="perturb_summary",
    evaluate=alter_scan,
    summarise=_summary_rows,
)
