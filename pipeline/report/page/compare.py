"""A comparison of runs, or their history, as one page: what its tables hold; nothing is fetched from the network."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from ...results.compare import Comparison
from ...results.families import MARKS_NOTE
from ...results.finished import FinishedRun
from ...results.followed import worst_changes
from ...results.history import History
from ..camera import FRAME
from ..charts import change_chart, history_chart
from ..terminal.compare import (
    GROUPS_NOTE,
    OBJECTS_NOTE,
    cause_table,
    chance,
    changed,
    class_heading,
    decision,
    family_table,
    group_table,
    kind_table,
    object_table,
    remarks,
    score_table,
)
from ..terminal.floor import both_excesses_table
from ..terminal.history import arrowed, history_decision, history_remarks
from ..terminal.layout import number, shortened, signed
from .pictures import draw_change, report_link
from .render import render

MOST_OBJECTS, MOST_PAIRS = 300, 200


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
    charts = {f"changes_{i}": change_chart(one.scores) for i, one in enumerate(comparisons)}
    return render(
        "compare.html",
        {"charts": charts},
        sections=[_section(one, start) for one in comparisons],
        method=method,
        arrows=MARKS_NOTE,
        groups_note=GROUPS_NOTE,
        frame=FRAME,
    )


def history_page(history: History) -> str:
    """The page of runs in a row: the decision, the runs, their scores, and a line for each score."""
    folders = [str(run.folder) for run in history.runs]
    names, narrow = (
        [short[folder] for folder in folders] for short in (shortened(folders, 24), shortened(folders, 14))
    )
    rows: list[list[Any]] = [["score", *(f"{i}: {name}" for i, name in enumerate(narrow, start=1))]]
    for score in history.families:
        cells = [(number(step.mean), step.since_first, step.since_last) for step in score.steps]
        cells[1] = (*cells[1][:2], "")  # the first run is the one before
        rows.append([arrowed(score), *cells])
    runs = [["run", "folder", "made (UTC)", "scored pairs", "failed pairs"]]
    for i, run in enumerate(history.runs, start=1):
        runs.append([str(i), str(run.folder), run.written[:16].replace("T", " "), str(run.n_scored), str(run.n_failed)])
    return render(
        "history.html",
        {"charts": {f"history_{i}": history_chart(score, names) for i, score in enumerate(history.families)}},
        decision=history_decision(history),
        remarks=history_remarks(history),
        runs=runs,
        scores=rows,
        names=[arrowed(score) for score in history.families],
        n_pairs=len(history.pairs),
        arrows=MARKS_NOTE,
    )


def _section(comparison: Comparison, start: Path) -> dict[str, Any]:
    """What the page says of one run against the base: `comparison` itself, and tables as headings and rows of texts."""
    objects = changed(comparison)
    leading = [family.scores[0] for family in comparison.families]
    pairs = comparison.pairs[:MOST_PAIRS]
    changes = [[name, *(signed(score.of_pairs[name]) for score in leading)] for name in pairs]
    runs = [FinishedRun(folder) for folder in (comparison.base, comparison.other)]
    links = [[report_link(run.folder, one, start) for run in runs] for one in objects[:MOST_OBJECTS]]
    return {
        "comparison": comparison,
        "decision": decision(comparison),
        "chance": chance(comparison),
        "families": family_table(comparison),
        "causes": cause_table(comparison),
        "remarks": remarks(comparison),
        "scores": score_table(comparison),
        "excess": both_excesses_table(*comparison.excess) if comparison.excess else [],
        "pictures": [draw_change(one, runs[0], runs[1], start) for one in worst_changes(comparison.objects)],
        "without_report": [
            run.folder for run, own in zip(runs, zip(*links, strict=True), strict=False) if not any(own)
        ],
        "kinds": kind_table(comparison),
        "groups": [
            (what, group_table(what, own))
            for what, own in ((class_heading(comparison), comparison.by_class), ("range", comparison.by_range))
            if own
        ],
        "n_objects": len(objects),
        "objects": object_table(objects[:MOST_OBJECTS]),
        "links": links,
        "pairs": [["pair (change)", *(score.name for score in leading)], *changes],
    }
