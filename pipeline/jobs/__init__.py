"""The pipeline: its stages in their order. One file per stage, with its declaration and the job that makes its tables.

Nothing outside this folder knows a stage by name. To add one: a table in `schemas/tables.csv`, a settings class, a
function in `stages`, a file here, and its row below.
"""

from __future__ import annotations

from ...schemas.settings import Settings
from ..stage import Stage
from . import (
    baselines_job,
    causes_job,
    communities_job,
    coverage_job,
    graph_job,
    ground_job,
    matching_job,
    metrics_job,
    pieces_job,
    rays_job,
    seeds_job,
    selection_job,
    sensor_job,
    surface_job,
)

STAGES = (
    *(ground_job.STAGE, sensor_job.STAGE, graph_job.STAGE, communities_job.STAGE, matching_job.STAGE),
    *(
        coverage_job.STAGE,
        surface_job.STAGE,
        pieces_job.STAGE,
        rays_job.STAGE,
        causes_job.STAGE,
        selection_job.STAGE,
        metrics_job.STAGE,
    ),
)

#: Additional stages that the settings may request; no stage above depends on them.
EXTRAS = (baselines_job.STAGE, seeds_job.STAGE)


def stages_under(settings: Settings) -> tuple[Stage, ...]:
    """The stages that a run under these settings goes through."""
    return (*STAGES, *(stage for stage in EXTRAS if stage.is_wanted is not None and stage.is_wanted(settings)))
