"""A comparison of runs, or their history, as one page: what its tables hold; nothing is fetched from the network."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from ....schemas.metrics import labels
from ....stages.statistics.comparison import BLOCK_S, CONFIDENCE
from ...results.compare import Comparison
from ...results.finished import FinishedRun
from ...results.followed import worst_changes
from ...results.history import History
from ..camera import FRAME
from ..charts import change_chart, history_chart
from ..terminal.compare import (
    ARROWS_NOTE,
    GROUPS_NOTE,
    OBJECTS_NOTE,
    changed,
    class_heading,
    decision,
    group_table,
    kind_table,
    object_table,
    remarks,
    score_table,
    verdict,
)
from ..terminal.floor import both_excesses_table
from ..terminal.history import arrowed, history_decision, history_remarks
from ..terminal.layout import number, shortened, signed
from .pictures import draw_change, report_link
from .render import render

MOST_OBJECTS, MOST_PAIRS = 300, 200
_PAIR_SCORES = labels(("match_rate", "cdc", "r_lambda", "r_gap", "n_missing"))


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
        f"Differences are after less before, means over pairs; copies of a real scan, and scans within {BLOCK_S:g} s "
        f"of each other, count as one pair. Intervals: {100 * CONFIDENCE:.0f} %, each of its score alone (paired t, "
        f"skew allowed for). Verdicts: p below {1 - CONFIDENCE:.2f} over all scores together (Holm), and more than "
        f"seeds make, where that is known. {OBJECTS_NOTE}"
    )
    charts = {f"changes_{i}": change_chart(one.scores) for i, one in enumerate(comparisons)}
    return render(
        "compare.html",
        {"charts": charts},
        sections=[_section(one, start) for one in comparisons],
        method=method,
        arrows=ARROWS_NOTE,
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
    for score in history.scores:
        cells = [(number(step.mean), step.since_first, step.since_last) for step in score.steps]
        cells[1] = (*cells[1][:2], "")  # the first run is the one before
        rows.append([arrowed(score), *cells])
    runs = [["run", "folder", "made (UTC)", "scored pairs", "failed pairs"]]
    for i, run in enumerate(history.runs, start=1):
        runs.append([str(i), str(run.folder), run.written[:16].replace("T", " "), str(run.n_scored), str(run.n_failed)])
    return render(
        "history.html",
        {"charts": {f"history_{i}": history_chart(score, names) for i, score in enumerate(history.scores)}},
        decision=history_decision(history),
        remarks=history_remarks(history),
        runs=runs,
        scores=rows,
        names=[arrowed(score) for score in history.scores],
        n_pairs=len(history.pairs),
        arrows=ARROWS_NOTE,
    )


def _section(comparison: Comparison, start: Path) -> dict[str, Any]:
    """What the page says of one run against the base: `comparison` itself, and tables as headings and rows of texts."""
    objects = changed(comparison)
    by_name = {score.name: score.of_pairs for score in comparison.scores}
    pairs = sorted(comparison.pairs, key=lambda name: -(by_name["r_lambda"][name] or 0.0))[:MOST_PAIRS]
    changes = [[name, *(signed(by_name[score][name]) for score in _PAIR_SCORES)] for name in pairs]
    line = decision(comparison).partition("; ")
    runs = [FinishedRun(folder) for folder in (comparison.base, comparison.other)]
    links = [[report_link(run.folder, one, start) for run in runs] for one in objects[:MOST_OBJECTS]]
    return {
        "comparison": comparison,
        "decision": line[0],
        "chance": line[2],
        "verdict": verdict(comparison),
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
        "pairs": [["pair (change)", *_PAIR_SCORES], *changes],
    }
