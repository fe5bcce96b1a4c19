"""Content of a page about a whole run: data for its JavaScript and texts for its template."""

from __future__ import annotations

from collections.abc import Container
from typing import Any
from urllib.parse import quote, urlencode

import numpy as np
import pandas as pd

from ....schemas.metric_catalogue import (
    COVERAGE_REACHES,
    COVERED,
    METRIC,
    QUADRANT_LIMITS,
    labels,
    scores_in,
)
from ....schemas.record import RunRecord
from ....schemas.results import Piece
from ...results.best_case import RunExcess
from ...results.finished import FinishedRun
from ...results.object_frame import QUADRANTS, UNKNOWN, plain_rows
from ..look import FATE_WORDS, OUTCOME_WORDS
from ..run_frames import RunResults, points_of
from ..view import Answers, Table, columns_of, items_of, percent
from ..views.answer_view import answer_sections, frame_warnings, next_commands, run_line
from ..views.best_case_view import excess_view
from ..views.run_view import details_view, failures_view, pairs_table
from .pair_data import SIGNED_M

#: More rows would make the page slow.
_MOST_ROWS = 1000
#: Parts of a bar of surface: within each reach of coverage, beyond the one before.
_REACHES = ("within 0.1 m", "0.1 to 0.3 m", "0.3 to 1 m")
#: Columns of the table of objects that are no scores, and their headings.
_OBJECTS = {
    "name": "object",
    "pair_id": "pair",
    "group": "class",
    "quadrant": "quadrant",
    "status": "status",
    "range_m": "range (m)",
    "n_real": "points, real",
    "n_sim": "points, simulated",
    "n_keep": "nodes kept",
}
_MADE = (
    *("fidpipe", "written", "dataset", "seed", "workers", "settings", "stages", "libraries"),
    "machine",
)


def page_data(results: RunResults) -> dict[str, Any]:
    """Data of the whole run for the page's JavaScript; no points."""
    scores = {}
    for score, limit in QUADRANT_LIMITS.items():
        scores[score] = {"name": METRIC[score].label, "limit": limit}
    return {"names": results.pairs.pair_id.tolist(), "signed_m": SIGNED_M, "scores": scores}


def page_words(
    results: RunResults, in_3d: Container[str], excess: RunExcess | None = None
) -> dict[str, Any]:
    """Values of the whole run for the page's template.

    Everything but the bars and the places is a view, as the terminal shows it.

    Parameters
    ----------
    in_3d : names of the pairs whose points the page has
    excess : the scores over a best case, to be shown as well
    """
    run = results.run
    overview = run.overview
    assert overview is not None  # a pair is scored
    sections = answer_sections(run, excess, with_all=True)
    del sections["Worst places"]
    sections["Next"] = items_of(*next_commands(run, excess, is_page=True))
    trust = {"Trust": sections.pop("Trust")}
    pairs = plain_rows(results.pairs)
    return {
        "title": run.folder.resolve().name,
        "line": run_line(run),
        "answer": [*frame_warnings(run), Answers(sections)],
        "bars": _bars(results, excess),
        "rays": _ray_bars(results),
        "worst": [(_address(run, piece), piece) for piece in overview.pieces],
        "failures": failures_view(run),
        "trust": [Answers(trust)],
        "details": details_view(run.record),
        "limits": QUADRANT_LIMITS,
        "best_case": excess_view(excess) if excess else [],
        "pairs": pairs_table(pairs, [_link(row, in_3d) for row in pairs]),
        "objects": _objects_table(results, in_3d),
        "made": [_made_table(run.record)],
    }


def _link(row: dict[str, Any], in_3d: Container[str]) -> str:
    """The address of a pair, or of an object, in the 3D view; "" if the page does not show it."""
    asked = {"pair": row["pair_id"]}
    if "name" in row:
        asked["object"] = row["name"]
    return f"#{urlencode(asked, quote_via=quote)}" if row["pair_id"] in in_3d else ""


