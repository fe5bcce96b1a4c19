"""The stages that score a pair by its objects, in memory, on tables that exist already."""

from __future__ import annotations

import numpy as np
import pyarrow as pa

from ...schemas.settings import Settings
from ...stages.arrays import FloatArray
from ..engine.worker import PairTables, run_in_memory
from ..stage import OF_PAIR, Metadata
from . import (
    communities_job,
    graph_job,
    ground_job,
    matching_job,
    metrics_job,
    selection_job,
)

#: The stages that partition a side.
PARTITION = (ground_job.STAGE, graph_job.STAGE, communities_job.STAGE)
SCORING = (*PARTITION, matching_job.STAGE, selection_job.STAGE, metrics_job.STAGE)


def score_pair(settings: Settings, tables: PairTables) -> Metadata:
    """The columns of `pairs` with the scores of a pair.

    Parameters
    ----------
    tables : ground of both sides, and tables of later stages that are not to be recomputed
    """
    _, outputs = run_in_memory(SCORING, settings, tables=tables)
    return outputs["metrics", ""][OF_PAIR]


def ground_table(points: FloatArray) -> pa.Table:
    """Object points without annotation, (n, 3) float64 metres, with the columns of `ground` that later stages read."""
    n = len(points)
    columns = {
        "point_id": np.arange(n, dtype=np.int32),
        "is_ground": np.zeros(n, dtype=np.bool_),
        "label": pa.nulls(n),
        "instance": pa.nulls(n),
    }
    return pa.table(columns | dict(zip("xyz", points.T, strict=True)))
