"""The job of `fidpipe ablate`: one pair under one setting of the graph, and all matching and selection settings on it.

Leaves to others: which settings there are (`ablate`).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
import pyarrow as pa

from ....schemas.columns import SIDES
from ....schemas.experiment_tables import ABLATE
from ....schemas.metrics import OBJECT_METRICS
from ....schemas.settings import Settings
from ....stages.linalg.laplacian import Subgraph
from ....stages.matching import match_communities
from ....stages.metrics import Scores
from ....stages.summary import mean_and_std
from ...engine.task import PairTask
from ...engine.workbench import Workbench
from ..partition import partition, score

if TYPE_CHECKING:
    from .ablate import Point


def setting_rows(task: PairTask, walk: Sequence[tuple[Point, Settings]]) -> pa.Table:
    """A row a point of `ablate`.

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
    objects: dict[str, dict[int, Subgraph]] = {side: {} for side in SIDES}
    scores: dict[tuple[int, int, float], Scores] = {}
    rows = []
    for point, settings in walk:
        matching = match_communities(real.centroids, sim.centroids, settings.matching)
        pairs = list(zip(matching.real_ids.tolist(), matching.sim_ids.tolist(), strict=True))
        for side, scan, ids in (("real", real, matching.real_ids), ("sim", sim, matching.sim_ids)):
            objects[side] |= scan.objects([i for i in ids.tolist() if i not in objects[side]])
        for a, b in pairs:
            if (a, b, point.t) not in scores:
                scores[a, b, point.t] = score(objects["real"][a], objects["sim"][b], settings)
        found = [scores[a, b, point.t] for a, b in pairs]
        row = vars(point) | {
            "pair_id": task.pair.pair_id,
            "n_communities_real": len(real.centroids),
            "n_communities_sim": len(sim.centroids),
            "n_matched": len(pairs),
            "match_rate": matching.match_rate,
            "centroid_distance_m_mean": mean_and_std(matching.distance_m)[0],
        }
        for metric in OBJECT_METRICS[1:]:
            values = [getattr(of, metric) for of in found]
            known = np.array([value for value in values if value is not None], dtype=np.float64)
            row[f"{metric}_mean"] = mean_and_std(known)[0]
        rows.append(row)
    return ABLATE.from_rows(rows)
