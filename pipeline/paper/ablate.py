"""`fidpipe ablate`: how match rate and r_lambda depend on k, tau, delta and t (paper, section "Ablation Study").

One at a time around the settings in force, or as a grid. A job is one pair under one graph setting: the graph and the
communities are made once, and matching, selection and scores under all delta and t that are asked for walk over them.
The paper names its choice (k = 90, tau = 0.2, delta = 5) and no ranges; those here are ours.
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

from ...schemas.columns import SIDES
from ...schemas.errors import SettingsError
from ...schemas.experiment_tables import ABLATE, ABLATE_SUMMARY
from ...schemas.metrics import DATASET_SCORES
from ...schemas.settings import Settings, parse
from ...stages.arrays import FloatArray
from ...stages.paper.parameter_choice import Choice, Influence, ParameterSet, Trial, choose_parameters, influence
from ..engine.engine import Machines
from ..engine.plan import Part
from ..engine.progress import Reporter
from .ablate_jobs import STAGE
from .experiment import ExperimentOutcome, experimenting, mean_rows, read_source

#: The ablated settings: column of `ablate`, group and name of the setting, and the values that are tried.
PARAMETERS = {
    "k": ("graph", "k", (30, 60, 90, 120, 150)),
    "tau_m": ("graph", "tau_m", (0.1, 0.2, 0.3, 0.5)),
    "delta_m": ("matching", "delta_m", (1.0, 3.0, 5.0, 7.0, 10.0)),
    "t": ("selection", "t", (0.1, 0.5, 1.0, 2.0, 5.0)),
}


_NAMES = list(PARAMETERS)
#: The settings that the rule can choose.
CHOSEN = ("k", "tau_m", "t")


@dataclass(frozen=True, kw_only=True)
class AblateOutcome(ExperimentOutcome):
    """What has become of the experiment.

    base : the settings in force
    values : by parameter, all that were tried, ascending
    rows : of `ablate`, one row per pair and parameter set
    """

    base: ParameterSet
    values: dict[str, tuple[float, ...]]
    grid: bool
    rows: pa.Table

    def along(self, name: str) -> list[ParameterSet]:
        """The parameter sets in which one parameter moves and the others are in force."""
        return [self.base.with_value(name, value) for value in self.values[name]]

    def scores(self, metric: str, tried: Sequence[ParameterSet]) -> FloatArray:
        """(n_pairs, n_sets) values of a column of `ablate`; pairs in which one is missing are left out."""
        wide = self.rows.to_pandas().pivot(index="pair_id", columns=_NAMES, values=metric)
        columns = pd.MultiIndex.from_tuples([tuple(vars(parameters).values()) for parameters in tried])
        values: FloatArray = wide.reindex(columns=columns).dropna().to_numpy(dtype=np.float64)
        return values


def ablate_dataset(
    dataset: Path,
    out: Path,
    settings: Settings,
    reporter: Reporter,
    *,
    values: Mapping[str, Sequence[float]] | None = None,
    grid: bool = False,
    pattern: str | None = None,
    machines: Machines | None = None,
    replace: bool = False,
) -> AblateOutcome:
    """Evaluate the pairs of a dataset under each choice of the settings, and write the tables.

    Parameters
    ----------
    settings : around which one at a time is moved
    values : by parameter, those to try besides the value in force; by default those of `PARAMETERS`
    grid : all combinations instead of one at a time
    pattern : only pairs whose name matches (shell style)
    machines, replace : see `experimenting`

    Raises
    ------
    FidpipeError
        The dataset, a setting or the folder is wrong; before any work.
    """
    base, asked = parameters_of(settings), dict(values or {})
    if settings.communities.objects == "reference":
        if {*asked.get("delta_m", ())} - {base.delta_m}:
            raise SettingsError("--delta: objects that the real side fixes are not matched by distance; leave it out")
        asked["delta_m"] = ()
    tried = {name: _values(name, asked.get(name, PARAMETERS[name][2]), getattr(base, name)) for name in _NAMES}
    settings_of = {choice: with_parameters(settings, choice) for choice in parameter_sets(base, tried, grid)}
    source = read_source(dataset, pattern, machines=machines)
    if source.is_scan:
        raise SettingsError(f"{dataset}: is a scan; ablate compares real and simulated scans of a dataset")
    with experimenting(
        "ablate", source, out, settings, reporter, stages=(STAGE,), sides=SIDES, machines=machines, replace=replace
    ) as experiment:
        facts = {"values": {name: list(own) for name, own in tried.items()}, "grid": grid}
        experiment.make({plan.pair_id: _parts(settings_of) for plan in experiment.prepare()}, facts)
        rows = experiment.rows(ABLATE.name).sort_by([(key, "ascending") for key in ABLATE.keys])
        scores = rows.to_pandas().melt(_NAMES, DATASET_SCORES, "metric")
        means = ({"n_pairs": row.pop("n"), **row} for row in mean_rows(scores, [*_NAMES, "metric"]))
        experiment.write_summary(ABLATE_SUMMARY, list(means))
        return AblateOutcome(**experiment.finish(), base=base, values=tried, grid=grid, rows=rows)


def choose(outcome: AblateOutcome) -> list[Choice]:
    """A choice for each parameter that the rule can choose and that has several values, and for the grid."""
    tried = {name: outcome.along(name) for name in CHOSEN if len(outcome.values[name]) > 1}
    if outcome.grid:
        rows = outcome.rows.to_pandas()[_NAMES].drop_duplicates()
        rows = rows[rows["delta_m"] == outcome.base.delta_m]
        tried["grid"] = [ParameterSet(*row) for row in rows.itertuples(index=False)]
    return choose_parameters(
        [
            Trial(
                name,
                own,
                own.index(outcome.base),
                outcome.scores("match_rate", own),
                outcome.scores("r_lambda_mean", own),
            )
            for name, own in tried.items()
        ]
    )


def influences(outcome: AblateOutcome) -> list[Influence]:
    """How far match rate and r_lambda move with each parameter; needs two pairs and two values of it."""
    moves = (
        influence(name, metric, outcome.scores(metric, tried), tried.index(outcome.base))
        for name in PARAMETERS
        for tried in [outcome.along(name)]
        for metric in ("match_rate", "r_lambda_mean")
    )
    return [move for move in moves if move is not None]


def parameters_of(settings: Settings) -> ParameterSet:
    """The four settings in force."""
    return ParameterSet(settings.graph.k, settings.graph.tau_m, settings.matching.delta_m, settings.selection.t)


def parameter_sets(base: ParameterSet, values: dict[str, tuple[float, ...]], grid: bool) -> list[ParameterSet]:
    """The choices to try: one parameter moved at a time, or all combinations.

    Examples
    --------
    >>> base = ParameterSet(90, 0.2, 5.0, 1.0)
    >>> values = {"k": (60, 90), "tau_m": (0.2,), "delta_m": (5.0,), "t": (1.0,)}
    >>> [choice.k for choice in parameter_sets(base, values, grid=False)]
    [60, 90]
    """
    if grid:
        return [ParameterSet(int(k), *rest) for k, *rest in product(*values.values())]
    return sorted({base.with_value(name, value) for name, tried in values.items() for value in tried})


def with_parameters(settings: Settings, parameters: ParameterSet) -> Settings:
    """The settings with the four values of a parameter set.

    Raises
    ------
    SettingsError
        A value is out of the bounds of its setting.
    """
    plain: dict[str, Any] = settings.model_dump(mode="json")
    for name, (group, setting, _) in PARAMETERS.items():
        plain[group][setting] = getattr(parameters, name)
    return parse(plain)


def _values(name: str, asked: Sequence[float], now: float) -> tuple[float, ...]:
    """The values of a parameter to try, ascending, with the one in force among them."""
    if name != "k":
        return tuple(sorted({*map(float, asked), now}))
    if any(value != int(value) for value in asked):
        raise SettingsError(f"--k {', '.join(f'{value:g}' for value in asked)}: whole numbers are wanted")
    return tuple(sorted({*map(int, asked), int(now)}))


def _parts(settings_of: dict[ParameterSet, Settings]) -> list[Part]:
    """The wanted parts of a pair: one for each distinct setting of the graph."""
    by_graph: dict[tuple[int, float], list[ParameterSet]] = {}
    for parameters in settings_of:
        by_graph.setdefault((parameters.k, parameters.tau_m), []).append(parameters)
    parts = []
    for (k, tau_m), own in by_graph.items():
        neutral = with_parameters(settings_of[own[0]], ParameterSet(k, tau_m, 1.0, 1.0))  # delta and t are arguments
        arguments = ([[*vars(parameters).values()] for parameters in own],)
        parts.append(Part(STAGE, f"k{k}-tau{tau_m!r}", arguments, neutral))
    return parts
