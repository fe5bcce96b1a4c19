"""`fidpipe ablate`: match rate and r_lambda as functions of k, tau, delta and t (paper, section "Ablation Study").

One parameter is varied at a time around the current settings. The paper states its choice
(k = 90, tau = 0.2, delta = 5) but no ranges; those here are ours.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import groupby
from pathlib import Path
from typing import Any, NamedTuple

import pandas as pd
from pydantic import BaseModel

from ...schemas.columns import SIDES, Row
from ...schemas.errors import SettingsError
from ...schemas.metric_catalogue import DATASET_SCORES
from ...schemas.settings import Settings, parse
from ..datasets.pairs import read_dataset
from ..engine.progress import Reporter
from ..engine.worker import run_in_memory
from ..jobs import ground_job
from ..jobs.scoring import PARTITION, score_pair
from ..run import select_pairs
from ..stage import Inputs, JobResult
from .experiment import (
    ExperimentOutcome,
    experiment_stage,
    run_experiment,
    run_stages,
    settings_of,
)


class ParameterSet(NamedTuple):
    """Values of the four ablated settings: k, tau and delta in metres, diffusion time t."""

    k: int
    tau_m: float
    delta_m: float
    t: float


class AblateRequest(BaseModel, frozen=True):
    """Values of each parameter to try, the current one among them."""

    k: tuple[int, ...] = (30, 60, 90, 120, 150)
    tau_m: tuple[float, ...] = (0.1, 0.2, 0.3, 0.5)
    delta_m: tuple[float, ...] = (1.0, 3.0, 5.0, 7.0, 10.0)
    t: tuple[float, ...] = (0.1, 0.5, 1.0, 2.0, 5.0)


class AblateSettings(Settings):
    """The settings of a run, around which parameters are varied, and how."""

    ablate: AblateRequest = AblateRequest()


#: The ablated settings by name, which is also their column of `ablate`, with their group.
PARAMETERS = {"k": "graph", "tau_m": "graph", "delta_m": "matching", "t": "selection"}


def make_ablation(inputs: Inputs) -> JobResult:
    """One row of `ablate` per parameter set; graphs and communities are computed once for each k and tau."""
    settings = settings_of(inputs.settings)
    ground = run_stages(inputs, [ground_job.STAGE], SIDES)
    rows: list[Row] = []
    request = inputs.settings.ablate  # type: ignore[attr-defined]
    sets = parameter_sets(current(settings), dict(request))
    for _, of_graph in groupby(sets, lambda parameters: (parameters.k, parameters.tau_m)):
        tables = None
        for parameters in of_graph:
            used = with_parameters(settings, parameters)
            if tables is None:
                tables, _ = run_in_memory(PARTITION, used, tables=ground)
            rows.append(parameters._asdict() | score_pair(used, tables))
    return JobResult(inputs.rows("ablate", rows))


STAGE = experiment_stage("ablate", 4, ("ablate",), make_ablation)


def ablate_dataset(
    dataset: Path,
    out: Path,
    settings: Settings,
    reporter: Reporter,
    *,
    values: Mapping[str, Sequence[float]] | None = None,
    pattern: str | None = None,
    n_workers: int | None = None,
    replace: bool = False,
) -> ExperimentOutcome:
    """Evaluate the pairs of a dataset under each parameter set and write the tables.

    Parameters
    ----------
    settings : current settings, around which parameters are varied
    values : by parameter, values to try in addition to the current one; by default those of
        `AblateRequest`
    pattern : only pairs whose name matches (shell style)
    n_workers : processes; None for one per core
    replace : allow results of a finished experiment to be replaced by another request

    Raises
    ------
    FidpipeError
        The dataset, a setting or the folder is invalid; raised before any work.
    """
    base = current(settings)
    requested = dict(AblateRequest()) | dict(values or {})
    if settings.communities.objects == "reference":
        if values and {*values.get("delta_m", ())} - {base.delta_m}:
            raise SettingsError(
                "--delta: leave it out; objects fixed by the real side are not matched by distance",
            )
        requested["delta_m"] = ()
    tried = {name: sorted({*requested[name], getattr(base, name)}) for name in PARAMETERS}
    for parameters in parameter_sets(base, tried):
        with_parameters(settings, parameters)  # raises before any work
    source = read_dataset(dataset)
    return run_experiment(
        STAGE,
        source,
        select_pairs(source, pattern),
        out,
        AblateSettings(**dict(settings), ablate=AblateRequest(**tried)),
        reporter,
        lambda tables: [tables["ablate"].melt([*PARAMETERS], DATASET_SCORES, "metric")],
        n_workers=n_workers,
        replace_finished=replace,
    )


def current(settings: Settings) -> ParameterSet:
    """The current values of the parameters."""
    values = [getattr(getattr(settings, group), name) for name, group in PARAMETERS.items()]
    return ParameterSet(*values)


def means_along(outcome: ExperimentOutcome, name: str) -> pd.DataFrame:
    """The rows of `ablate_summary` in which one parameter varies and the others have their current values."""
    summary = outcome.tables["ablate_summary"].to_pandas()
    for other, value in current(outcome.settings)._asdict().items():
        if other != name:
            summary = summary[summary[other] == value]
    return summary


def parameter_sets(
    base: ParameterSet, values: Mapping[str, Sequence[Any]]
) -> list[ParameterSet]:
    """The parameter sets to try, ascending: one parameter varied at a time.

    Examples
    --------
    >>> base = ParameterSet(90, 0.2, 5.0, 1.0)
    >>> values = {"k": (60, 90), "tau_m": (0.2,), "delta_m": (5.0,), "t": (1.0,)}
    >>> [choice.k for choice in parameter_sets(base, values)]
    [60, 90]
    """
    sets = set()
    for name, tried in values.items():
        sets |= {base._replace(**{name: value}) for value in tried}
    return sorted(sets)


def with_parameters(settings: Settings, parameters: ParameterSet) -> Settings:
    """The settings with the values of a parameter set.

    Raises
    ------
    SettingsError
        A value is out of bounds.
    """
    plain: dict[str, Any] = settings.model_dump(mode="json")
    for name, group in PARAMETERS.items():
        plain[group][name] = getattr(parameters, name)
    return parse(plain)
