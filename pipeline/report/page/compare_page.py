"""A comparison of runs as one page with its tables; nothing is fetched from the network."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any
from urllib.parse import quote

from ....schemas.columns import Row
from ...results.compare import Comparison
from ...results.families import MARKS_NOTE
from ...results.finished import FinishedRun
from ...results.followed import worst_changes
from ...storage.table_files import file_stem
from ...terminal import STEERING
from ..charts import change_chart
from ..look import PAGE_COLOURS
from ..pictures import draw_change, object_address
from ..view import Table, signed
from ..views.best_case_view import both_excesses_table
from ..views.compare_view import (
    OBJECTS_NOTE,
    cause_table,
    chance,
    changed,
    decision,
    family_table,
    object_table,
    object_view,
    remarks,
    score_table,
)
from .page_templates import render
from .run_page import PAGE, PAGES

MOST_OBJECTS, MOST_PAIRS = 300, 200
#: Verdicts that decide.
DECIDED = ("worse", "mixed", "better")


def compare_page(comparisons: Sequence[Comparison], start: Path = Path()) -> str:
    """The whole page; every name is escaped.

    Parameters
    ----------
    start : folder that the page is for, which its links to the runs' reports begin at

    Raises
    ------
    RunError
        A table that pictures are drawn from is damaged or gone.
    """
    method = (
        "Changes are after minus before, means over independent pairs. Intervals: 95 %, each of its score alone "
        "(Student's t). Verdicts: exact sign-flip test per family (maxT over its scores), Holm over the families. "
        f"{OBJECTS_NOTE}"
    )
    sections = [_section(one, start) for one in comparisons]
    data = {
        "charts": {
            f"{kind}_{i}": change_chart(scores)
            for i, section in enumerate(sections)
            for kind, scores in (("changes", section["decided"]), ("undecided", section["open"]))
            if scores
        },
        "steering": STEERING,
        "colours": PAGE_COLOURS,
        "places": [[draw_change(one, section["runs"]) for one in section["worst"]] for section in sections],
    }
    return render(
        "compare.html",
        data,
        sections=sections,
        method=method,
        arrows=MARKS_NOTE,
    )


def _section(comparison: Comparison, start: Path) -> dict[str, Any]:
    """One run against the base: `comparison` itself, its tables, its worst changes, and links."""
    objects = changed(comparison)
    by_effect = sorted(comparison.scores, key=lambda score: (score.verdict not in DECIDED, -abs(score.clarity)))
    families = {
        is_decided: [family for family in comparison.families if (family.verdict in DECIDED) == is_decided]
        for is_decided in (True, False)
    }
    n_decided = sum(score.verdict in DECIDED for score in by_effect)
    leading = [family.scores[0] for family in comparison.families]
    pairs = comparison.pairs[:MOST_PAIRS]
    runs = [FinishedRun(folder) for folder in (comparison.base, comparison.other)]
    links = [[_report_link(run.folder, one, start) for run in runs] for one in objects[:MOST_OBJECTS]]
    first = f" (the first {MOST_OBJECTS} of {len(objects)})" if len(objects) > MOST_OBJECTS else ""
    pairs_title = (
        f"Pairs (the first {MOST_PAIRS} of {len(comparison.pairs)})" if len(comparison.pairs) > MOST_PAIRS else "Pairs"
    )
    return {
        "comparison": comparison,
        "decision": decision(comparison),
        "chance": chance(comparison),
        "decided": by_effect[:n_decided],
        "open": by_effect[n_decided:],
        "families": [
            replace(family_table(comparison, families[True]), title="Decided, the clearest change first"),
            score_table(comparison, by_effect[:n_decided]),
        ],
        "undecided": [family_table(comparison, families[False]), score_table(comparison, by_effect[n_decided:])],
        "n_decided": (len(families[True]), len(families[False])),
        "causes": [cause_table(comparison)] if comparison.changes.causes else [],
        "remarks": remarks(comparison),
        "runs": runs,
        "worst": worst_changes(comparison.objects),
        "without_report": [
            run.folder for run, own in zip(runs, zip(*links, strict=True), strict=False) if not any(own)
        ],
        "more": [
            *([both_excesses_table(*comparison.excess)] if comparison.excess else ()),
            *object_view(comparison),
        ],
        "objects": object_table(f"Objects that have changed{first}", objects[:MOST_OBJECTS]),
        "links": links,
        "pairs": Table(
            pairs_title,
            ("pair (change)", *(score.name for score in leading)),
            [(name, *(signed(score.of_pairs[name]) for score in leading)) for name in pairs],
        ),
    }


def _report_link(run: Path, change: Row, start: Path) -> str:
    """The address of an object in its run's report, relative to a folder; "" if the run has no report."""
    pages = (run / PAGE, run / PAGES / f"pair-{file_stem(change['pair_id'])}.html")
    page = next((page for page in pages if page.exists()), None)
    if page is None:
        return ""
    address = object_address(change["pair_id"], f"real {change['real_id']}")
    return f"{quote(os.path.relpath(page.resolve(), start.resolve()))}{address}"
