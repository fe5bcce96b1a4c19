"""`fidpipe ablate`: match rate and r_lambda as functions of k, tau, delta and t (paper, section "Ablation Study").

One parameter is varied at a time around the current settings, or all as a grid. The
paper states its choice (k = 90, tau = 0.2, delta = 5) but no ranges; those here are ours.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby, product
from pathlib import Path
from typing import Any, NamedTuple

import pandas as pd
import pyarrow as pa

from ...schemas.columns import SIDES, Row
from ...schemas.errors import SettingsError
from ...schemas.metric_catalogue import DATASET_SCORES, OBJECT_METRICS
from ...schemas.settings import Settings, parse
from ...schemas.tables import TABLES
from ...stages.method import Memo, compare, n_communities, partition
from ...stages.plausibility import ScanInspection
from ..datasets.pairs import ScanPair
from ..datasets.readers.scan import Scan
from ..datasets.readers.scan_ref import scan_ref
from ..engine.plan import plan_jobs
from ..engine.progress import Reporter
from ..engine.worker import run_in_memory
from ..jobs import ground_job
from ..jobs.points_job import annotation_in, points_in
from ..pair_checks import pair_warnings
from ..stage import INSPECTION, JobResult
from .experiment import (
    Experiment,
    ExperimentOutcome,
    Request,
    mean_rows,
    read_source,
    run_experiment,
)


class ParameterSet(NamedTuple):
    """Values of the four ablated settings: k, tau and delta in metres, diffusion time t."""

    k: int
    tau_m: float
    delta_m: float
    t: float


@dataclass(frozen=True, kw_only=True)
class Parameter:
    """A setting that is varied.

    group : group of the setting
    values : values to try by default
    label : label of its axis in the figure
    """

    group: str
    values: tuple[float, ...]
    label: str


#: The ablated settings by name, which is also their column of `ablate`.
PARAMETERS = {
    "k": Parameter(
        group="graph",
        values=(30, 60, 90, 120, 150),
        label="k, neighbours",
    ),
    "tau_m": Parameter(
        group="graph",
        values=(0.1, 0.2, 0.3, 0.5),
        label="tau (m)",
    ),
    "delta_m": Parameter(
        group="matching",
        values=(1.0, 3.0, 5.0, 7.0, 10.0),
        label="delta (m)",
    ),
    "t": Parameter(
        group="selection",
        values=(0.1, 0.5, 1.0, 2.0, 5.0),
        label="t, diffusion time",
    ),
}
_NAMES = list(PARAMETERS)
_SUMMARY = ("n_matched", "match_rate", *(f"{metric}_mean" for metric in OBJECT_METRICS))


def evaluate_pair(
    pair: ScanPair,
    scans: Mapping[str, Scan],
    settings: Settings,
    request: Request,
) -> JobResult:
    """One row of `ablate` per parameter set of the request.

    Graphs and communities of both sides are computed once for each k and tau; an object that is
    matched under several delta is scored once for each t.
    """
    jobs = plan_jobs((ground_job.STAGE,), settings)
    tables, outputs = run_in_memory(jobs, scans, pair)
    _, real_points = points_in(tables["ground", "real"])
    _, sim_points = points_in(tables["ground", "sim"])
    annotation = annotation_in(tables["ground", "real"])
    rows = []
    sets = parameter_sets(base_of(request), request["values"], request["grid"])
    for _, group in groupby(sets, lambda parameters: (parameters.k, parameters.tau_m)):
        of_graph = list(group)
        graph_settings = with_parameters(settings, of_graph[0])
        real = partition(real_points, graph_settings, annotation=annotation)
        sim = partition(sim_points, graph_settings, reference=real.reference)
        memo: Memo = {}
        for parameters in of_graph:
            used = with_parameters(settings, parameters)
            summary = compare(real, sim, used, memo=memo).summary
            row: Row = {"pair_id": pair.pair_id, **parameters._asdict()}
            row |= n_communities(summary)
            row |= {name: summary[name] for name in _SUMMARY}
            rows.append(row)
    inspections = {}
    for side in SIDES:
        inspections[side] = ScanInspection(**outputs["ground", side][INSPECTION])
    warnings = pair_warnings(pair, inspections, None)
    return JobResult({"ablate": TABLES["ablate"].from_rows(rows)}, {"warnings": warnings})


def _summary_rows(tables: Mapping[str, pa.Table]) -> list[Row]:
    """The rows of `ablate_summary`: means and standard deviations over the pairs."""
    scores = tables["ablate"].to_pandas().melt(_NAMES, DATASET_SCORES, "metric")
    return [{"n_pairs": row["n"], **row} for row in mean_rows(scores, [*_NAMES, "metric"])]


EXPERIMENT = Experiment(
    name="ablate",
    version=3,
    sides=SIDES,
    tables=("ablate",),
    summary="ablate_summary",
    evaluate=evaluate_pair,
    summarise=_summary_rows,
)


def ablate_dataset(
    dataset: Path,
    out: Path,
    settings: Settings,
    reporter: Reporter,
    *,
    values: Mapping[str, Sequence[float]] | None = None,
    grid: bool = False,
    pattern: str | None = None,
    n_workers: int | None = None,
    replace: bool = False,
) -> ExperimentOutcome:
    """Evaluate the pairs of a dataset under each parameter set and write the tables.

    Parameters
    ----------
    settings : current settings, around which parameters are varied
    values : by parameter, values to try in addition to the current one; by default those of
        `PARAMETERS`
    grid : all combinations instead of one at a time
    pattern : only pairs whose name matches (shell style)
    n_workers : processes; None for one per core
    replace : allow results of a finished experiment to be replaced by another request

    Raises
    ------
    FidpipeError
        The dataset, a setting or the folder is invalid; raised before any work.
    """
    base = ParameterSet(
        settings.graph.k,
        settings.graph.tau_m,
        settings.matching.delta_m,
        settings.selection.t,
    )
    requested = dict(values or {})
    if settings.communities.objects == "reference":
        if {*requested.get("delta_m", ())} - {base.delta_m}:
            raise SettingsError(
                "--delta: leave it out; objects fixed by the real side are not matched by distance",
            )
        requested["delta_m"] = ()
    tried = {}
    for name, parameter in PARAMETERS.items():
        tried[name] = sorted({*requested.get(name, parameter.values), getattr(base, name)})
    for parameters in parameter_sets(base, tried, grid):
        with_parameters(settings, parameters)  # raises before any work
    tried["k"] = [int(k) for k in tried["k"]]
    source = read_source(dataset, pattern)
    if scan_ref(dataset).exists:
        raise SettingsError(
            f"{dataset}: is a scan; expected a dataset with real and simulated scans",
        )
    request = {"base": list(base), "values": tried, "grid": grid}
    return run_experiment(
        EXPERIMENT,
        source,
        out,
        settings,
        reporter,
        request,
        n_workers=n_workers,
        replace_finished=replace,
    )


def base_of(request: Request) -> ParameterSet:
    """The current values of the parameters."""
    return ParameterSet(*request["base"])


def means_along(outcome: ExperimentOutcome, name: str) -> pd.DataFrame:
    """The rows of `ablate_summary` in which one parameter varies and the others have their current values."""
    summary = outcome.tables["ablate_summary"].to_pandas()
    for other, value in base_of(outcome.request)._asdict().items():
        if other != name:
            summary = summary[summary[other] == value]
    return summary


def parameter_sets(
    base: ParameterSet,
    values: Mapping[str, Sequence[Any]],
    grid: bool,
) -> list[ParameterSet]:
    """The parameter sets to try, ascending: one parameter varied at a time, or all combinations.

    Examples
    --------
    >>> base = ParameterSet(90, 0.2, 5.0, 1.0)
    >>> values = {"k": (60, 90), "tau_m": (0.2,), "delta_m": (5.0,), "t": (1.0,)}
    >>> [choice.k for choice in parameter_sets(base, values, grid=False)]
    [60, 90]
    """
    if grid:
        return [ParameterSet(*combination) for combination in product(*values.values())]
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
    for name, parameter in PARAMETERS.items():
        plain[parameter.group][name] = getattr(parameters, name)
    return parse(plain)
