"""`fidpipe perturb`: response of the scores to known alterations of a real scan (paper, Table I and Fig. 2).

Object points are altered after cleaning and ground removal. *Global*: all of them, with everything
from the graph on recomputed. *Object level*: those of one community, with its graph rebuilt from
them alone.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import astuple, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from pydantic import BaseModel

from ...schemas.columns import Row
from ...schemas.errors import SettingsError
from ...schemas.metric_catalogue import DATASET_SCORES, OBJECT_METRICS
from ...schemas.settings import Settings
from ...stages.arrays import FloatArray
from ...stages.baselines import compare_points
from ...stages.generate.flaws import FLAWS, KINDS, Perturbation, perturb
from ...stages.graph import graph_of
from ...stages.ground import MIN_OBJECT_POINTS
from ...stages.linalg.subgraph import Subgraph
from ...stages.metrics import MIN_NODES, score_object
from ...stages.selection import select_nodes
from ..engine.progress import Reporter
from ..engine.worker import PairTables
from ..jobs.points_job import column, points_in
from ..jobs.scoring import PARTITION, ground_table, score_pair
from ..results.object_frame import SHAPES
from ..run import select_pairs
from ..stage import Inputs, JobResult
from ..storage.files import key_of
from .experiment import (
    ExperimentOutcome,
    experiment_stage,
    read_source,
    run_experiment,
    run_stages,
    settings_of,
)

#: Amounts by kind. Noise, dropout and rigid motion are those of the paper; hallucination and density are ours. `null`
#: is the difference of a scan from itself without a change, the first row of every table: one point less, rows in
#: another order, another Louvain seed. Noise and rigid motion keep the order, dropout and the others do not.
AMOUNTS = {
    "null": "1",
    "noise": "0.001,0.01,0.1",
    "dropout": "0.05,0.2,0.4",
    "rigid": "0:0.5,0:1,0.05:2",
    "hallucination": "0.05,0.2,0.4",
    "density": "0.25,0.5,2,4",
}
#: The classes of the paper, section "Controlled Perturbation Analysis".
CLASSES = ("vegetation", "car", "tree", "wall")
#: An object of at most k + 1 points remains a complete graph under any alteration; a typical one has twice as many.
LEAST_POINTS_OVER_K = 2
PURE_SHARE = 0.75


class PerturbRequest(BaseModel, frozen=True):
    """What is altered, and how often.

    levels : kinds and amounts of perturbations
    repeats, global_repeats : number of repeats of each level, per object and for the whole scan
    seed : seed of all random numbers
    """

    levels: tuple[Perturbation, ...] = ()
    repeats: int = 20
    global_repeats: int = 5
    seed: int = 0


class PerturbSettings(Settings):
    """The settings of a run, and what is altered."""

    perturb: PerturbRequest = PerturbRequest()


def perturb_source(
    path: Path,
    out: Path,
    settings: Settings,
    reporter: Reporter,
    request: PerturbRequest,
    *,
    pattern: str | None = None,
    n_workers: int | None = None,
    replace_finished: bool = False,
) -> ExperimentOutcome:
    """Alter scans and objects, score the result, and write the tables.

    Parameters
    ----------
    path : a scan file or the folder of a dataset; without a pattern the real side of its first pair
        is used
    n_workers : processes; None for one per core
    replace_finished : allow results of a finished experiment to be replaced by another request

    Raises
    ------
    FidpipeError
        The scan, the dataset, a setting or the folder is invalid.
    """
    source = read_source(path)
    pairs = select_pairs(source, pattern) if pattern else source.pairs[:1]
    # the simulated side is not read
    scans = []
    for pair in source.pairs:
        scans.append(
            replace(pair, sim=pair.real, T_real_sim=None, fault=None) if pair.real else pair
        )
    return run_experiment(
        STAGE,
        replace(source, pairs=tuple(scans)),
        pairs,
        out,
        PerturbSettings(**dict(settings), perturb=request),
        reporter,
        _scores,
        n_workers=n_workers,
        replace_finished=replace_finished,
    )


def make_perturbations(inputs: Inputs) -> JobResult:
    """All perturbations of the real scan of a pair and of its chosen objects, with all repeats."""
    settings = settings_of(inputs.settings)
    request: PerturbRequest = inputs.settings.perturb  # type: ignore[attr-defined]
    tables = run_stages(inputs, PARTITION, ["real"])
    _, points = points_in(tables["ground", "real"])
    labels = column(tables["communities", "real"], "community_id")
    global_rows = []
    for level, trial in _trials(request, inputs.pair_id, "all", request.global_repeats):
        global_rows.append(
            trial | _altered_scan(tables, points, level, trial["seed"], settings)
        )
    object_rows = []
    baseline_rows = []
    for number, name in choose_objects(objects_in(tables), settings.graph.k).items():
        before = graph_of(points[labels == number], settings.graph)
        for level, trial in _trials(request, inputs.pair_id, number, request.repeats):
            names = trial | {"community_id": number, "object": name}
            scores, baselines = _altered_object(before, level, trial["seed"], settings)
            object_rows.append(names | scores)
            baseline_rows += [names | baseline for baseline in baselines]
    results = inputs.rows("perturb_global", global_rows)
    results |= inputs.rows("perturb_objects", object_rows)
    results |= inputs.rows("perturb_baselines", baseline_rows)
    return JobResult(results)


STAGE = experiment_stage(
    "perturb",
    4,
    ("perturb_global", "perturb_objects", "perturb_baselines"),
    make_perturbations,
)


def _trials(
    request: PerturbRequest,
    pair_id: str,
    scope: int | str,
    n_repeats: int,
) -> Iterator[tuple[Perturbation, Row]]:
    """Each level and repeat, with the first columns of its row.

    The seed is 60 bits of a hash of the request's seed, scan, scope, level and repeat.

    Parameters
    ----------
    scope : id of an object, or "all"
    """
    for level in request.levels:
        for repeat in range(n_repeats):
            digits = key_of("perturb", request.seed, pair_id, scope, *astuple(level), repeat)
            yield level, vars(level) | {"repeat": repeat, "seed": int(digits[:15], 16)}


def _altered_scan(
    tables: PairTables,
    points: FloatArray,
    level: Perturbation,
    seed: int,
    settings: Settings,
) -> Row:
    """Scores of the scan with all object points altered, everything from the graph on recomputed."""
    altered = perturb(points, level, np.random.default_rng(seed))
    row: Row = {
        "n_points": len(points),
        "n_points_altered": len(altered),
        "n_communities": tables["objects", "real"].num_rows,
    }
    if len(altered) < MIN_OBJECT_POINTS:
        reason = f"expected at least {MIN_OBJECT_POINTS} points, got {len(altered)}"
        return row | {"reason": reason}
    used = settings
    if level.kind == "null":  # with another Louvain seed
        communities = settings.communities.model_copy(update={"seed": seed % 2**31})
        used = settings.model_copy(update={"communities": communities})
    both = tables | {("ground", "sim"): ground_table(altered)}  # the real side is unaltered
    summary = score_pair(used, both)
    return row | summary | {"n_communities_altered": summary["n_communities_sim"]}


def _altered_object(
    before: Subgraph,
    level: Perturbation,
    seed: int,
    settings: Settings,
) -> tuple[Row, list[Row]]:
    """Scores of one object with altered points, and a row for each baseline metric.

    Parameters
    ----------
    before : the unaltered object with the graph of its points alone
    """
    altered = perturb(before.points, level, np.random.default_rng(seed))
    row: Row = {"n_points": len(before.points), "n_points_altered": len(altered)}
    if not len(altered):
        reason = f"expected at least {MIN_NODES} points for a spectrum, got 0"
        return row | {"status": "too_small", "reason": reason}, []
    offset = altered.mean(axis=0) - before.points.mean(axis=0)
    row["centroid_distance_m"] = float(np.linalg.norm(offset))
    after = graph_of(altered, settings.graph)
    nodes = select_nodes(before, after, settings.selection)
    row |= vars(score_object(before, after, nodes))
    baselines = []
    if settings.metrics.baselines:
        values = compare_points(before.points, after.points, settings.metrics, nodes=nodes)
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
        for text in (amounts if equals else AMOUNTS[kind]).split(","):
            shift, _, amount = text.rpartition(":") if kind == "rigid" else ("", "", text)
            option = f"--sweep {word!r}: {kind}"
            shift_m = FLAWS["offset"].parse(shift or "0", option)
            levels[Perturbation(kind, KINDS[kind].parse(amount, option), shift_m)] = None
    return tuple(levels)


def _scores(tables: Mapping[str, pd.DataFrame]) -> list[pd.DataFrame]:
    """The scores of whole scans, of objects, and baselines, a row each."""
    level = ["kind", "amount", "shift_m"]
    whole = tables["perturb_global"].melt(level, DATASET_SCORES, "metric")
    single = tables["perturb_objects"].melt(["object", *level], OBJECT_METRICS, "metric")
    baselines = tables["perturb_baselines"].rename(columns={"baseline": "metric"})
    baselines = baselines[single.columns]
    return [
        whole.assign(scope="global"),
        single.assign(scope="object"),
        baselines.assign(scope="object"),
    ]


def choose_objects(objects: pd.DataFrame, k: int) -> dict[int, str]:
    """Id and class of the typical object of each class of the paper; without any of these one object per shape.

    Shapes are linear, planar and scattered; no object is chosen twice, so that one without a further
    object is left out.

    Parameters
    ----------
    objects : from `objects_in`
    k : neighbours of the graph, `graph.k`; a typical object has at least 2 k points
    """
    least = LEAST_POINTS_OVER_K * k
    chosen = {}
    for name in CLASSES:
        of_class = objects[objects["label"] == name]
        if len(of_class):
            chosen[_typical_of_class(of_class, least)] = name
    return chosen or _typical_of_shapes(objects, least)


def objects_in(tables: PairTables) -> pd.DataFrame:
    """The objects of the real side of a pair by id: n_points, label, `SHAPES`, and `label_share`.

    `label_share` is the share of the points of an object that have its label.

    Parameters
    ----------
    tables : among them ground, communities and objects
    """
    ground = tables["ground", "real"].select(["is_ground", "label"]).to_pandas()
    objects: pd.DataFrame = tables["objects", "real"].to_pandas()
    community = column(tables["communities", "real"], "community_id")
    labels = objects["label"].to_numpy()[community]
    has_label = (ground.loc[~ground["is_ground"], "label"] == labels) & pd.notna(labels)
    labelled = community[has_label.to_numpy()]
    n_labelled = np.bincount(labelled, minlength=len(objects))
    return objects.assign(label_share=n_labelled / objects["n_points"])


def _typical_of_class(objects: pd.DataFrame, least: int) -> int:
    """Id of the typical object of a class.

    It is the one of median size among the objects of at least `least` points with three quarters of them of the label;
    without such objects, the largest with that most frequent label.
    """
    typical = objects[(objects["label_share"] >= PURE_SHARE) & (objects["n_points"] >= least)]
    if typical.empty:
        largest: Any = objects["n_points"].idxmax()
        return int(largest)
    return _median_sized(typical)


def _typical_of_shapes(objects: pd.DataFrame, least: int) -> dict[int, str]:
    """One object for each shape, no object twice: id and shape.

    The shape of an object is that of the largest of the three features; among the objects of a shape and at least
    `least` points the one of median size is chosen. Then shapes without an object get the nearest of the others; one
    without a remaining object is left out.
    """
    large = objects[objects["n_points"] >= least]
    free = objects if large.empty else large
    of_shapes = large.groupby(large[[*SHAPES]].idxmax(axis=1))
    chosen: dict[Any, int] = {name: _median_sized(typical) for name, typical in of_shapes}
    for feature in SHAPES:
        others = free[feature].drop([*chosen.values()])
        if feature not in chosen and len(others):
            largest: Any = others.idxmax()
            chosen[feature] = int(largest)
    return {chosen[feature]: SHAPES[feature] for feature in SHAPES if feature in chosen}


def _median_sized(objects: pd.DataFrame) -> int:
    """Id of the object of median size; for an even number the smaller one."""
    by_size: Any = objects.sort_values("n_points", kind="stable").index
    return int(by_size[(len(by_size) - 1) // 2])
