"""`fidpipe ablate`: how match rate and r_lambda depend on k, tau, delta and t (paper, section "Ablation Study").

One at a time around the settings in force, or as a grid. A job is one pair under one graph setting: the graph and the
communities are made once, and matching, selection and scores under all delta and t that are asked for walk over them.
The paper names its choice (k = 90, tau = 0.2, delta = 5) and no ranges; those here are ours.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import product
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
import pyarrow as pa

from ....schemas.columns import SIDES
from ....schemas.errors import SettingsError
from ....schemas.experiment_tables import ABLATE, ABLATE_SUMMARY
from ....schemas.metrics import DATASET_SCORES
from ....schemas.settings import Settings, parse
from ....stages.summary import mean_and_std
from ...engine.costs import CostModel
from ...engine.engine import Machines
from ...engine.plan import PairPlan, Part
from ...engine.progress import Reporter
from ..experiment import Experiment, ExperimentOutcome, experimenting, read_source
from .jobs import STAGE

#: The ablated settings: column of `ablate`, group and name of the setting, and the values that are tried.
PARAMETERS = {
    "k": ("graph", "k", (30, 60, 90, 120, 150)),
    "tau_m": ("graph", "tau_m", (0.1, 0.2, 0.3, 0.5)),
    "delta_m": ("matching", "delta_m", (1.0, 3.0, 5.0, 7.0, 10.0)),
    "t": ("selection", "t", (0.1, 0.5, 1.0, 2.0, 5.0)),
}


@dataclass(frozen=True, order=True)
class Point:
    """One choice of the four settings: k, tau and delta in metres, diffusion time t."""

    k: int
    tau_m: float
    delta_m: float
    t: float


@dataclass(frozen=True)
class AblateRequest:
    """What the user asked for.

    dataset, out : folders
    settings : around which one setting at a time is moved
    values : by parameter, those to try besides the value in force; by default those of `PARAMETERS`
    grid : all combinations instead of one at a time
    pattern : only pairs whose name matches
    machines : where work is done
    """

    dataset: Path
    out: Path
    settings: Settings
    values: dict[str, tuple[float, ...]] = field(default_factory=dict)
    grid: bool = False
    pattern: str | None = None
    machines: Machines = field(default_factory=Machines)


@dataclass(frozen=True, kw_only=True)
class AblateOutcome(ExperimentOutcome):
    """What has become of the experiment.

    base : the settings in force
    values : by parameter, all that were tried, ascending
    rows : of `ablate`, one row per pair and point
    """

    base: Point
    values: dict[str, tuple[float, ...]]
    grid: bool
    rows: pa.Table


def ablate_dataset(request: AblateRequest, reporter: Reporter) -> AblateOutcome:
    """Evaluates the pairs of a dataset under each choice of the settings, and writes the tables.

    Raises
    ------
    FidpipeError
        The dataset, a setting or the folder is wrong; before any work.
    """
    start = perf_counter()
    base = point_of(request.settings)
    values = values_of(request)
    points = points_of(base, values, request.grid)
    settings_of = {point: with_point(request.settings, point) for point in points}
    source = read_source(request.dataset, request.pattern)
    if source.is_scan:
        raise SettingsError(f"{request.dataset}: is a scan; ablate compares real and simulated scans of a dataset")
    at = (source, request.out, request.settings, request.machines, reporter)
    with experimenting("ablate", *at, stages=(STAGE,), sides=SIDES) as experiment:
        plans = experiment.prepare()
        experiment.make({plan.pair_id: _parts(plan, points, settings_of) for plan in plans})
        rows = _summarise(experiment)
        wall_s = perf_counter() - start
        facts = {"values": {name: list(tried) for name, tried in values.items()}, "grid": request.grid}
        experiment.write_record("ablate", facts, wall_s)
        n_made, n_reused = experiment.engine.n_made, experiment.n_reused
    return AblateOutcome(
        folder=request.out,
        base=base,
        values=values,
        grid=request.grid,
        rows=rows,
        failures=experiment.failures,
        n_made=n_made,
        n_reused=n_reused,
        wall_s=wall_s,
    )


def point_of(settings: Settings) -> Point:
    """The four settings in force."""
    return Point(settings.graph.k, settings.graph.tau_m, settings.matching.delta_m, settings.selection.t)


def values_of(request: AblateRequest) -> dict[str, tuple[float, ...]]:
    """By parameter, the values to try, ascending, with the one in force among them."""
    base = point_of(request.settings)
    values = {}
    for name, (_, _, usual) in PARAMETERS.items():
        asked = request.values.get(name, usual)
        if name == "k" and any(value != int(value) for value in asked):
            raise SettingsError(f"--k {', '.join(f'{value:g}' for value in asked)}: whole numbers are wanted")
        values[name] = tuple(sorted({*(int(v) if name == "k" else float(v) for v in asked), getattr(base, name)}))
    return values


def points_of(base: Point, values: dict[str, tuple[float, ...]], grid: bool) -> list[Point]:
    """The choices to try: one parameter moved at a time, or all combinations.

    Examples
    --------
    >>> base = Point(90, 0.2, 5.0, 1.0)
    >>> [point.k for point in points_of(base, {"k": (60, 90), "tau_m": (0.2,), "delta_m": (5.0,), "t": (1.0,)}, False)]
    [60, 90]
    """
    if grid:
        return [Point(int(k), *rest) for k, *rest in product(*values.values())]
    return sorted({Point(**(vars(base) | {name: value})) for name, tried in values.items() for value in tried})


def with_point(settings: Settings, point: Point) -> Settings:
    """The settings with the four values of a point.

    Raises
    ------
    SettingsError
        A value is out of the bounds of its setting.
    """
    plain: dict[str, Any] = settings.model_dump(mode="json")
    for name, (group, setting, _) in PARAMETERS.items():
        plain[group][setting] = getattr(point, name)
    return parse(plain)


def _parts(plan: PairPlan, points: Sequence[Point], settings_of: dict[Point, Settings]) -> list[Part]:
    """The wanted parts of a pair: one for each distinct setting of the graph."""
    n_points = sum(job.record.facts["n_points"] for job in plan.jobs if job.record is not None)
    parts = []
    for k, tau_m in dict.fromkeys((point.k, point.tau_m) for point in points):
        walk = [point for point in points if (point.k, point.tau_m) == (k, tau_m)]
        neutral = with_point(settings_of[walk[0]], Point(k, tau_m, 1.0, 1.0))  # delta and t are arguments
        n_scorings = len({point.t for point in walk})
        seconds = 1e-4 * n_points + n_scorings * 20 * CostModel().object_seconds(n_points // 60)
        arguments = ([[*vars(point).values()] for point in walk],)
        parts.append(Part(STAGE, f"k{k}-tau{tau_m!r}", arguments, seconds, neutral))
    return parts


def _summarise(experiment: Experiment) -> pa.Table:
    """All rows of `ablate`; writes their means and standard deviations over pairs."""
    rows = experiment.rows(ABLATE.name).sort_by([(key, "ascending") for key in ABLATE.keys])
    summary = []
    for name, own in rows.to_pandas().groupby(["k", "tau_m", "delta_m", "t"], sort=False):
        for metric in DATASET_SCORES:
            values = own[metric].to_numpy(dtype=np.float64)
            mean, std = mean_and_std(values)
            summary.append(
                dict(zip(("k", "tau_m", "delta_m", "t"), name, strict=True))
                | {"metric": metric, "n_pairs": int(np.count_nonzero(~np.isnan(values))), "mean": mean, "std": std}
            )
    experiment.write_summary(ABLATE_SUMMARY, ABLATE_SUMMARY.from_rows(summary))
    return rows
