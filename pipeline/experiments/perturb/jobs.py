"""The jobs of `fidpipe perturb`: one way and amount of altering, all its repeats, on a whole scan or on one object."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pyarrow as pa

from ....schemas.experiment_tables import PERTURB_BASELINES, PERTURB_GLOBAL, PERTURB_OBJECTS
from ....schemas.metrics import OBJECT_METRICS
from ....schemas.settings import Settings
from ....stages.arrays import FloatArray, IntArray
from ....stages.baselines import compare_objects
from ....stages.ground import MIN_OBJECT_POINTS
from ....stages.method import PartitionedScan, compare, graph_of, partition, score
from ....stages.metrics import MIN_NODES
from ....stages.objects import describe_objects
from ....stages.selection import select_nodes
from ....stages.sensing.perturbations import Perturbation, perturb
from ...engine.task import PairTask
from ...engine.workbench import Workbench, as_numpy

_COUNTS = ("n_matched", "n_identical", "n_too_small", "match_rate")


def global_rows(task: PairTask, perturbation: Perturbation, seeds: Sequence[int]) -> pa.Table:
    """One row of `perturb_global` per repeat: all object points altered, everything from the graph on run again.

    Parameters
    ----------
    task : a scan whose communities are done
    perturbation : kind and amount
    seeds : of the repeats
    """
    scan = _scan_of(task)
    rows = []
    for repeat, seed in enumerate(seeds):
        points = perturb(scan.points, perturbation, np.random.default_rng(seed))
        row: dict[str, Any] = vars(perturbation) | {
            "pair_id": task.pair.pair_id,
            "repeat": repeat,
            "seed": seed,
            "n_points": len(scan.points),
            "n_points_altered": len(points),
            "n_communities": len(scan.objects.n_points),
        }
        if len(points) < MIN_OBJECT_POINTS:
            row["reason"] = f"{len(points)} points are left, at least {MIN_OBJECT_POINTS} are needed"
        else:
            row |= _compare(scan, partition(points, task.settings), task.settings)
        rows.append(row)
    return PERTURB_GLOBAL.from_rows(rows)


def object_rows(
    task: PairTask, community_id: int, name: str, perturbation: Perturbation, seeds: Sequence[int]
) -> pa.Table:
    """One row of `perturb_objects` per repeat: one object altered, both graphs built from its points alone.

    Parameters
    ----------
    task : a scan whose communities are done
    community_id, name : the object
    perturbation : kind and amount
    seeds : of the repeats
    """
    scan = _scan_of(task)
    points = scan.points[scan.labels == community_id]
    before = graph_of(points, task.settings)
    rows = []
    for repeat, seed in enumerate(seeds):
        altered = perturb(points, perturbation, np.random.default_rng(seed))
        if len(altered):
            after = graph_of(altered, task.settings)
            scores = vars(score(before, after, task.settings.selection).scores)
            distance_m = float(np.linalg.norm(altered.mean(axis=0) - points.mean(axis=0)))
        else:
            reason = f"no point is left, at least {MIN_NODES} are needed for a spectrum"
            scores, distance_m = {"status": "too_small", "reason": reason}, None
        rows.append(
            vars(perturbation)
            | {
                "pair_id": task.pair.pair_id,
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
    return PERTURB_OBJECTS.from_rows(rows)


def baseline_rows(
    task: PairTask, community_id: int, name: str, perturbation: Perturbation, seeds: Sequence[int]
) -> pa.Table:
    """One row of `perturb_baselines` per repeat and baseline; the altered objects are those of `object_rows`.

    Parameters
    ----------
    task : a scan whose communities are done, with `metrics.baselines` in its settings
    community_id, name : the object
    perturbation : kind and amount
    seeds : of the repeats
    """
    scan, settings = _scan_of(task), task.settings
    points = scan.points[scan.labels == community_id]
    before = graph_of(points, settings)
    rows = []
    for repeat, seed in enumerate(seeds):
        altered = perturb(points, perturbation, np.random.default_rng(seed))
        if not len(altered):
            continue  # perturb_objects says why
        after = graph_of(altered, settings)
        chosen = select_nodes(before, after, settings.selection)
        repeated = vars(perturbation) | {
            "pair_id": task.pair.pair_id,
            "community_id": community_id,
            "object": name,
            "repeat": repeat,
            "seed": seed,
        }
        for baseline in compare_objects(before, after, chosen, settings.selection.t, settings.metrics):
            number = {"unit": baseline.unit, "value": baseline.value, "reason": baseline.reason}
            rows.append(repeated | {"baseline": baseline.name} | number)
    return PERTURB_BASELINES.from_rows(rows)


def object_points(task: PairTask) -> tuple[FloatArray, IntArray]:
    """Object points of the real side of a scan, and the community of each."""
    bench = Workbench(task)
    _, points = bench.object_points("real")
    return points, as_numpy(bench.table("communities", "real"), "community_id")


def _scan_of(task: PairTask) -> PartitionedScan:
    """The unaltered scan with its partition; a process keeps the last one."""
    key = task.jobs[-1].key
    if key not in _KEPT:
        _KEPT.clear()
        bench = Workbench(task)
        point_ids, points = bench.object_points("real")
        labels = as_numpy(bench.table("communities", "real"), "community_id")
        _KEPT[key] = PartitionedScan(
            points=points,
            edges=bench.edges("real", point_ids),
            labels=labels,
            objects=describe_objects(points, labels),
        )
    return _KEPT[key]


_KEPT: dict[str, PartitionedScan] = {}


def _compare(scan: PartitionedScan, altered: PartitionedScan, settings: Settings) -> dict[str, Any]:
    """Counts, match rate and means over matched objects, the unaltered scan taken as the real side."""
    summary = compare(scan, altered, settings).summary
    means = [f"{metric}_mean" for metric in OBJECT_METRICS]
    return {name: summary[name] for name in (*_COUNTS, *means)} | {
        "n_communities_altered": len(altered.objects.n_points)
    }
