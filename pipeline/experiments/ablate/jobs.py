"""The job of `fidpipe ablate`: one pair under one setting of the graph, and all of matching and selection on it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import pyarrow as pa

from ....schemas.columns import SIDES
from ....schemas.experiment_tables import ABLATE
from ....schemas.metrics import OBJECT_METRICS
from ....schemas.settings import Settings
from ....stages.method import Memo, compare, partition
from ...engine.task import PairTask
from ...engine.workbench import Workbench

if TYPE_CHECKING:
    from .ablate import Point


def setting_rows(task: PairTask, walk: Sequence[tuple[Point, Settings]]) -> pa.Table:
    """One row of `ablate` per point of the walk.

    The graphs and communities of both sides are made once, an object that is matched under several delta is scored
    once for each t.

    Parameters
    ----------
    task : a pair whose ground is removed
    walk : points of the same k and tau, each with all settings
    """
    bench = Workbench(task)
    _, settings = walk[0]
    real, sim = (partition(bench.object_points(side)[1], settings) for side in SIDES)
    memo: Memo = {}
    rows = []
    for point, settings in walk:
        summary = compare(real, sim, settings, memo=memo).summary
        rows.append(
            vars(point)
            | {
                "pair_id": task.pair.pair_id,
                "n_communities_real": len(real.objects.n_points),
                "n_communities_sim": len(sim.objects.n_points),
            }
            | {name: summary[name] for name in ("n_matched", "match_rate")}
            | {f"{metric}_mean": summary[f"{metric}_mean"] for metric in OBJECT_METRICS}
        )
    return ABLATE.from_rows(rows)
