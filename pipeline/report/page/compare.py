"""A comparison of runs as one page: what its tables hold; nothing is fetched from the network."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from ....stages.statistics.comparison import CONFIDENCE, N_RESAMPLES, SEED
from ...results.compare import Comparison
from ..charts import change_chart
from ..terminal.compare import OBJECTS_NOTE, beyond_seeds, changed, has_seeds, remarks, signed, verdict
from ..terminal.layout import number, percent
from .render import render

MOST_OBJECTS, MOST_PAIRS = 300, 200
_PAIR_SCORES = ("match rate", "CDC", "r_lambda", "r_gap", "missing objects")


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
    """What the page says of one run against the base; rows of tables are texts, in the order of the headings."""
    objects = changed(comparison)
    columns = [next(score for score in comparison.scores if score.name == name) for name in _PAIR_SCORES]
    r_lambda = columns[_PAIR_SCORES.index("r_lambda")].of_pairs
    pairs = sorted(comparison.pairs, key=lambda name: -(r_lambda[name] or 0.0))
    return {
        "base": str(comparison.base),
        "other": str(comparison.other),
        "verdict": verdict(comparison),
        "n_pairs": len(comparison.pairs),
        "remarks": remarks(comparison),
        "with_seeds": has_seeds(comparison),
        "scores": [
            [
                *(score.name, score.verdict, number(score.difference.before), number(score.difference.after)),
                *map(signed, (score.difference.difference, score.difference.low, score.difference.high)),
                *([beyond_seeds(score)] if has_seeds(comparison) else []),
            ]
            for score in comparison.scores
        ],
        "kinds": [
            [kind, str(n), percent(n / len(comparison.objects))]
            for kind, n in comparison.kinds.items()
            if comparison.objects
        ],
        "n_objects": len(objects),
        "objects": [
            [
                *(one.pair_id, one.kind, one.label or "-", str(one.real_id), number(one.range_m, 1), str(one.n_points)),
                *map(number, (one.cdc_before, one.cdc_after, one.r_lambda_before, one.r_lambda_after)),
            ]
            for one in objects[:MOST_OBJECTS]
        ],
        "pair_scores": _PAIR_SCORES,
        "pairs": [[name, *(signed(score.of_pairs[name]) for score in columns)] for name in pairs[:MOST_PAIRS]],
    }
