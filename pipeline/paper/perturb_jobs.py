"""The jobs of `fidpipe perturb`: one perturbation with all its repeats on a whole scan or on one object."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pyarrow as pa

from ...schemas.columns import Row
from ...schemas.metric_catalogue import OBJECT_METRICS
from ...schemas.settings import CommunitySettings, Settings
from ...schemas.tables import TABLES
from ...stages.arrays import FloatArray
from ...stages.baselines import compare_objects
from ...stages.generate.perturbations import Perturbation, perturb
from ...stages.ground import MIN_OBJECT_POINTS
from ...stages.method import PartitionedScan, compare, describe, graph_of, n_communities, partition, score
from ...stages.metrics import MIN_NODES
from ...stages.selection import select_nodes
from ..jobs import baselines_job, seeds_job
from ..jobs.points_job import EDGE_COLUMNS, POINT_COLUMNS, column, edges_in, points_in
from ..stage import Grain, Inputs, JobResult, Stage

_SUMMARY = ("n_matched", "n_identical", "n_too_small", "match_rate", *(f"{metric}_mean" for metric in OBJECT_METRICS))


def make_global(own: Inputs) -> JobResult:
    """One row of `perturb_global` per repeat: all object points altered, everything from the graph on recomputed.

    Arguments: the perturbation, and the seeds of the repeats.
    """
    scan, settings = _unaltered_scan(own), own.settings
    rows = []
    for row, altered in _repeats(own, scan.points, *own.arguments):
        row |= {
            "n_points": len(scan.points),
            "n_points_altered": len(altered),
            "n_communities": len(scan.objects.n_points),
        }
        if len(altered) < MIN_OBJECT_POINTS:
            row["reason"] = f"expected at least {MIN_OBJECT_POINTS} points, got {len(altered)}"
        else:
            if row["kind"] == "null":  # with another Louvain seed
                communities = settings.communities.model_copy(update={"seed": row["seed"] % 2**31})
                used = Settings(graph=settings.graph, communities=communities, pieces=settings.pieces)
            else:
                used = settings
            altered_scan = partition(altered, used, reference=scan.reference)
            summary = compare(scan, altered_scan, settings).summary  # the unaltered scan is the real side
            row |= {name: summary[name] for name in _SUMMARY}
            row["n_communities_altered"] = n_communities(summary)["n_communities_sim"]
        rows.append(row)
    return JobResult({"perturb_global": TABLES["perturb_global"].from_rows(rows)})


def make_objects(own: Inputs) -> JobResult:
    """One row of `perturb_objects` per repeat: one object altered, both graphs built from its points alone.

    Arguments: the object's community id and name, the perturbation, and the seeds of the repeats.
    """
    points, repeats = _object_repeats(own)
    before = graph_of(points, own.settings)
    rows = []
    for row, altered in repeats:
        if len(altered):
            distance_m = float(np.linalg.norm(altered.mean(axis=0) - points.mean(axis=0)))
            scores = vars(score(before, graph_of(altered, own.settings), own.settings.selection).scores)
        else:
            reason = f"expected at least {MIN_NODES} points for a spectrum, got 0"
            scores, distance_m = {"status": "too_small", "reason": reason}, None
        counts = {"n_points": len(points), "n_points_altered": len(altered), "centroid_distance_m": distance_m}
        rows.append(row | counts | scores)
    return JobResult({"perturb_objects": TABLES["perturb_objects"].from_rows(rows)})


def make_baselines(own: Inputs) -> JobResult:
    """One row of `perturb_baselines` per repeat and baseline; arguments and altered objects as in `make_objects`."""
    points, repeats = _object_repeats(own)
    settings = own.settings
    before = graph_of(points, settings)
    rows = []
    for row, altered in repeats:
        if not len(altered):
            continue  # perturb_objects has the reason
        after = graph_of(altered, settings)
        nodes = select_nodes(before, after, settings.selection)
        for baseline in compare_objects(before, after, nodes, settings.selection.t, settings.metrics):
            number = {"unit": baseline.unit, "value": baseline.value, "reason": baseline.reason}
            rows.append(row | {"baseline": baseline.name} | number)
    return JobResult({"perturb_baselines": TABLES["perturb_baselines"].from_rows(rows)})


def _unaltered_scan(own: Inputs) -> PartitionedScan:
    """The unaltered scan with its partition."""
    tables = [own.table(name, "real") for name in ("ground", "graph", "communities")]
    return own.memo(_read_partition, *tables, own.settings.communities)


def _read_partition(
    ground: pa.Table, graph: pa.Table, communities: pa.Table, settings: CommunitySettings
) -> PartitionedScan:
    point_ids, points = points_in(ground)
    labels = column(communities, "community_id")
    objects = describe(points, labels, Settings(communities=settings))
    return PartitionedScan(points, edges_in(point_ids, graph), labels, objects)


def _object_repeats(own: Inputs) -> tuple[FloatArray, Iterator[tuple[Row, FloatArray]]]:
    """The points of the object in the arguments, and its repeats."""
    community_id, name, perturbation, random_seeds = own.arguments
    scan = _unaltered_scan(own)
    points = scan.points[scan.labels == community_id]
    named = {"community_id": community_id, "object": name}
    return points, ((row | named, altered) for row, altered in _repeats(own, points, perturbation, random_seeds))


def _repeats(
    own: Inputs, points: FloatArray, perturbation: Perturbation, random_seeds: list[int]
) -> Iterator[tuple[Row, FloatArray]]:
    """The first columns of the row of each repeat, and the altered points."""
    for repeat, seed in enumerate(random_seeds):
        row = vars(perturbation) | {"pair_id": own.pair_id, "repeat": repeat, "seed": seed}
        yield row, perturb(points, perturbation, np.random.default_rng(seed))


#: Increase a version when the same request results in other numbers.
GLOBAL = Stage(
    name="perturb_global",
    takes={"ground": POINT_COLUMNS, "graph": EDGE_COLUMNS, "communities": ("community_id",)},
    gives=("perturb_global",),
    settings=("graph", "communities", "matching", "pieces", "selection"),
    grain=Grain.PAIR,
    version=2,
    make=make_global,
    libraries=seeds_job.STAGE.libraries,
)
OBJECT = replace(GLOBAL, name="perturb_objects", gives=("perturb_objects",), version=1, make=make_objects)
BASELINE = replace(
    GLOBAL,
    name="perturb_baselines",
    gives=("perturb_baselines",),
    settings=(*GLOBAL.settings, "metrics"),
    version=2,
    make=make_baselines,
    libraries=baselines_job.STAGE.libraries,
)
