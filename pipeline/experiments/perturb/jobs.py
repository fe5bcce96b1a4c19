"""The tasks of `fidpipe perturb`: one way and amount of altering, all its repeats, on a whole scan or on one object."""

from __future__ import annotations

from typing import Any

import numpy as np

from ....schemas.experiment_tables import PERTURB_BASELINES, PERTURB_GLOBAL, PERTURB_OBJECTS
from ....schemas.metrics import OBJECT_METRICS
from ....schemas.settings import Settings
from ....stages.baselines import compare_objects
from ....stages.ground import MIN_OBJECT_POINTS
from ....stages.method import PartitionedScan, compare, graph_of, partition, score
from ....stages.metrics import MIN_NODES
from ....stages.objects import describe_objects
from ....stages.selection import select_nodes
from ....stages.sensing.perturbations import perturb
from ...jobs.baselines import baseline_libraries
from ...jobs.communities import louvain_libraries
from ...jobs.points import EDGE_COLUMNS, POINT_COLUMNS, column, graph_edges, object_points
from ...stage import Context, Grain, Made, Stage

_COUNTS = ("n_matched", "n_identical", "n_too_small", "match_rate")


def make_global(context: Context) -> Made:
    """One row of `perturb_global` per repeat: all object points altered, everything from the graph on run again.

    Arguments: the perturbation, and the seeds of the repeats.
    """
    perturbation, seeds = context.arguments
    scan = _unaltered_scan(context)
    rows = []
    for repeat, seed in enumerate(seeds):
        points = perturb(scan.points, perturbation, np.random.default_rng(seed))
        row: dict[str, Any] = vars(perturbation) | {
            "pair_id": context.pair_id,
            "repeat": repeat,
            "seed": seed,
            "n_points": len(scan.points),
            "n_points_altered": len(points),
            "n_communities": len(scan.objects.n_points),
        }
        if len(points) < MIN_OBJECT_POINTS:
            row["reason"] = f"{len(points)} points are left, at least {MIN_OBJECT_POINTS} are needed"
        else:
            row |= _compare(scan, partition(points, context.settings), context.settings)
        rows.append(row)
    return Made({"perturb_global": PERTURB_GLOBAL.from_rows(rows)})


def make_objects(context: Context) -> Made:
    """One row of `perturb_objects` per repeat: one object altered, both graphs built from its points alone.

    Arguments: the object's community id and name, the perturbation, and the seeds of the repeats.
    """
    community_id, name, perturbation, seeds = context.arguments
    scan, settings = _unaltered_scan(context), context.settings
    points = scan.points[scan.labels == community_id]
    before = graph_of(points, settings)
    rows = []
    for repeat, seed in enumerate(seeds):
        altered = perturb(points, perturbation, np.random.default_rng(seed))
        if len(altered):
            scores = vars(score(before, graph_of(altered, settings), settings.selection).scores)
            distance_m = float(np.linalg.norm(altered.mean(axis=0) - points.mean(axis=0)))
        else:
            reason = f"no point is left, at least {MIN_NODES} are needed for a spectrum"
            scores, distance_m = {"status": "too_small", "reason": reason}, None
        rows.append(
            vars(perturbation)
            | {
                "pair_id": context.pair_id,
                "community_id": community_id,
                "object": name,
                "repeat": repeat,
                "seed": seed,
                "n_points": len(points),
                "n_points_altered": len(altered),
                "centroid_distance_m": distance_m,
            }
            | scores
        )
    return Made({"perturb_objects": PERTURB_OBJECTS.from_rows(rows)})


def make_baselines(context: Context) -> Made:
    """One row of `perturb_baselines` per repeat and baseline; arguments and altered objects as in `make_objects`."""
    community_id, name, perturbation, seeds = context.arguments
    scan, settings = _unaltered_scan(context), context.settings
    points = scan.points[scan.labels == community_id]
    before = graph_of(points, settings)
    rows = []
    for repeat, seed in enumerate(seeds):
        altered = perturb(points, perturbation, np.random.default_rng(seed))
        if not len(altered):
            continue  # perturb_objects says why
        after = graph_of(altered, settings)
        nodes = select_nodes(before, after, settings.selection)
        repeated = vars(perturbation) | {
            "pair_id": context.pair_id,
            "community_id": community_id,
            "object": name,
            "repeat": repeat,
            "seed": seed,
        }
        for baseline in compare_objects(before, after, nodes, settings.selection.t, settings.metrics):
            number = {"unit": baseline.unit, "value": baseline.value, "reason": baseline.reason}
            rows.append(repeated | {"baseline": baseline.name} | number)
    return Made({"perturb_baselines": PERTURB_BASELINES.from_rows(rows)})


def _unaltered_scan(context: Context) -> PartitionedScan:
    """The unaltered scan with its partition."""

    def read() -> PartitionedScan:
        _, points = object_points(context, "real")
        labels = column(context.table("communities", "real"), "community_id")
        return PartitionedScan(points, graph_edges(context, "real"), labels, describe_objects(points, labels))

    return context.once("unaltered scan", read)


def _compare(scan: PartitionedScan, altered: PartitionedScan, settings: Settings) -> dict[str, Any]:
    """Counts, match rate and means over matched objects, the unaltered scan taken as the real side."""
    summary = compare(scan, altered, settings).summary
    means = [f"{metric}_mean" for metric in OBJECT_METRICS]
    return {name: summary[name] for name in (*_COUNTS, *means)} | {
        "n_communities_altered": len(altered.objects.n_points)
    }


def _libraries(settings: Settings) -> tuple[str, ...]:
    return (*louvain_libraries(settings), "POT")


_TAKES = {"ground": POINT_COLUMNS, "graph": EDGE_COLUMNS, "communities": ("community_id",)}
_SETTINGS = ("graph", "communities", "matching", "selection")

#: Versions are to be raised when the same request gives other numbers.
GLOBAL = Stage(
    name="perturb_global",
    takes=_TAKES,
    gives=("perturb_global",),
    settings=_SETTINGS,
    grain=Grain.PAIR,
    version=1,
    make=make_global,
    libraries=_libraries,
)
OBJECT = Stage(
    name="perturb_objects",
    takes=_TAKES,
    gives=("perturb_objects",),
    settings=_SETTINGS,
    grain=Grain.PAIR,
    version=1,
    make=make_objects,
    libraries=_libraries,
)
BASELINE = Stage(
    name="perturb_baselines",
    takes=_TAKES,
    gives=("perturb_baselines",),
    settings=(*_SETTINGS, "metrics"),
    grain=Grain.PAIR,
    version=1,
    make=make_baselines,
    libraries=baseline_libraries,
)
