"""The job of the baselines of a pair, and what they say of all pairs together.

An extra of the pipeline: made only where `metrics.baselines` names some. Leaves to others: the baselines themselves
(`stages.baselines`), how they are shown (`report.baselines`).
"""

from __future__ import annotations

from collections.abc import Iterable
from contextlib import AbstractContextManager
from typing import Any

import numpy as np

from ...schemas.columns import SIDES
from ...schemas.metrics import BASELINE_NAMES
from ...schemas.settings import Settings
from ...schemas.tables import BASELINES
from ...stages.baselines import Baseline, compare_objects, compare_points
from ...stages.baselines.icp import can_register
from ...stages.summary import mean_and_std
from ..engine.task import Facts, Tables
from ..engine.workbench import Workbench
from ..storage.ledger import JobRecord
from .core import chosen_nodes

STAGE = "baselines"
OF_OBJECTS, OF_SCAN = "objects", "scans"


def libraries(settings: Settings) -> tuple[str, ...]:
    """What the wanted baselines call; ICP's library is an extra, and without it ICP is null."""
    wants_icp = "icp" in settings.metrics.baselines
    return ("POT", "small_gicp") if wants_icp and can_register() else ("POT",)


def make_baselines(bench: Workbench, side: str) -> tuple[Tables, Facts]:
    """The wanted baselines of each matched object, and of all object points of the two scans."""
    settings = bench.settings
    rows: list[Facts] = []
    selection = bench.table("selection")
    for match in bench.matched().to_pylist():
        real, sim = bench.subgraph("real", match["real_id"]), bench.subgraph("sim", match["sim_id"])
        chosen = chosen_nodes(selection, match["real_id"], real, sim)
        found = compare_objects(real, sim, chosen, settings.selection.t, settings.metrics, watch=bench.watch)
        rows += [_row(bench, of, match["real_id"], match["sim_id"]) for of in found]

    def watch(name: str) -> AbstractContextManager[None]:
        return bench.step(_step(name, OF_SCAN))

    real_points, sim_points = (bench.object_points(of)[1] for of in SIDES)
    of_scan = compare_points(real_points, sim_points, settings.metrics, watch=watch)
    rows += [_row(bench, of, None, None) for of in of_scan]
    facts = {"made_from": bench.job("selection").key, "means": _means(rows)}
    return {"baselines": BASELINES.from_rows(rows)}, facts


def summarise_baselines(records: Iterable[JobRecord], settings: Settings) -> list[dict[str, Any]]:
    """Of each baseline and level (objects or scan): mean and standard deviation (n - 1) over pairs, seconds a pair.

    The value of a pair is the mean over its matched objects, or that of the whole scan. `seconds` is the time of the
    method, which may give several baselines: it stands with the first of them.
    """
    own = list(records)
    summary = []
    for level in (OF_OBJECTS, OF_SCAN):
        for method in settings.metrics.baselines:
            seconds = [dict(record.steps).get(_step(method, level)) for record in own]
            timed = [s for s in seconds if s is not None]
            names = {
                of["baseline"]: of["unit"]
                for record in own
                for of in record.facts["means"]
                if of["level"] == level and _method(of["baseline"]) == method
            }
            for i, (name, unit) in enumerate(names.items()):
                pairs = [
                    of
                    for record in own
                    for of in record.facts["means"]
                    if (of["level"], of["baseline"]) == (level, name)
                ]
                values = [np.nan if of["mean"] is None else of["mean"] for of in pairs]
                mean, std = mean_and_std(np.array(values, dtype=np.float64))
                summary.append(
                    {
                        "baseline": name,
                        "level": level,
                        "unit": unit,
                        "mean": mean,
                        "std": std,
                        "n": sum(of["n"] for of in pairs),
                        "n_null": sum(of["n_null"] for of in pairs),
                        "seconds": sum(timed) / len(timed) if timed and i == 0 else None,
                    }
                )
    return summary


def _row(bench: Workbench, of: Baseline, real_id: int | None, sim_id: int | None) -> Facts:
    return {
        "pair_id": bench.pair_id,
        "real_id": real_id,
        "sim_id": sim_id,
        "baseline": of.name,
        "value": of.value,
        "unit": of.unit,
        "reason": of.reason,
    }


def _means(rows: list[Facts]) -> list[Facts]:
    """The pair's mean of each baseline over objects, and its value of the whole scan."""
    groups: dict[tuple[str, str], list[Facts]] = {}
    for row in rows:
        level = OF_SCAN if row["real_id"] is None else OF_OBJECTS
        groups.setdefault((level, row["baseline"]), []).append(row)
    means = []
    for (level, name), own in groups.items():
        known = [row["value"] for row in own if row["value"] is not None]
        means.append(
            {
                "level": level,
                "baseline": name,
                "unit": own[0]["unit"],
                "mean": sum(known) / len(known) if known else None,
                "n": len(known),
                "n_null": len(own) - len(known),
            }
        )
    return means


def _step(method: str, level: str) -> str:
    """What the step is called in `timings`."""
    return method if level == OF_OBJECTS else f"{method}, whole scan"


def _method(baseline: str) -> str:
    """Which method gives a baseline: the one that its name begins with."""
    return next(name for name in BASELINE_NAMES if baseline.startswith(name))
