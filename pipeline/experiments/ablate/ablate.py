"""`fidpipe ablate`: how match rate and r_lambda depend on k, tau, delta and t (paper, section "Ablation Study").

One at a time around the settings in force, or as a grid. A job is one pair under one graph setting: the graph and the
communities are made once, and matching, selection and scores under all delta and t that are asked for walk over them.
The paper names its choice (k = 90, tau = 0.2, delta = 5) and no ranges; those here are ours. Leaves to others: the job
(`ablate_jobs`), which setting is to be preferred (`ablate_choice`), pictures.
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
import pyarrow.parquet as pq

from ....schemas.errors import SettingsError
from ....schemas.experiment_tables import ABLATE, ABLATE_SUMMARY
from ....schemas.metrics import DATASET_SCORES
from ....schemas.settings import Settings, parse
from ....stages.summary import mean_and_std
from ...engine.costs import object_seconds
from ...engine.progress import Reporter
from ...engine.task import PairTask
from ...run import STAGES
from ...storage.ledger import JobRecord
from ...storage.record import run_header
from ...storage.store import key_of
from ..sources import method_key, prepare, read_source
from ..sweep import Part, Sweep, SweepOutcome, sweeping
from .jobs import setting_rows

VERSION = 1  # of the job; to be raised when the same request gives other numbers
TABLE, SUMMARY = "ablate", "ablate_summary"

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
    workers, scheduler : as in `RunRequest`
    """

    dataset: Path
    out: Path
    settings: Settings
    values: dict[str, tuple[float, ...]] = field(default_factory=dict)
    grid: bool = False
    pattern: str | None = None
    workers: int | None = None
    scheduler: str | None = None


@dataclass(frozen=True, kw_only=True)
class AblateOutcome(SweepOutcome):
    """What has become of the experiment.

    base : the settings in force
    values : by parameter, all that were tried, ascending
    rows : of `ablate`, a row a pair and point
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
    at = (request.dataset, request.out, request.settings, request.workers, request.scheduler, reporter)
    with sweeping("ablate", *at) as sweep:
        tasks = prepare(sweep, source, request.settings, ("real", "sim"), ("ground",))
        sweep.run([part for task in tasks for part in _parts(task, points, settings_of)], [TABLE])
        rows = _gather(sweep)
        wall_s = perf_counter() - start
        sweep.record(
            {
                "experiment": "ablate",
                **run_header(request.dataset, request.settings, STAGES),
                "values": {name: list(of) for name, of in values.items()},
                "grid": request.grid,
                "failures": sweep.failures,
                "jobs": {"made": sweep.n_made, "reused": sweep.n_reused},
                "wall_s": wall_s,
            }
        )
    return AblateOutcome(
        folder=request.out,
        base=base,
        values=values,
        grid=request.grid,
        rows=rows,
        failures=sweep.failures,
        n_made=sweep.n_made,
        n_reused=sweep.n_reused,
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
    return sorted({Point(**(vars(base) | {name: value})) for name, of in values.items() for value in of})


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


def _parts(task: PairTask, points: Sequence[Point], settings_of: dict[Point, Settings]) -> list[Part]:
    """The jobs of a pair: one for each distinct setting of the graph."""
    n_points = sum(job.facts["n_points"] for job in task.jobs)
    parts = []
    for k, tau_m in dict.fromkeys((point.k, point.tau_m) for point in points):
        walk = [point for point in points if (point.k, point.tau_m) == (k, tau_m)]
        neutral = with_point(settings_of[walk[0]], Point(k, tau_m, 1.0, 1.0))
        method = method_key(neutral, [stage.name for stage in STAGES if stage.name != "ground"])
        plain = [[point.delta_m, point.t] for point in walk]
        key = key_of(TABLE, VERSION, [job.key for job in task.jobs], method, plain)
        n_scorings = len({point.t for point in walk})
        cost_s = 1e-4 * n_points + n_scorings * 20 * object_seconds(n_points // 60)
        args = (task, [(point, settings_of[point]) for point in walk])
        parts.append(Part(TABLE, task.pair.pair_id, f"k{k}-tau{tau_m!r}", key, setting_rows, args, cost_s))
    return parts


def _gather(sweep: Sweep) -> pa.Table:
    """All rows of `ablate`; writes their means and standard deviations over pairs."""
    records = [record for record in sweep.store.records.values() if record.stage == TABLE]
    parts = [pq.read_table(sweep.out / name) for record in records for name in record.files]
    rows = pa.concat_tables([ABLATE.schema.empty_table(), *parts]).sort_by([(key, "ascending") for key in ABLATE.keys])
    summary = []
    for name, of_point in rows.to_pandas().groupby(["k", "tau_m", "delta_m", "t"], sort=False):
        for metric in DATASET_SCORES:
            values = of_point[metric].to_numpy(dtype=np.float64)
            mean, std = mean_and_std(values)
            summary.append(
                dict(zip(("k", "tau_m", "delta_m", "t"), name, strict=True))
                | {"metric": metric, "n_pairs": int(np.count_nonzero(~np.isnan(values))), "mean": mean, "std": std}
            )
    key = key_of(sorted(record.key for record in records))
    path = sweep.out / f"{SUMMARY}.parquet"
    stored = sweep.store.write_at(path, SUMMARY, ABLATE_SUMMARY.from_rows(summary), key)
    sweep.store.take(JobRecord(SUMMARY, "", "", key, {path.name: stored}))
    sweep.store.compact()
    return rows
