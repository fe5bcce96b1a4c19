"""`fidpipe ablate`: match rate and r_lambda as functions of k, tau, delta and t (paper, section "Ablation Study").

One parameter is varied at a time around the current settings, or all as a grid. The
paper states its choice (k = 90, tau = 0.2, delta = 5) but no ranges; those here are ours.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa

from ...schemas.columns import SIDES, Row
from ...schemas.errors import SettingsError
from ...schemas.metric_catalogue import DATASET_SCORES, OBJECT_METRICS
from ...schemas.settings import Settings, parse
from ...schemas.tables import TABLES
from ...stages.arrays import FloatArray
from ...stages.method import Memo, compare, n_communities, partition
from ...stages.paper.parameter_choice import Choice, ParameterSet, Trial, choose_parameters
from ...stages.plausibility import ScanInspection
from ..datasets.pairs import ScanPair
from ..datasets.readers.scan import Scan
from ..datasets.readers.scan_ref import scan_ref
from ..engine.memory import run_in_memory
from ..engine.plan import Planner
from ..engine.progress import Reporter
from ..jobs import STAGES, ground_job
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


@dataclass(frozen=True, kw_only=True)
class Parameter:
    """A setting that is varied.

    group : group of the setting
    values : values to try by default
    text : meaning, in tables
    label : label of its axis in the figure
    """

    group: str
    values: tuple[float, ...]
    text: str
    label: str


#: The ablated settings by name, which is also their column of `ablate`.
PARAMETERS = {
    "k": Parameter(
        group="graph",
        values=(30, 60, 90, 120, 150),
        text="nearest neighbours of each point",
        label="k, neighbours",
    ),
    "tau_m": Parameter(
        group="graph",
        values=(0.1, 0.2, 0.3, 0.5),
        text="distance within which all points are connected, metres",
        label="tau (m)",
    ),
    "delta_m": Parameter(
        group="matching",
        values=(1.0, 3.0, 5.0, 7.0, 10.0),
        text="largest distance of matched centroids, metres",
        label="delta (m)",
    ),
    "t": Parameter(
        group="selection",
        values=(0.1, 0.5, 1.0, 2.0, 5.0),
        text="diffusion time of the heat kernel",
        label="t, diffusion time",
    ),
}
_NAMES = list(PARAMETERS)
#: The parameters that the rule can choose.
CHOSEN = ("k", "tau_m", "t")
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
    jobs = Planner((ground_job.STAGE,), settings, {}).jobs()
    tables, outputs = run_in_memory(jobs, scans, pair.pair_id, pair.T_real_sim)
    _, real_points = points_in(tables["ground", "real"])
    _, sim_points = points_in(tables["ground", "sim"])
    annotation = annotation_in(tables["ground", "real"])
    base = ParameterSet(*request["base"])
    rows = []
    for sets in _by_graph(parameter_sets(base, request["values"], request["grid"])):
        graph_settings = with_parameters(settings, sets[0])
        real = partition(real_points, graph_settings, annotation=annotation)
        sim = partition(sim_points, graph_settings, reference=real.reference)
        memo: Memo = {}
        for parameters in sets:
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


def _by_graph(sets: Sequence[ParameterSet]) -> list[list[ParameterSet]]:
    """The parameter sets in groups of the same graph."""
    groups: dict[tuple[int, float], list[ParameterSet]] = {}
    for parameters in sets:
        groups.setdefault((parameters.k, parameters.tau_m), []).append(parameters)
    return list(groups.values())


def _summary_rows(tables: Mapping[str, pa.Table]) -> list[Row]:
    """The rows of `ablate_summary`: means and standard deviations over the pairs."""
    scores = tables["ablate"].to_pandas().melt(_NAMES, DATASET_SCORES, "metric")
    rows = []
    for row in mean_rows(scores, [*_NAMES, "metric"]):
        n_pairs = row.pop("n")
        rows.append({"n_pairs": n_pairs, **row})
    return rows


EXPERIMENT = Experiment(
    name="ablate",
    version=3,
    sides=SIDES,
    stages=STAGES,
    tables=("ablate",),
    summary="ablate_summary",
    evaluate=evaluate_pair,
    summarise=_summary_rows,
)


@dataclass(frozen=True, kw_only=True)
class AblateOutcome(ExperimentOutcome):
    """Outcome of the experiment.

    base : the current settings
    values : by parameter, all tried values, ascending
    """

    base: ParameterSet
    values: dict[str, tuple[float, ...]]
    grid: bool

    @property
    def rows(self) -> pa.Table:
        """The table `ablate`: one row per pair and parameter set."""
        return self.tables["ablate"]

    def along(self, name: str) -> list[ParameterSet]:
        """The parameter sets in which one parameter varies and the others have their current values."""
        return [self.base.with_value(name, value) for value in self.values[name]]

    def scores(self, metric: str, tried: Sequence[ParameterSet]) -> FloatArray:
        """(n_pairs, n_sets) values of a column of `ablate`, without pairs where one is missing."""
        wide = self.rows.to_pandas().pivot(index="pair_id", columns=_NAMES, values=metric)
        values: FloatArray = (
            wide.reindex(
                columns=pd.MultiIndex.from_tuples(tried),
            )
            .dropna()
            .to_numpy(dtype=np.float64)
        )
        return values

    def spreads(
        self,
        columns: Sequence[str],
        tried: Sequence[ParameterSet] | None = None,
    ) -> pd.DataFrame:
        """Mean and std over pairs of some columns, one row per parameter set; by default all that exist, ascending."""
        spreads: pd.DataFrame = self.rows.to_pandas().groupby(_NAMES)[[*columns]].agg(["mean", "std"])
        return spreads if tried is None else spreads.reindex(pd.MultiIndex.from_tuples(tried))

    @property
    def n_pairs(self) -> int:
        """Number of pairs with rows."""
        return len(self.rows.column("pair_id").unique())


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
) -> AblateOutcome:
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
        tried[name] = _values(name, requested.get(name, parameter.values), getattr(base, name))
    for parameters in parameter_sets(base, tried, grid):
        with_parameters(settings, parameters)  # raises before any work
    source = read_source(dataset, pattern)
    if scan_ref(dataset).exists:
        raise SettingsError(
            f"{dataset}: is a scan; expected a dataset with real and simulated scans",
        )
    request = {
        "base": list(base),
        "values": {name: list(numbers) for name, numbers in tried.items()},
        "grid": grid,
    }
    outcome = run_experiment(
        EXPERIMENT,
        source,
        out,
        settings,
        reporter,
        request,
        n_workers=n_workers,
        replace_finished=replace,
    )
    return AblateOutcome(**vars(outcome), base=base, values=tried, grid=grid)


def choose(outcome: AblateOutcome) -> list[Choice]:
    """A choice for each parameter with several values that the rule covers, and for the grid."""
    tried = {name: outcome.along(name) for name in CHOSEN if len(outcome.values[name]) > 1}
    if outcome.grid:
        rows = outcome.rows.to_pandas()[_NAMES].drop_duplicates()
        rows = rows[rows["delta_m"] == outcome.base.delta_m]
        tried["grid"] = [ParameterSet(*row) for row in rows.itertuples(index=False)]
    trials = []
    for name, sets in tried.items():
        match_rate = outcome.scores("match_rate", sets)
        r_lambda = outcome.scores("r_lambda_mean", sets)
        trials.append(Trial(name, sets, sets.index(outcome.base), match_rate, r_lambda))
    return choose_parameters(trials)


def parameter_sets(
    base: ParameterSet,
    values: dict[str, tuple[float, ...]],
    grid: bool,
) -> list[ParameterSet]:
    """The parameter sets to try: one parameter varied at a time, or all combinations.

    Examples
    --------
    >>> base = ParameterSet(90, 0.2, 5.0, 1.0)
    >>> values = {"k": (60, 90), "tau_m": (0.2,), "delta_m": (5.0,), "t": (1.0,)}
    >>> [choice.k for choice in parameter_sets(base, values, grid=False)]
    [60, 90]
    """
    if grid:
        return [ParameterSet(int(k), *rest) for k, *rest in product(*values.values())]
    sets = set()
    for name, tried in values.items():
        sets |= {base.with_value(name, value) for value in tried}
    return sorted(sets)


def with_parameters(settings: Settings, parameters: ParameterSet) -> Settings:
    """The settings with the values of a parameter set.

    Raises
    ------
    SettingsError
        A value is out of bounds.
    """
    plain: dict[str, Any] = settings.model_dump(mode="json")
    for (name, parameter), value in zip(PARAMETERS.items(), parameters, strict=True):
        plain[parameter.group][name] = value
    return parse(plain)


def _values(name: str, requested: Sequence[float], current: float) -> tuple[float, ...]:
    """The values of a parameter to try including the current one, ascending."""
    values = sorted({*requested, current})
    if name != "k":
        return tuple(float(value) for value in values)
    if any(value != int(value) for value in values):
        got = ", ".join(f"{value:g}" for value in requested)
        raise SettingsError(f"--k: expected whole numbers, got {got}")
    return tuple(int(value) for value in values)