def _address(run: FinishedRun, piece: Piece) -> str:
    """The address of the object with most points of a piece, or of its pair."""
    points = points_of(run, piece.pair_id)[piece.side]
    communities = points.loc[points["piece_id"] == piece.piece_id, "community_id"]
    known = communities[communities >= 0]
    row = {"pair_id": piece.pair_id}
    if len(known):
        row["name"] = f"{piece.side} {known.mode()[0]}"
    return _link(row, [piece.pair_id])


def _objects_table(results: RunResults, in_3d: Container[str]) -> Table:
    """Objects of all pairs, worst first."""
    scores = (*scores_in("page"), *COVERED)
    rows = plain_rows(results.objects.head(_MOST_ROWS))
    title = (
        "Matched objects by the mean of their ranks in CDC and r_lambda, then unmatched ones"
    )
    if len(results.objects) > _MOST_ROWS:
        title += f"; {_MOST_ROWS:,} of {len(results.objects):,}: Python has the rest"
    headings = [*_OBJECTS.values(), *labels(scores)]
    headings[2] = results.class_is
    cells = columns_of(rows, (*_OBJECTS, *scores))
    links = [_link(row, in_3d) for row in rows]
    return Table(title, headings, cells, words=range(5), links=links)


def _made_table(record: RunRecord) -> Table:
    """Settings, versions and machine by name."""
    values = pd.json_normalize({name: record.as_dict()[name] for name in _MADE}).iloc[0]
    return Table(
        "", ("", ""), [(name, str(value)) for name, value in values.items()], words=(0, 1)
    )


#: A bar: parts from good to bad, each with its look, its words, and its share of the whole.
Bar = dict[str, Any]


def _bars(results: RunResults, excess: RunExcess | None) -> list[Bar]:
    """Surface of both sides by distance to the other one, and real objects by quadrant."""
    counts = (
        results.matched["quadrant"].value_counts().reindex([*QUADRANTS, UNKNOWN], fill_value=0)
    )
    not_found = FATE_WORDS["not_found"]
    counts[not_found] = (results.unmatched["status"] == "not_found").sum()
    looks = {UNKNOWN: "unknown", not_found: "real step3"}
    shares = counts / max(1, counts.sum())
    parts = [(looks.get(str(name), name), name, share) for name, share in shares.items()]
    value = f"{percent(shares['faithful'])} faithful"
    return [
        _surface_bar(results, excess, "real", "Real surface", "missing"),
        _surface_bar(results, excess, "sim", "Simulated surface", "invented"),
        {"name": "Real objects", "value": value, "note": "", "parts": parts},
    ]


def _surface_bar(
    results: RunResults, excess: RunExcess | None, side: str, name: str, alone: str
) -> Bar:
    """The surface of a side by distance to the other one; `alone` is what the other side lacks."""
    summary = results.run.record.summary
    covered = [summary[f"covered_{side}_{reach}"].mean or 0.0 for reach in COVERAGE_REACHES]
    parts = []
    for i, share in enumerate(np.diff([0.0, *covered, 1.0]).tolist()):
        parts.append((f"{side} step{i}", (*_REACHES, alone)[i], share))
    near = f"covered_{side}_0p3m"
    note = f"best case {percent(excess.scores[near]['best_case'])}" if excess else ""
    value = f"{percent(summary[near].mean or 0.0)} within 0.3 m"
    return {"name": name, "value": value, "note": note, "parts": parts}


def _ray_bars(results: RunResults) -> list[Bar]:
    """Shares of the outcomes of rays over the scored pairs, by range; none without rays.

    Ranges are in the order of their names and so from near to far.
    """
    table = results.run.table("ray_scores", results.pairs.pair_id)
    bars = []
    for band, rows in table.to_pandas().query("by == 'range' and n_rays > 0").groupby("band"):
        n_rays = rows["n_rays"].sum()
        parts = []
        for name, words in OUTCOME_WORDS.items():
            parts.append((name, words, (rows[f"rays_{name}"] * rows["n_rays"]).sum() / n_rays))
        bars.append({"name": band, "value": f"{n_rays:,} rays", "note": "", "parts": parts})
    return bars
