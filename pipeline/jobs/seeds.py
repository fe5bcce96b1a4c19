"""The job that repeats a pair under other seeds of the communities, and what the repeats of all pairs say together.

An extra of the pipeline: made only where `stability.seeds` is above 1. Ground and graph have no seed and are shared;
communities, matching, selection and metrics are made again in memory, only the scores are kept. Leaves to others: what
a spread is (`stages.spread`), how it is shown (`report.seeds_view`).
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np

from ...schemas.metrics import SEEDED_SCORES
from ...schemas.settings import Settings
from ...schemas.tables import SEEDS
from ...stages.statistics.spread import spread
from ...stages.summary import mean_and_std
from ..engine.task import Facts, Tables
from ..engine.workbench import Workbench
from ..storage.ledger import JobRecord

STAGE = "seeds"
_SHARED = ("ground", "graph")
_REPEATED = ("communities", "matching", "selection", "metrics")


def make_seeds(bench: Workbench, side: str) -> tuple[Tables, Facts]:
    """The scores of the pair under each seed: the set one, whose tables are there, and those that follow it."""
    first = bench.settings.communities.seed
    scores = {first: bench.facts("metrics")["row"]}
    for seed in range(first + 1, first + bench.settings.stability.seeds):
        scores[seed] = _repeat(bench, seed)
    rows = [
        {"pair_id": bench.pair_id, "seed": seed} | {name: row[name] for name in SEEDED_SCORES}
        for seed, row in scores.items()
    ]
    facts = {
        "made_from": bench.job("metrics").key,
        "scores": {name: [row[name] for row in rows] for name in SEEDED_SCORES},
    }
    return {"seeds": SEEDS.from_rows(rows)}, facts


def summarise_seeds(records: Iterable[JobRecord], settings: Settings) -> dict[str, Any]:
    """Of each score: spread over seeds and over pairs; and of each pair, mean and standard deviation over seeds."""
    own = {record.pair_id: _as_floats(record.facts["scores"]) for record in records}
    dataset = {name: vars(spread(np.array([scores[name] for scores in own.values()]))) for name in SEEDED_SCORES}
    pairs = {
        pair_id: {name: dict(zip(("mean", "std"), mean_and_std(of), strict=True)) for name, of in scores.items()}
        for pair_id, scores in sorted(own.items())
    }
    return {"n_seeds": settings.stability.seeds, "n_pairs": len(own), "dataset": dataset, "pairs": pairs}


def _repeat(bench: Workbench, seed: int) -> Facts:
    """The row that `pairs` would have for this pair under another seed."""
    communities = bench.settings.communities.model_copy(update={"seed": seed})
    other = bench.under(bench.settings.model_copy(update={"communities": communities}), _SHARED)
    for job in bench.task.jobs:
        if job.stage in _REPEATED:
            with bench.step(job.stage):
                other.finish(job, *job.make(other, job.side))
    row: Facts = other.facts("metrics")["row"]
    return row


def _as_floats(scores: dict[str, list[Any]]) -> dict[str, Any]:
    return {name: np.array([np.nan if v is None else v for v in of], dtype=np.float64) for name, of in scores.items()}
