"""A comparison of runs as one page with its tables; nothing is fetched from the network."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from ....stages.arrays import FloatArray
from ....stages.statistics.bands import evenly
from ....stages.surface import signed_distances
from ...results.compare import Comparison
from ...results.finished import FinishedRun
from ...results.followed import worst_changes
from ..run_frames import coordinates, inside
from ..view import percent
from ..views.compare_view import answer, decision, numbers_view, place_words
from .page_templates import render

_METHOD = (
    "Changes are after minus before, means over independent pairs. Intervals: 95 %, each of its "
    "score alone (Student's t). Verdicts: exact sign-flip test per family (maxT over its scores), "
    "Holm over the families."
)
#: The place that shows a flaw of the sensor or its pose: half its width.
_NEAR_M = 10.0
#: What is shown around a changed object.
_AROUND_M = 1.0
_REACH_M = 0.5
_MOST_POINTS = 5000


def compare_page(comparisons: Sequence[Comparison]) -> str:
    """The whole page; every name is escaped.

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
            }
        )
    return render("compare.html", {"places": drawn}, sections=sections, method=_METHOD)


def _places(comparison: Comparison, runs: Sequence[FinishedRun]) -> dict[str, dict[str, Any]]:
    """By words what is shown in 3D: the first cause around the sensor, then the worst objects."""
    places = {}
    causes = [cause for cause in comparison.changes.causes if cause.kind == "sensor"]
    if causes:
        pair_id = comparison.pairs[0]
        words = f"{causes[0].words}: around the sensor, pair {pair_id}"
        places[words] = draw_place(runs, pair_id)
    for row in worst_changes(comparison.objects):
        words = f"{place_words(row)}, pair {row['pair_id']}, object {row['real_id']}"
        places[words] = draw_place(runs, row["pair_id"], row["real_id"])
    return places


def draw_place(
    runs: Sequence[FinishedRun], pair_id: str, real_id: int | None = None
) -> dict[str, Any]:
    """Points of two runs around a real object, or the sensor: real ones, and simulated ones.

    Simulated points have their signed distances to the real surface.

    Raises
    ------
    RunError
        A table is damaged or gone.
    """
    rows = runs[0].points(pair_id, "real")
    real = coordinates(rows)
    low, high = np.full(3, -_NEAR_M), np.full(3, _NEAR_M)
    if real_id is not None:
        members = real[rows["community_id"].fillna(-1) == real_id]
        low = members.min(axis=0) - _AROUND_M
        high = members.max(axis=0) + _AROUND_M
    sims = []
    for run in runs:
        scan = coordinates(run.points(pair_id, "sim"))
        points = _some(scan[inside(scan, low, high)])
        signed_m = signed_distances(points, real, _REACH_M)
        known = signed_m[~np.isnan(signed_m)]
        words = "no simulated point with a real plane next to it"
        if len(known):
            middle_cm = 100 * float(np.median(known))
            where = "behind" if middle_cm < 0 else "in front of"
            share = percent(len(known) / len(points))
            words = (
                f"median {abs(middle_cm):.1f} cm {where} the real surface, which {share} of the "
                "simulated points have next to them"
            )
        plain = [None if np.isnan(value) else round(value, 3) for value in signed_m.tolist()]
        sims.append({"words": words, "points": _columns(points), "signed_m": plain})
    return {"real": _columns(_some(real[inside(real, low, high)])), "sims": sims}


def _some(points: FloatArray) -> FloatArray:
    """At most as many points as a place shows, evenly over their order."""
    return points[evenly(len(points), _MOST_POINTS)]


def _columns(points: FloatArray) -> list[list[float]]:
    """All x, all y and all z of some points, rounded."""
    return points.T.round(2).tolist()
