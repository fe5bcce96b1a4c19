"""A comparison of runs as one page with its tables; nothing is fetched from the network."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any
from urllib.parse import quote

import numpy as np

from ...results.causes import read_causes
from ...results.compare import Comparison
from ...results.finished import FinishedRun
from ...results.followed import worst_changes
from ...terminal import STEERING
from ..look import PAGE_COLOURS, SIGNED_RAMP_M
from ..pictures import draw_around_sensor, draw_change
from ..views.compare_view import answer, decision, numbers_view, place_words
from .page_templates import render
from .run_page import PAGE

_METHOD = (
    "Changes are after minus before, means over independent pairs. Intervals: 95 %, each of its "
    "score alone (Student's t). Verdicts: exact sign-flip test per family (maxT over its scores), "
    "Holm over the families."
)


def compare_page(comparisons: Sequence[Comparison], start: Path = Path()) -> str:
    """The whole page; every name is escaped.

    Parameters
    ----------
    start : folder that the page is for, which its links to the runs' reports begin at

    Raises
    ------
    RunError
        A table that points are read from is damaged or gone.
    """
    sections = []
    drawn = []
    for comparison in comparisons:
        runs = [FinishedRun(folder) for folder in (comparison.base, comparison.other)]
        places = _places(comparison, runs)
        drawn.append(list(places.values()))
        sections.append(
            {
                "comparison": comparison,
                "decision": decision(comparison),
                "answer": [answer(comparison)],
                "numbers": numbers_view(comparison, with_all=True),
                "places": list(places),
                "reports": [_report_link(run.folder, start) for run in runs],
            }
        )
    data = {
        "charts": {},
        "steering": STEERING,
        "colours": PAGE_COLOURS,
        "signed_ramp_m": SIGNED_RAMP_M,
        "places": drawn,
    }
    return render("compare.html", data, sections=sections, method=_METHOD)


def _places(comparison: Comparison, runs: Sequence[FinishedRun]) -> dict[str, dict[str, Any]]:
    """By words what is shown in 3D: the first cause around the sensor, then the worst objects."""
    places = {}
    causes = [change for change in comparison.changes.causes if change.cause.kind == "sensor"]
    if causes:
        pair_id = _clearest_pair(comparison, runs, causes[0].cause.name)
        words = f"{causes[0].words}: around the sensor, pair {pair_id}"
        places[words] = draw_around_sensor(pair_id, runs)
    for row in worst_changes(comparison.objects):
        words = f"{place_words(row)}, pair {row['pair_id']}, object {row['real_id']}"
        places[words] = draw_change(row, runs)
    return places


def _clearest_pair(comparison: Comparison, runs: Sequence[FinishedRun], cause: str) -> str:
    """The pair in which a cause changed most."""
    before, after = [read_causes(run.store, comparison.pairs)[cause].amount for run in runs]
    return comparison.pairs[int(np.argmax(np.nan_to_num(np.abs(after - before))))]


def _report_link(run: Path, start: Path) -> str:
    """The address of a run's report, relative to a folder; "" without a report."""
    page = run / PAGE
    return quote(os.path.relpath(page.resolve(), start.resolve())) if page.exists() else ""
