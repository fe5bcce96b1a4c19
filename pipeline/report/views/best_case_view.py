"""Scores over a best case."""

from __future__ import annotations

from collections.abc import Sequence

from ....schemas.metric_catalogue import SHIFT_COLUMNS, metric_of
from ...results.best_case import RunExcess, ScoreExcess
from ..view import Note, Table, View, signed

_EXCESS_NOTE = (
    "Best case: what a perfect simulator scores, a second measurement of each real scan. Excess: score minus best "
    "case of "
    "the same pair, mean and standard deviation over pairs. Bias and area: double validation metric of both "
    "distributions, over matched objects where a score has them, else over pairs; the shift of the values, and what is "
    "left between the distributions without it."
)
#: What the terminal shows; JSON and the page have all.
HEADLINES = (
    *("match_rate", "n_missing", "n_hallucinated", "cdc_mean", "r_lambda_mean", "r_gap_mean"),
    *("centroid_distance_m_mean", "alignment_rms_m_mean", "covered_real_0p3m", "covered_sim_0p3m"),
    *(*SHIFT_COLUMNS[:3], "roughness_bias_m", "roughness_area_m"),
)
_MOST_NAMES = 5


def excess_view(excess: RunExcess, columns: Sequence[str] = ()) -> View:
    """The scores of a run over its best case: means of both, excess, bias and area, and the number of values.

    Parameters
    ----------
    columns : of `pairs`; by default all that have a best case
    """
    rows = [
        (
            *(metric_of(own.column).label, own.mean, own.best_case, signed(own.excess), own.std),
            *(signed(own.bias), own.area, own.n, own.n_best_case),
        )
        for own in _known(excess, columns)
    ]
    n = len(excess.pairs)
    title = f"{excess.run} over the best case {excess.best_case} ({excess.recipe.words}): {n} pair{'s' * (n != 1)}"
    headings = ("score", "mean", "best case", "excess", "± std", "bias", "area", "values", "in best\ncase")
    return [Table(title, headings, rows), Note(_EXCESS_NOTE), *excess_notes(excess)]


def pair_excess_table(excess: RunExcess, pair_id: str) -> Table:
    """The headline scores of one pair over its best case."""
    rows = [
        (metric_of(own.column).label, own.mean, own.best_case, signed(own.excess)) for own in _known(excess, HEADLINES)
    ]
    title = f"Pair {pair_id} over the best case {excess.best_case} ({excess.recipe.words})"
    return Table(title, ("score", "score", "best case", "excess"), rows)


def both_excesses_table(base: RunExcess, other: RunExcess) -> Table:
    """The headline scores of two runs over one best case: the best case, and excess and area before and after."""
    rows = [
        (metric_of(own.column).label, own.best_case, signed(own.excess), signed(after.excess), own.area, after.area)
        for own in _known(base, HEADLINES)
        for after in [other.scores[own.column]]
    ]
    headings = ("score", "best case", "excess before", "after", "area before", "after")
    return Table(f"Over the best case {base.best_case} ({base.recipe.words})", headings, rows)


def excess_notes(excess: RunExcess) -> list[Note]:
    """Differences of code and pairs that a reader must know."""
    notes = [f"other code or libraries: {text}" for text in excess.notes]
    if excess.left_out:
        named = ", ".join(excess.left_out[:_MOST_NAMES]) + " ..." * (len(excess.left_out) > _MOST_NAMES)
        notes.append(f"{len(excess.left_out)} pairs are not in the best case {excess.best_case} and left out: {named}")
    return [Note(f"note: {text}", "yellow") for text in notes]


def _known(excess: RunExcess, columns: Sequence[str]) -> list[ScoreExcess]:
    """The scores that some pair has in both runs; of these columns, or all."""
    return [own for column in columns or excess.scores if (own := excess.scores[column]).n_pairs]
