"""Content of a page about a whole run: data for its JavaScript and texts for its template."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Any
from urllib.parse import quote, urlencode

import numpy as np
import orjson
import pandas as pd
from pydantic import TypeAdapter

from ....schemas.columns import SIDES
from ....schemas.errors import RunError
from ....schemas.metric_catalogue import (
    COVERAGE_REACHES,
    METRIC,
    QUADRANT_LIMITS,
    pair_columns_in,
    scores_in,
)
from ....schemas.results import Piece
from ....stages.sensor_description import SensorDescription, sensor_lines
from ...results.best_case import RunExcess
from ...results.finished import FinishedRun
from ...results.gate import Criterion, judge_run
from ...results.object_frame import QUADRANTS, UNKNOWN, plain_rows
from ...terminal import STEERING
from ..charts import rays_chart
from ..look import FATE_WORDS, PAGE_COLOURS, SIGNED_RAMP_M
from ..run_frames import OBJECT_COVERAGE, SCORES, RunResults, points_of
from ..view import Answers, Item, Note, Table, View, columns_of, items_of, percent
from ..views.answer_view import answer_sections, frame_warnings, run_line
from ..views.best_case_view import excess_view
from ..views.gate_view import gate_view
from ..views.run_view import details_view, failures_view
from .pair_data import FACTS, FAR_M, OBJECT_COLUMNS, SIGNED_M

#: More rows would make the page slow; the table then says what part it shows.
_MOST_ROWS = 1000
_DIGITS = 6
#: Quantiles of a score at the ends of its colours.
_COLOURED = (0.02, 0.98)

#: Parts of a bar of surface: within each reach of coverage, beyond the one before.
_REACHES = ("within 0.1 m", "0.1 to 0.3 m", "0.3 to 1 m")

_WORDS = ("pair_id", "object", "group", "quadrant", "status")
#: Columns of the tables of pairs and objects.
_PAIRS = (
    *("pair_id", "n_matched", "n_not_found", "n_extra", "match_rate"),
    *(*pair_columns_in("page"), *OBJECT_COVERAGE),
)
_OBJECTS = (
    *("object", "pair_id", "group", "quadrant", "status", "range_m"),
    *(*scores_in("page"), "n_real", "n_sim", "n_keep", *OBJECT_COVERAGE),
)

#: Headings of columns without a score; other columns are their own heading.
_HEADINGS = {
    "pair_id": "pair",
    "range_m": "range (m)",
    "bearing_deg": "bearing (°, left positive)",
    "n_real": "points, real",
    "n_sim": "points, simulated",
    "n_keep": "nodes kept",
    "road_share_real": "real, road on sim side",
    "road_share_sim": "sim, road on real side",
}


def page_data(results: RunResults) -> dict[str, Any]:
    """Data of the whole run for the page's JavaScript: charts, colours, tables; no points."""
    rays = rays_chart(results)
    scores = {}
    for score, (low, high) in score_limits(results).items():
        scores[score] = {"name": METRIC[score].label, "low": low, "high": high}
    pairs_note = "Worst first, by the mean of the ranks in match rate, CDC and r_lambda."
    objects_note = (
        "Worst first: matched objects by the mean of their ranks in CDC and r_lambda, then "
        "unmatched ones, largest first."
    )
    n_objects = len(results.objects)
    if n_objects > _MOST_ROWS:
        objects_note += (
            f" The page holds {_MOST_ROWS:,} of {n_objects:,}; the rest is in the run's tables."
        )
    return {
        "steering": STEERING,
        "names": results.pairs.pair_id.tolist(),
        "charts": {"rays_range": rays} if rays else {},
        "colours": PAGE_COLOURS,
        "far_m": FAR_M,
        "signed_m": SIGNED_M,
        "signed_ramp_m": SIGNED_RAMP_M,
        "scores": scores,
        "columns": _described(results.class_is),
        "pairs": _table(results.pairs, _PAIRS, pairs_note),
        "objects": _table(results.objects.head(_MOST_ROWS), _OBJECTS, objects_note),
        "facts": FACTS,
        "object_columns": OBJECT_COLUMNS,
    }


def _described(class_is: str) -> dict[str, dict[str, Any]]:
    """By column of pairs or objects: heading and decimals.

    `about` describes a score, `up` is true if its low values are worst.
    """
    headings = {**_HEADINGS, "group": class_is}
    digits = {"range_m": 1, "bearing_deg": 0}
    described = {}
    for key in dict.fromkeys((*_PAIRS, *_OBJECTS, *FACTS)):
        metric = METRIC.get(key.removesuffix("_mean"))
        column: dict[str, Any] = {"title": headings.get(key, key), "about": "", "up": False}
        if metric and key not in headings:
            column["title"] = re.sub(r"(?<=\d) (?=m\b)", "\N{NO-BREAK SPACE}", metric.label)
            column["about"] = f"{key}: {metric.reading or metric.meaning}"
            column["up"] = metric.higher_is_better
        n_digits = 2 if metric and metric.unit == "m" else 3
        described[key] = column | {"text": key in _WORDS, "digits": digits.get(key, n_digits)}
    return described


