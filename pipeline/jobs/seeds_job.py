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
from ...stages.summary import mean_and_std
from ..stage import OF_PAIR, Grain, Inputs, JobResult, Metadata, Stage
from ..storage.table_files import JobRecord
from . import communities_job
from .points_job import ANNOTATED_COLUMNS, EDGE_COLUMNS
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
    return JobResult({"seeds": inputs.rows("seeds", rows)}, {"scores": by_score})


def summarise_seeds(records: Iterable[JobRecord], settings: Settings) -> dict[str, Any]:
    """Spread of each score over seeds and over pairs; mean and standard deviation of each pair over seeds."""
    of_pairs = {record.pair_id: record.metadata["scores"] for record in records}
    dataset = {}
    pairs: dict[str, Any] = {pair_id: {} for pair_id in sorted(of_pairs)}
    for name in SEEDED_SCORES:
        values = {
            pair_id: np.array(scores[name], dtype=np.float64)
            for pair_id, scores in of_pairs.items()
        }
        dataset[name] = vars(spread(np.array(list(values.values()))))
        for pair_id, of_seeds in values.items():
            mean, std = mean_and_std(of_seeds)
            pairs[pair_id][name] = {"mean": mean, "std": std}
    counts = {"n_seeds": settings.stability.seeds, "n_pairs": len(of_pairs)}
    return {"seeds": counts | {"dataset": dataset, "pairs": pairs}}


def _is_wanted(settings: Settings) -> bool:
    return settings.stability.seeds > 1


STAGE = Stage(
    name="seeds",
    takes={"ground": ANNOTATED_COLUMNS, "graph": EDGE_COLUMNS, "metrics": ()},
    gives=("seeds",),
    settings=("communities", "matching", "pieces", "selection", "stability"),
    grain=Grain.PAIR,
    version=2,
    make=make_seeds,
    libraries=(*communities_job.STAGE.libraries, "POT"),
    is_wanted=_is_wanted,
    summarise=summarise_seeds,
)
