"""Views of `fidpipe diagnose`: causes with their gains, what remains unexplained, and a tell-apart test."""

from __future__ import annotations

from typing import Any

from ...schemas.results import Diagnosis
from ..report.view import Answers, Note, Table, View, columns_of, count, items_of, number
from ..report.views.answer_view import cause_items
from ..results.causes import no_cause_words
from ..results.diagnosis import doubtful_words, unexplained_words


def diagnosis_view(diagnosis: Diagnosis) -> View:
    """The causes, those with the largest gain first, what they do not explain, and doubtful ones."""
    pairs = count(diagnosis.n_pairs, "pair")
    title = (
        f"{pairs}: the surfaces are {100 * diagnosis.distance_m:.1f} cm apart, in a second measurement "
        f"{100 * diagnosis.best_case_m:.1f} cm"
    )
    first = cause_items(diagnosis.causes) or items_of(no_cause_words(diagnosis.unknown))
    first.append((unexplained_words(diagnosis), "", ""))
    sections = {
        "Fix first": first,
        "Notes": items_of(*diagnosis.notes),
        "Doubtful": items_of(doubtful_words(diagnosis)),
    }
    return [Note(title, "bold"), Answers(sections)]


def tell_apart_view(title: str, values: dict[str, Any]) -> View:
    """The AUC next to that of real against real, and the AUC by each feature."""
    base = values["real_against_real"]
    tests = [("real against simulated", values)]
    tests += [(f"  by {family['name']} alone", family) for family in values["families"]]
    tests.append((f"real against real ({base['of']})", base))
    rows = [
        (name, test["auc"], f"{number(test['low'])} to {number(test['high'])}")
        for name, test in tests
    ]
    same = "not " if values["low"] <= base["high"] else ""
    return [
        Table(
            f"{title}: {values['n_points']:,} points per side, cross-validated over "
            f"{values['n_folds']} {values['folds']}",
            ("points", "AUC", "95 % interval"),
            rows,
            words=(0, 2),
        ),
        Table(
            "Recognised by",
            ("family", "feature", "AUC of it alone"),
            columns_of(values["features"], ("family", "name", "auc")),
            words=(0, 1),
        ),
        Note(f"{same}easier to distinguish than real points from real points", "bold"),
    ]
