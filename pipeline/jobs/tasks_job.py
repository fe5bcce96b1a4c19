"""Stage tasks, an extra: what a perception stack gets from both scans."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import asdict
from typing import Any

import numpy as np

from ...schemas.columns import SIDES, Row
from ...schemas.settings import Settings
from ...stages.objects import majority_labels
from ...stages.pieces import CutScan
from ...stages.summary import mean_and_std
from ...stages.tasks import (
    ALL,
    Gap,
    Obstacles,
    compare_free_space,
    compare_ground,
    compare_obstacles,
    compare_occupancy,
)
from ..stage import Inputs, JobResult, Stage
from ..storage.table_files import JobRecord
from .points_job import by_axis, column, cut_scan

_WITHOUT_PARTNER = {"real": "lost", "sim": "added"}
_TASKS = {
    "ground": compare_ground,
    "occupancy": compare_occupancy,
    "free_space": compare_free_space,
}


def make_tasks(inputs: Inputs) -> JobResult:
    """Compare both scans in each requested task; the metadata hold the gaps over everything."""
    settings = inputs.settings.tasks
    real, sim = [cut_scan(inputs.table("ground", side)) for side in SIDES]
    gaps: list[Gap] = []
    obstacles: list[Row] = []
    for name in settings.names:
        with inputs.step(name):
            if name == "objects":
                task = compare_obstacles(real, sim, settings)
                gaps += task.gaps
                obstacles.append(_obstacle_columns(inputs, "real", real, task.real))
                obstacles.append(_obstacle_columns(inputs, "sim", sim, task.sim))
            else:
                gaps += _TASKS[name](real, sim, settings)
    tables = inputs.rows("tasks", map(asdict, gaps))
    tables |= inputs.columns("task_objects", *obstacles)
    return JobResult(tables, {"gaps": [asdict(gap) for gap in gaps if gap.group == ALL]})


def summarise_tasks(records: Iterable[JobRecord], settings: Settings) -> dict[str, Any]:
    """Means over pairs of each measure over everything, and the standard deviation of its gap."""
    by_measure: dict[tuple[str, str], list[Row]] = {}
    for record in records:
        for gap in record.metadata["gaps"]:
            by_measure.setdefault((gap["task"], gap["measure"]), []).append(gap)
    summary = []
    for (task, measure), gaps in by_measure.items():
        row: Row = {"task": task, "measure": measure, "unit": gaps[0]["unit"]}
        for name in ("real", "sim", "gap"):
            values = np.array([gap[name] for gap in gaps], dtype=np.float64)
            row[name], std = mean_and_std(values)
        n_pairs = sum(gap["gap"] is not None for gap in gaps)
        summary.append(row | {"gap_std": std, "n_pairs": n_pairs})
    return {"tasks": summary}


def _obstacle_columns(inputs: Inputs, side: str, scan: CutScan, obstacles: Obstacles) -> Row:
    """The obstacles of a side within range."""
    communities = column(inputs.table("communities", side), "community_id")
    labels = obstacles.labels[~scan.is_ground].astype(np.int32)
    community_of = majority_labels(labels, communities.tolist(), len(obstacles.n_points))
    rows = np.flatnonzero(obstacles.range_m <= inputs.settings.tasks.range_m)
    partner = obstacles.partner[rows]
    columns = {
        "side": side,
        "obstacle_id": rows,
        "community_id": [community_of[row] for row in rows],
        "n_points": obstacles.n_points[rows],
        "range_m": obstacles.range_m[rows],
        "fate": np.where(partner >= 0, "found", _WITHOUT_PARTNER[side]),
        "partner_id": np.where(partner >= 0, partner, np.nan),
        "iou": obstacles.iou[rows],
    }
    columns |= by_axis("c{}", obstacles.centre[rows])
    return columns | by_axis("extent_{}", obstacles.size_m[rows])


STAGE = Stage(
    name="tasks",
    takes=("ground", "communities"),
    gives=("tasks", "task_objects"),
    settings=("tasks",),
    make=make_tasks,
    libraries=("scikit-learn",),
    is_wanted=lambda settings: bool(settings.tasks.names),
    summarise=summarise_tasks,
)
