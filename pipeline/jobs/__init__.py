"""The pipeline: its stages in their order. One file per stage, with its declaration and the job that makes its tables.

Nothing outside this folder knows a stage by name. To add one: a table in `schemas/tables.csv`, a
settings class, a function in `stages`, a file here, and its row below.
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
    tasks_job,
)

#: The stages of a run in their order: the method on one screen, and what runs.
STAGES = (
    ground_job.STAGE,  # clean points, and which of them are road
    sensor_job.STAGE,  # beams, steps, noise and losses of each side's sensor
    graph_job.STAGE,  # edges among the object points of a side
    communities_job.STAGE,  # objects of a side
    matching_job.STAGE,  # objects that both sides have
    coverage_job.STAGE,  # surface that both sides have
    surface_job.STAGE,  # displacement and roughness of surfaces
    pieces_job.STAGE,  # connected surface that only one side has
    rays_job.STAGE,  # each ray of the real sensor on both sides
    causes_job.STAGE,  # amounts of all flaws of the simulated side
    selection_job.STAGE,  # aligned nodes of matched objects
    metrics_job.STAGE,  # scores of matched objects
)

#: Additional stages that the settings may request; no stage above depends on them.
EXTRAS = (baselines_job.STAGE, seeds_job.STAGE, tasks_job.STAGE)


def stages_under(settings: Settings) -> tuple[Stage, ...]:
    """The stages that a run under these settings goes through."""
    extras = [stage for stage in EXTRAS if stage.is_wanted and stage.is_wanted(settings)]
    return (*STAGES, *extras)
