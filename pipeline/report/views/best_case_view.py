"""Scores over a best case."""

from __future__ import annotations

from ....schemas.metric_catalogue import metric_of, pair_columns_in
from ...results.best_case import RunExcess
from ..view import Note, Table, View, count, first_of, signed, warnings

_EXCESS_NOTE = (
    "Best case: what a perfect simulator scores, a second measurement of each real scan. Excess: "
    "score minus best case of the same pair, mean and standard deviation over pairs. Bias and "
    "area: double validation metric of both distributions, over matched objects where a score has "
    "them, else over pairs; the shift of the values, and what is left between the distributions "
    "without it."
)
_MOST_NAMES = 5


def excess_view(excess: RunExcess) -> View:
    """The scores of a run over its best case: means of both, excess, bias and area."""
    rows = []
    for column in pair_columns_in("excess"):
        score = excess.scores[column]
        if not score["n_pairs"]:  # no pair has it in both runs
            continue
        means = (score["mean"], score["best_case"], signed(score["excess"]), score["std"])
        distance = (signed(score["bias"]), score["area"])
        rows.append((metric_of(column).label, *means, *distance))
    headings = ("score", "mean", "best case", "excess", "± std", "bias", "area")
    n_pairs = count(len(excess.pairs), "pair")
    title = (
        f"{excess.run} over the best case {excess.best_case} ({excess.recipe.words}): {n_pairs}"
    )
    return [
        Table(title, headings, rows),
        Note(_EXCESS_NOTE),
        *warnings(excess_notes(excess)),
    ]


def excess_notes(excess: RunExcess) -> list[str]:
    """Differences of code and pairs that a reader must know."""
    notes = [f"other code or libraries: {text}" for text in excess.notes]
    n_left_out = len(excess.left_out)
    if n_left_out:
        named = ", ".join(first_of(excess.left_out, _MOST_NAMES, "..."))
        notes.append(
            f"{n_left_out} pairs are not in the best case {excess.best_case} and left out: {named}"
        )
    return notes
