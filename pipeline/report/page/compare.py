"""A comparison of runs as one page: what its tables hold; nothing is fetched from the network."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from ....schemas.metrics import labels
from ....stages.statistics.comparison import BLOCK_S, CONFIDENCE
from ...results.compare import Comparison
from ..charts import change_chart
from ..terminal.compare import OBJECTS_NOTE, changed, kind_table, object_table, remarks, score_table, verdict
from ..terminal.floor import both_excesses_table
from ..terminal.layout import signed
from .render import render

MOST_OBJECTS, MOST_PAIRS = 300, 200
_PAIR_SCORES = labels(("match_rate", "cdc", "r_lambda", "r_gap", "n_missing"))


def compare_page(comparisons: Sequence[Comparison]) -> str:
    """The whole page; every name is escaped."""
    method = (
        f"Differences are after less before, means over pairs; copies of a real scan, and scans within {BLOCK_S:g} s "
        f"of each other, count as one pair. Intervals: {100 * CONFIDENCE:.0f} %, each of its score alone (paired t, "
        f"skew allowed for). Verdicts: p below {1 - CONFIDENCE:.2f} over all scores together (Holm), and more than "
        f"seeds make, where that is known. {OBJECTS_NOTE}"
    )
    charts = {f"changes_{i}": change_chart(one.scores) for i, one in enumerate(comparisons)}
    return render("compare.html", {"charts": charts}, sections=[_section(one) for one in comparisons], method=method)


def _section(comparison: Comparison) -> dict[str, Any]:
    """What the page says of one run against the base: `comparison` itself, and tables as headings and rows of texts."""
    objects = changed(comparison)
    by_name = {score.name: score.of_pairs for score in comparison.scores}
    pairs = sorted(comparison.pairs, key=lambda name: -(by_name["r_lambda"][name] or 0.0))[:MOST_PAIRS]
    changes = [[name, *(signed(by_name[score][name]) for score in _PAIR_SCORES)] for name in pairs]
    return {
        "comparison": comparison,
        "verdict": verdict(comparison),
        "remarks": remarks(comparison),
        "scores": score_table(comparison),
        "excess": both_excesses_table(*comparison.excess) if comparison.excess else [],
        "kinds": kind_table(comparison),
        "n_objects": len(objects),
        "objects": object_table(objects[:MOST_OBJECTS]),
        "pairs": [["pair (change)", *_PAIR_SCORES], *changes],
    }
