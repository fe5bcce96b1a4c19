"""Stage seeds, an extra: a pair repeated under other seeds of the communities, and a summary of the repeats.

Ground and graph have no seed and are shared; communities, matching, selection and scores are
recomputed in memory, and only the scores are kept.
"""

from __future__ import annotations

from collections.abc import Iterable
from itertools import product
from typing import Any

import numpy as np

from ...schemas.columns import SIDES
from ...schemas.metric_catalogue import SEEDED_SCORES
from ...schemas.settings import Settings
from ...stages.statistics.spread import spread
from ..stage import OF_PAIR, Inputs, JobResult, Metadata, Stage
from ..storage.table_files import JobRecord
from . import communities_job
from .scoring import score_pair


def make_seeds(inputs: Inputs) -> JobResult:
    """Score the pair under each seed: the configured one, whose tables exist, and those that follow it."""
    first = inputs.settings.communities.seed
    scores = {first: inputs.metadata("metrics")[OF_PAIR]}
    tables = {name: inputs.table(*name) for name in product(("ground", "graph"), SIDES)}
    for seed in range(first + 1, first + inputs.settings.stability.seeds):
        communities = inputs.settings.communities.model_copy(update={"seed": seed})
        settings = Settings(**(vars(inputs.settings) | {"communities": communities}))
        with inputs.step("scores"):
            scores[seed] = score_pair(settings, tables)
    rows = []
    for seed, row in scores.items():
        rows.append({"seed": seed} | {name: row[name] for name in SEEDED_SCORES})
    by_score: Metadata = {}
    for name in SEEDED_SCORES:
        by_score[name] = [row[name] for row in rows]
    return JobResult(inputs.rows("seeds", rows), {"scores": by_score})


def summarise_seeds(records: Iterable[JobRecord], settings: Settings) -> dict[str, Any]:
    """Spread of each score over seeds and over pairs."""
    pairs = [record.metadata["scores"] for record in records]
    dataset = {}
    for name in SEEDED_SCORES:
        values = np.array([scores[name] for scores in pairs], dtype=np.float64)
        dataset[name] = vars(spread(values))
    counts = {"n_seeds": settings.stability.seeds, "n_pairs": len(pairs)}
    return {"seeds": counts | {"dataset": dataset}}


STAGE = Stage(
    name="seeds",
    takes=("ground", "graph", "metrics"),
    gives=("seeds",),
    settings=("communities", "matching", "pieces", "selection", "stability"),
    version=2,
    make=make_seeds,
    libraries=(*communities_job.STAGE.libraries, "POT"),
    is_wanted=lambda settings: settings.stability.seeds > 1,
    summarise=summarise_seeds,
)
