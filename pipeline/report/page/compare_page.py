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

MOST_OBJECTS = 300
MOST_PAIRS = 200
#: Verdicts that decide.
DECIDED = ("worse", "mixed", "better")
_METHOD = (
    "Changes are after minus before, means over independent pairs. Intervals: 95 %, each of its "
    "score alone (Student's t). Verdicts: exact sign-flip test per family (maxT over its scores), "
    f"Holm over the families. {OBJECTS_NOTE}"
)


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
    sections = [_section(comparison, start) for comparison in comparisons]
    charts = {}
    places = []
    for i, section in enumerate(sections):
        if section["decided"]:
            charts[f"changes_{i}"] = change_chart(section["decided"])
        if section["open"]:
            charts[f"undecided_{i}"] = change_chart(section["open"])
        places.append([draw_change(change, section["runs"]) for change in section["worst"]])
    data = {
        "charts": charts,
        "steering": STEERING,
        "colours": PAGE_COLOURS,
        "places": places,
    }
    return render("compare.html", data, sections=sections, method=_METHOD, arrows=MARKS_NOTE)


def _section(comparison: Comparison, start: Path) -> dict[str, Any]:
    """One run against the base: `comparison` itself, its tables, its worst changes, and links."""
    objects = changed(comparison)
    decided = [score for score in comparison.scores if score.verdict in DECIDED]
    undecided = [score for score in comparison.scores if score.verdict not in DECIDED]
    for scores in (decided, undecided):
        scores.sort(key=lambda score: -abs(score.clarity))
    families = [family for family in comparison.families if family.verdict in DECIDED]
    open_families = [family for family in comparison.families if family.verdict not in DECIDED]
    runs = [FinishedRun(folder) for folder in (comparison.base, comparison.other)]
    links = []
    for change in objects[:MOST_OBJECTS]:
        links.append([_report_link(run.folder, change, start) for run in runs])
    without_report = []
    for place, run in enumerate(runs):
        if links and not any(of_object[place] for of_object in links):
            without_report.append(run.folder)
    objects_title = "Objects that have changed"
    if len(objects) > MOST_OBJECTS:
        objects_title += f" (the first {MOST_OBJECTS} of {len(objects)})"
    more = list(object_view(comparison))
    if comparison.excess:
        more.insert(0, both_excesses_table(*comparison.excess))
    family_title = "Decided, the clearest change first"
    return {
        "comparison": comparison,
        "decision": decision(comparison),
        "chance": chance(comparison),
        "decided": decided,
        "open": undecided,
        "families": [
            replace(family_table(comparison, families), title=family_title),
            score_table(comparison, decided),
        ],
        "undecided": [
            family_table(comparison, open_families),
            score_table(comparison, undecided),
        ],
        "n_decided": (len(families), len(open_families)),
        "causes": [cause_table(comparison)] if comparison.changes.causes else [],
        "remarks": remarks(comparison),
        "runs": runs,
        "worst": worst_changes(comparison.objects),
        "without_report": without_report,
        "more": more,
        "objects": object_table(objects_title, objects[:MOST_OBJECTS]),
        "links": links,
        "pairs": _pairs_table(comparison),
    }


def _pairs_table(comparison: Comparison) -> Table:
    """Change of the clearest score of each family by pair."""
    leading = [family.scores[0] for family in comparison.families]
    title = "Pairs"
    if len(comparison.pairs) > MOST_PAIRS:
        title += f" (the first {MOST_PAIRS} of {len(comparison.pairs)})"
    headings = ("pair (change)", *(score.name for score in leading))
    rows = []
    for name in comparison.pairs[:MOST_PAIRS]:
        rows.append((name, *(signed(score.of_pairs[name]) for score in leading)))
    return Table(title, headings, rows)


def _report_link(run: Path, change: Row, start: Path) -> str:
    """The address of an object in its run's report, relative to a folder; "" without a report."""
    pages = (run / PAGE, run / PAGES / f"pair-{file_stem(change['pair_id'])}.html")
    page = next((page for page in pages if page.exists()), None)
    if page is None:
        return ""
    address = object_address(change["pair_id"], f"real {change['real_id']}")
    return f"{quote(os.path.relpath(page.resolve(), start.resolve()))}{address}"
