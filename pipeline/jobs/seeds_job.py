"""Stage seeds, an extra: a pair repeated under other seeds of the communities, and a summary of the repeats.

Ground and graph have no seed and are shared; communities, matching, selection and scores are recomputed in
memory, and only the scores are kept.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np

from ...schemas.columns import SIDES
from ...schemas.metric_catalogue import SEEDED_SCORES
from ...schemas.settings import Settings
from ...schemas.tables import TABLES
from ...stages.method import PartitionedScan, compare, n_communities, partition
from ...stages.statistics.spread import spread
from ...stages.summary import mean_and_std
from ..stage import OF_PAIR, Grain, Inputs, JobResult, Metadata, Stage
from ..storage.table_files import JobRecord
from . import communities_job
from .points_job import ANNOTATED_COLUMNS, EDGE_COLUMNS, annotation, graph_edges, object_points


def make_seeds(own: Inputs) -> JobResult:
    """Score the pair under each seed: the configured one, whose tables exist, and those that follow it."""
    first = own.settings.communities.seed
    scores = {first: own.metadata("metrics")[OF_PAIR]}
    for seed in range(first + 1, first + own.settings.stability.seeds):
        scores[seed] = _repeat(own, seed)
    rows = [
        {"pair_id": own.pair_id, "seed": seed} | {name: row[name] for name in SEEDED_SCORES}
        for seed, row in scores.items()
    ]
    by_score = {name: [row[name] for row in rows] for name in SEEDED_SCORES}
    return JobResult({"seeds": TABLES["seeds"].from_rows(rows)}, {"scores": by_score})


def summarise_seeds(records: Iterable[JobRecord], settings: Settings) -> dict[str, Any]:
    """Spread of each score over seeds and over pairs; mean and standard deviation of each pair over seeds."""
    repeats = {
        record.pair_id: {name: np.array(own, dtype=np.float64) for name, own in record.metadata["scores"].items()}
        for record in records
    }
    dataset = {name: vars(spread(np.array([scores[name] for scores in repeats.values()]))) for name in SEEDED_SCORES}
    pairs = {
        pair_id: {name: dict(zip(("mean", "std"), mean_and_std(own), strict=True)) for name, own in scores.items()}
        for pair_id, scores in sorted(repeats.items())
    }
    n_seeds, n_pairs = settings.stability.seeds, len(repeats)
    return {"seeds": {"n_seeds": n_seeds, "n_pairs": n_pairs, "dataset": dataset, "pairs": pairs}}


def _repeat(own: Inputs, seed: int) -> Metadata:
    """The scores of the pair under another seed."""
    declared = own.settings
    settings = Settings(
        communities=declared.communities.model_copy(update={"seed": seed}),
        matching=declared.matching,
        pieces=declared.pieces,
        selection=declared.selection,
    )
    scans: dict[str, PartitionedScan] = {}
    for side in SIDES:
        _, points = object_points(own, side)
        edges = graph_edges(own, side)
        real = scans["real"].reference if side == "sim" else None
        with own.step("communities"):
            scans[side] = partition(points, settings, edges=edges, reference=real, annotation=annotation(own, side))
    with own.step("scores"):
        summary = compare(scans["real"], scans["sim"], settings).summary
    return n_communities(summary) | summary


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