def _table(rows: pd.DataFrame, keys: Sequence[str], note: str) -> dict[str, Any]:
    values = plain_rows(rows[[*keys]].round(_DIGITS))
    return {"keys": keys, "rows": columns_of(values, keys), "note": note}


def score_limits(results: RunResults) -> dict[str, tuple[float, float]]:
    """By score the range that occurs, for colours: quantiles 0.02 and 0.98 over all objects.

    Without such a range (no object with a score, or all equal) that of the score's definition.
    """
    limits = {}
    for score in SCORES:
        low, high = results.matched[score].astype(float).quantile(_COLOURED)
        limits[score] = (low, high) if low < high else (0.0, METRIC[score].high or 1.0)
    return limits


def page_words(results: RunResults, excess: RunExcess | None = None) -> dict[str, Any]:
    """Values of the whole run for the page's template, and scores over a best case if any.

    Everything but the bars and the places is a view, as the terminal shows it.
    """
    run = results.run
    record = run.record
    overview = run.overview
    assert overview is not None  # a pair is scored
    sections = answer_sections(run, excess, with_all=True, is_page=True)
    sections.pop("Worst places", None)
    trust = sections.pop("Trust", [])
    sensor_pair = results.pairs["pair_id"].min()
    made = ("fidpipe", "written", "dataset", "seed", "workers")
    return {
        "title": run.folder.resolve().name,
        "line": run_line(run),
        "answer": [*frame_warnings(run), Answers([*sections.items()])],
        "bars": _bars(results, excess),
        "worst": [(_address(run, piece), piece) for piece in overview.pieces],
        "failures": failures_view(run),
        "gate": _gate(run, excess),
        "trust": [Answers([("Trust", trust)])],
        "sensor_pair": sensor_pair,
        "sensors": [Answers(_sensors(run, sensor_pair))],
        "details": details_view(record),
        "limits": QUADRANT_LIMITS,
        "best_case": excess_view(excess) if excess else [],
        "made": [
            _key_table("Settings", record.settings),
            _key_table("Run", {name: getattr(record, name) for name in made}),
            _key_table("Stages and libraries", record.stages | record.libraries),
            _key_table("Machine", record.machine.as_dict()),
        ],
    }


def _address(run: FinishedRun, piece: Piece) -> str:
    """Fragment of the page's address that opens the object with most points of a piece, if any."""
    points = points_of(run, piece.pair_id)[piece.side]
    communities = points.loc[points["piece_id"] == piece.piece_id, "community_id"]
    known = communities[communities >= 0]
    asked = {"pair": piece.pair_id}
    if len(known):
        asked["object"] = f"{piece.side} {known.mode()[0]}"
    return f"#{urlencode(asked, quote_via=quote)}"


def _sensors(run: FinishedRun, pair_id: str) -> list[tuple[str, list[Item]]]:
    """The sensor of each side, as stage `sensor` describes it for a pair."""
    jobs = run.store.ledger.jobs(pair_id)
    sensors = []
    for side in SIDES:
        sensor = SensorDescription(**jobs["sensor", side].metadata["sensor"])
        sensors.append((side, items_of(*sensor_lines(sensor))))
    return sensors


def _key_table(title: str, values: Mapping[str, Any]) -> Table:
    """Settings and the like by name."""
    rows = [(name, str(value)) for name, value in pd.json_normalize(dict(values)).iloc[0].items()]
    return Table(title, ("", ""), rows, words=(0, 1))


def _gate(run: FinishedRun, excess: RunExcess | None) -> View:
    """The criteria of the folder's last gate, evaluated again; or how to set some."""
    path = run.folder / "gate.json"
    if not path.exists():
        command = f"fidpipe gate {run.folder} --max r_lambda.mean=0.4"
        return [Note(f"No acceptance limits are set yet: {command} sets one.")]
    try:
        criteria = _CRITERIA.validate_python(orjson.loads(path.read_bytes())["criteria"])
        return gate_view(judge_run(run.folder, criteria, excess.best_case if excess else None))
    except (RunError, ValueError, LookupError, TypeError) as error:
        return [Note(f"The criteria of {path} cannot be evaluated again: {error}")]


def _bars(results: RunResults, excess: RunExcess | None) -> list[dict[str, Any]]:
    """Stacked bars: surface of both sides by distance to the other one, and real objects.

    The parts of each, from good to bad, are kind (its look), words, and share of the whole.
    """
    counts = results.matched["quadrant"].value_counts().reindex([*QUADRANTS, UNKNOWN], fill_value=0)
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
) -> dict[str, Any]:
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


_CRITERIA = TypeAdapter(list[Criterion])
