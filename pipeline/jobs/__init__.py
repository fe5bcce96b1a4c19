"""The pipeline: its stages in their order. One file a stage, with what it declares and the job that makes its tables.

Nothing outside this folder knows a stage by name. To add one: a table in `schemas.tables`, a settings class, a function
in `stages`, a file here, and its row below.
"""

from __future__ import annotations

from ...schemas.settings import Settings
from ..stage import Stage
from . import (
    baselines,
    communities,
    coverage,
    graph,
    ground,
    matching,
    metrics,
    pieces,
    seeds,
    selection,
    sensor,
    surface,
)

STAGES = (
    *(ground.STAGE, sensor.STAGE, graph.STAGE, communities.STAGE, matching.STAGE),
    *(coverage.STAGE, surface.STAGE, pieces.STAGE, selection.STAGE, metrics.STAGE),
)

#: Additional stages that the settings may request; no stage above depends on them.
EXTRAS = (baselines.STAGE, seeds.STAGE)


def stages_under(settings: Settings) -> tuple[Stage, ...]:
    """The stages that a run under these settings goes through."""
    return (*STAGES, *(stage for stage in EXTRAS if stage.is_wanted is not None and stage.is_wanted(settings)))
