"""View of a diagnosis: causes with their gains, and what remains unexplained."""

from __future__ import annotations

from ...schemas.columns import Row
from ...schemas.results import Diagnosis
from ..report.view import Answers, Note, View, count, items_of
from ..report.views.answer_view import cause_items
from ..results.causes import no_cause_words
from ..results.diagnosis import doubtful_words, unexplained_words

_COLUMNS = (
    *("name", "words", "estimate", "low", "high", "unit"),
    *("n_pairs", "gain_m", "gain", "setting"),
)


def diagnosis_rows(diagnosis: Diagnosis) -> list[Row]:
    """One row per cause, for programs."""
    return [{name: getattr(cause, name) for name in _COLUMNS} for cause in diagnosis.causes]


def diagnosis_view(diagnosis: Diagnosis) -> View:
    """The causes, those with the largest gain first, what they do not explain, and doubtful ones."""
    pairs = count(diagnosis.n_pairs, "pair")
    title = (
        f"{pairs}: the surfaces are {100 * diagnosis.distance_m:.1f} cm apart, in a second measurement "
        f"{100 * diagnosis.best_case_m:.1f} cm"
    )
    first = cause_items(diagnosis.causes) or items_of(no_cause_words(diagnosis.unknown))
    first.append((unexplained_words(diagnosis), "", ""))
    sections = [("Fix first", first)]
    if diagnosis.notes:
        sections.append(("Notes", [(note, "", "") for note in diagnosis.notes]))
    if doubtful := doubtful_words(diagnosis):
        sections.append(("Doubtful", [(doubtful, "", "")]))
    return [Note(title, "bold"), Answers(sections)]
