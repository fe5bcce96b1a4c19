"""Scores over a floor in the terminal; the cells of its tables are the same on the pages."""

from __future__ import annotations

from collections.abc import Sequence

from rich.console import Group, RenderableType
from rich.text import Text

from ....schemas.metrics import SHIFT_COLUMNS, metric_of
from ...results.floor import RunExcess, ScoreExcess
from .layout import number, plain_table, signed

EXCESS_NOTE = (
    "Floor: what a perfect simulator scores, a second measurement of each real scan. Excess: score less floor of "
    "the same pair, mean and standard deviation over pairs. Bias and area: double validation metric of both "
    "distributions, over matched objects where a score has them, else over pairs; the shift of the values, and what is "
    "left between the distributions without it."
)
#: What the terminal shows; JSON and the page have all.
_HEADLINES = (
    *("match_rate", "n_missing", "n_hallucinated", "cdc_mean", "r_lambda_mean", "r_gap_mean"),
    *("centroid_distance_m_mean", "alignment_rms_m_mean", "covered_real_0p3m", "covered_sim_0p3m"),
    *(*SHIFT_COLUMNS[:3], "roughness_bias_m", "roughness_area_m"),
)
_MOST_NAMES = 5


def excess_view(excess: RunExcess) -> RenderableType:
    """The headline scores of a run over its floor."""
    headings, *rows = excess_table(excess, _HEADLINES)
    notes = (Text(f"note: {text}", style="yellow") for text in excess_notes(excess))
    return Group(plain_table(excess_title(excess), headings, rows, words=(0,)), Text(EXCESS_NOTE), *notes)


def pair_excess_view(excess: RunExcess, pair_id: str) -> RenderableType:
    """The headline scores of one pair over its floor."""
    rows = [
        (metric_of(own.column).label, own.mean, own.floor, signed(own.excess)) for own in _known(excess, _HEADLINES)
    ]
    title = f"Pair {pair_id} over the floor {excess.floor} ({excess.recipe.words})"
    return plain_table(title, ("score", "score", "floor", "excess"), rows)


def excess_title(excess: RunExcess) -> str:
    """What is over which floor."""
    n = len(excess.pairs)
    return f"{excess.run} over the floor {excess.floor} ({excess.recipe.words}): {n} pair{'s' * (n != 1)}"


def excess_table(excess: RunExcess, columns: Sequence[str] = ()) -> list[list[str]]:
    """Headings, then one row per score: name, means of run and floor, excess, bias and area, and how many values.

    Parameters
    ----------
    columns : of `pairs`; by default all that have a floor
    """
    rows = [["score", "mean", "floor", "excess", "± std", "bias", "area", "values", "in floor"]]
    for own in _known(excess, columns):
        numbers = (number(own.mean), number(own.floor), signed(own.excess), number(own.std))
        apart = (signed(own.bias), number(own.area), f"{own.n} {own.of}", str(own.n_floor))
        rows.append([metric_of(own.column).label, *numbers, *apart])
    return rows


def both_excesses_table(base: RunExcess, other: RunExcess) -> list[list[str]]:
    """Headings, then one row per score: name, floor, excess and area of the base and of the other run."""
    rows = [["score", "floor", "excess before", "after", "area before", "after"]]
    for own in _known(base, _HEADLINES):
        after = other.scores[own.column]
        excesses = (signed(own.excess), signed(after.excess), number(own.area), number(after.area))
        rows.append([metric_of(own.column).label, number(own.floor), *excesses])
    return rows


def excess_notes(excess: RunExcess) -> list[str]:
    """What a reader must know beside the numbers."""
    notes = [f"other code or libraries: {text}" for text in excess.notes]
    if excess.left_out:
        named = ", ".join(excess.left_out[:_MOST_NAMES]) + " ..." * (len(excess.left_out) > _MOST_NAMES)
        notes.append(f"{len(excess.left_out)} pairs are not in the floor {excess.floor} and left out: {named}")
    return notes


def _known(excess: RunExcess, columns: Sequence[str]) -> list[ScoreExcess]:
    """The scores that some pair has in both runs; of these columns, or all."""
    return [own for column in columns or excess.scores if (own := excess.scores[column]).n_pairs]
