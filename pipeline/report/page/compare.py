"""A comparison of runs as one page: what its tables hold; nothing is fetched from the network."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from ....schemas.metrics import labels
from ....stages.statistics.comparison import CONFIDENCE, N_RESAMPLES, SEED
from ...results.compare import Comparison
from ..charts import change_chart
from ..terminal.compare import (
    OBJECT_HEADINGS,
    OBJECTS_NOTE,
    SCORE_HEADINGS,
    SEEDS_HEADING,
    changed,
    kind_rows,
    object_cells,
    remarks,
    score_cells,
    seed_cells,
    signed,
    verdict,
)
from .render import render

MOST_OBJECTS, MOST_PAIRS = 300, 200
_PAIR_SCORES = labels(("match_rate", "cdc", "r_lambda", "r_gap", "n_missing"))


def compare_page(comparisons: Sequence[Comparison]) -> str:
    """The whole page; every name is escaped."""
    method = (
        f"Differences are after less before, means over pairs. Intervals: {100 * CONFIDENCE:.0f} %, paired bootstrap "
        f"over pairs (BCa, {N_RESAMPLES} resamples, seed {SEED}); each stands for itself, and one in twenty leaves out "
        f"0 by chance. {OBJECTS_NOTE}"
    )
    charts = {f"changes_{i}": change_chart(one.scores) for i, one in enumerate(comparisons)}
    return render("compare.html", {"charts": charts}, sections=[_section(one) for one in comparisons], method=method)


def _section(comparison: Comparison) -> dict[str, Any]:
    """What the page says of one run against the base: `comparison` itself, and tables as headings and rows of texts."""
    objects, seeds = changed(comparison), seed_cells(comparison)
    by_name = {score.name: score.of_pairs for score in comparison.scores}
    pairs = sorted(comparison.pairs, key=lambda name: -(by_name["r_lambda"][name] or 0.0))
    return {
        "comparison": comparison,
        "verdict": verdict(comparison),
        "remarks": remarks(comparison),
        "score_headings": ["score", "verdict", *SCORE_HEADINGS, *([SEEDS_HEADING] if seeds[0] else [])],
        "scores": [
            [score.name, score.verdict, *score_cells(score), *beyond]
            for score, beyond in zip(comparison.scores, seeds, strict=True)
        ],
        "kinds": kind_rows(comparison),
        "n_objects": len(objects),
        "object_headings": ["pair", "what", *OBJECT_HEADINGS],
        "objects": [[one.pair_id, one.kind, *object_cells(one)] for one in objects[:MOST_OBJECTS]],
        "pair_headings": ["pair (change)", *_PAIR_SCORES],
        "pairs": [[name, *(signed(by_name[score][name]) for score in _PAIR_SCORES)] for name in pairs[:MOST_PAIRS]],
    }
