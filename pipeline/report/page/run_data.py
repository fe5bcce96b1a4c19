"""Content of a page about a whole run: data for its JavaScript and texts for its template."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import orjson
import pandas as pd
from pydantic import TypeAdapter

from ....schemas.errors import RunError
from ....schemas.metric_catalogue import (
    COVERAGE_REACHES,
    METRIC,
    metric_of,
    pair_columns_in,
    scores_in,
)
from ....schemas.results import Evidence
from ....stages.sensor_description import sensor_lines
from ...results.best_case import RunExcess
from ...results.diagnosis import unexplained_words
from ...results.gate import Criterion, judge_run
from ...results.object_frame import CDC_LIMIT, R_LAMBDA_LIMIT, UNKNOWN, plain_rows
from ...terminal import STEERING
from ..charts import MOST_DOTS, evidence_chart, run_charts
from ..look import FATE_WORDS, PAGE_COLOURS, SIGNED_RAMP_M
from ..pictures import FRAME, draw_pieces
from ..run_frames import OBJECT_COVERAGE, SCORES, RunResults, frames_of, quadrants
from ..view import Answers, Table, columns_of, items_of, percent, sentence
from ..views.answer_view import amount_words, answer_sections, caution_words
from ..views.best_case_view import excess_view
from ..views.gate_view import gate_checks
from ..views.run_view import details_view, preset_line
from .pair_data import FACTS, FAR_M, OBJECT_COLUMNS, SIGNED_M

#: More rows would make the page slow; the table then says what part it shows.
_MOST_ROWS = 1000
_DIGITS = 6
#: Quantiles of a score at the ends of its colours.
_COLOURED = (0.02, 0.98)

#: Parts of a bar of surface: within each reach of coverage, beyond the one before.
_REACHES = ("within 0.1 m", "0.1 to 0.3 m", "0.3 to 1 m")

#: Sections of the answer in the first sentence, and below it.
_SENTENCES = ("  surface", "  pieces", "  tasks")
_FIRST = ("Check first", "Fix first", "Doubtful", "Last run", "Next")

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

#: Headings of columns without a score; other names are their own heading.
_HEADINGS = {
    "pair_id": "pair",
    "range_m": "range (m)",
    "bearing_deg": "bearing (°, left positive)",
    "n_real": "points, real",
    "n_sim": "points, simulated",
    "n_keep": "nodes kept",
    "road_share_real": "real, road on sim side",
    "road_share_sim": "sim, road on real side",
    **{name: name for name in ("object", "quadrant", "status", "reason")},
}


def page_data(results: RunResults) -> dict[str, Any]:
    """Data of the whole run for the page's JavaScript: charts, colours, tables; no points."""
    charts = run_charts(results)
    for name, evidence in _curves(results).items():
        charts[f"cause_{name}"] = evidence_chart(evidence)
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
        "charts": charts,
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


def _curves(results: RunResults) -> dict[str, Evidence]:
    """Curves of the diagnosis by cause; those of several causes belong to the first one."""
    diagnosis = results.run.diagnosis
    curves: dict[str, Evidence] = {}
    for cause in diagnosis.causes if diagnosis else ():
        if cause.evidence and cause.evidence not in curves.values():
            curves[cause.name] = cause.evidence
    return curves


def _described(class_is: str) -> dict[str, dict[str, Any]]:
    """By column of pairs or objects: heading and decimals.

    `about` describes a score, `up` is true if its low values are worst.
    """
    headings = {**_HEADINGS, "group": class_is}
    digits = {"range_m": 1, "bearing_deg": 0}
    described = {}
    for key in dict.fromkeys((*_PAIRS, *_OBJECTS, *FACTS)):
        column: dict[str, Any] = {"text": key in _WORDS, "digits": digits.get(key, 3)}
        if key in headings:
            column |= {"title": headings[key], "about": "", "up": False}
        else:
            metric = metric_of(key)
            column |= {
                "title": re.sub(r"(?<=\d) (?=m\b)", "\N{NO-BREAK SPACE}", metric.label),
                "about": f"{key}: {metric.reading or metric.meaning}",
                "up": metric.higher_is_better,
            }
            if metric.unit == "m":
                column["digits"] = 2
        described[key] = column
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
        values = results.matched[score].dropna().to_numpy(dtype=float)
        limits[score] = (0.0, METRIC[score].high or 1.0)
        if len(values):
            low, high = np.quantile(values, _COLOURED).tolist()
            if high > low:
                limits[score] = (low, high)
    return limits


def page_words(results: RunResults, excess: RunExcess | None = None) -> dict[str, Any]:
    """Values of the whole run for the page's template, and scores over a best case if any."""
    record = results.run.record
    diagnosis = results.run.diagnosis
    sensor_pair = results.pairs.pair_id.min()
    sensors = {}
    for side, sensor in frames_of(results, sensor_pair).sensors.items():
        sensors[side] = sensor_lines(sensor)
    names = ("fidpipe", "written", "dataset", "seed", "workers")
    failures = [row for row in results.run.rows if row["status"] == "failed"]
    return {
        "title": results.run.folder.resolve().name,
        "preset": preset_line(record),
        "verdict": verdict_of(results, excess),
        "details": details_view(record),
        "frame": FRAME,
        "limits": (CDC_LIMIT, R_LAMBDA_LIMIT),
        "drawn": (
            min(int(results.matched.r_lambda.notna().sum()), MOST_DOTS),
            len(results.matched),
        ),
        "diagnosis": diagnosis,
        "diagnosed": [
            (cause, amount_words(cause)) for cause in (diagnosis.causes if diagnosis else ())
        ],
        "unexplained": sentence(unexplained_words(diagnosis)) if diagnosis else "",
        "failures": {row["pair_id"]: row["reason"] for row in failures},
        "best_case": excess_view(excess) if excess else [],
        "sensor_pair": sensor_pair,
        "sensors": [Answers([(side, items_of(*lines)) for side, lines in sensors.items()])],
        "made": [
            _key_table("Settings", record.settings),
            _key_table("Run", {"": {name: getattr(record, name) for name in names}}),
            _key_table("Stages and libraries", {"": record.stages | record.libraries}),
            _key_table("Machine", {"": record.machine.as_dict()}),
        ],
    }


def _key_table(title: str, groups: Mapping[str, Any]) -> Table:
    """Settings and the like by name."""
    values = pd.json_normalize(dict(groups)).iloc[0]
    rows = [(str(name).removeprefix("."), str(value)) for name, value in values.items()]
    return Table(title, ("", ""), rows, words=(0, 1))


def verdict_of(results: RunResults, excess: RunExcess | None = None) -> dict[str, Any]:
    """The first screen of a run's page, over a best case if any, and what limits the trust in it.

    is_met is True if the acceptance criteria of the last gate are met, None without any.
    """
    record = results.run.record
    overview = results.run.overview
    if overview is None:
        raise RunError(
            f"run {results.run.folder}: no pair is scored, so there is nothing to report"
        )
    sections = answer_sections(
        results.run.folder,
        record,
        overview,
        results.run.diagnosis,
        excess,
        with_all=True,
        is_page=True,
    )
    texts = [sections[heading][0][0] for heading in _SENTENCES if heading in sections]
    first = [(heading, sections[heading]) for heading in _FIRST if heading in sections]
    is_met, good_enough = _good_enough(results, excess)
    return {
        "sentence": " ".join(map(sentence, texts)).replace(" missing", " pieces missing", 1),
        "warnings": [f"Warning: {words}" for words in caution_words(overview, ("frames",))],
        "bars": _bars(results, excess),
        "answer": [Answers(first)],
        "worst": draw_pieces(results, overview.pieces),
        "is_met": is_met,
        "good_enough": good_enough,
        "trust": [sentence(words) for words, _, _ in sections.get("Trust", [])],
    }


def _bars(results: RunResults, excess: RunExcess | None) -> list[dict[str, Any]]:
    """Stacked bars: surface of both sides by distance to the other one, and real objects.

    The parts of each, from good to bad, are kind (its look), words, and share of the whole.
    """
    counts = {name: quadrant["n"] for name, quadrant in quadrants(results).items()}
    not_found = FATE_WORDS["not_found"]
    counts[not_found] = int((results.unmatched.status == "not_found").sum())
    n_all = max(1, sum(counts.values()))
    looks = {UNKNOWN: "unknown", not_found: "real step3"}
    parts = [(looks.get(name, name), name, n / n_all) for name, n in counts.items()]
    value = f"{percent(parts[0][2])} faithful"
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
    note = f"best case {percent(excess.scores[near].best_case)}" if excess else ""
    value = f"{percent(summary[near].mean or 0.0)} within 0.3 m"
    return {"name": name, "value": value, "note": note, "parts": parts}


def _good_enough(results: RunResults, excess: RunExcess | None) -> tuple[bool | None, list[str]]:
    """The criteria of the folder's last gate, evaluated again; or how to set some."""
    folder = results.run.folder
    path = folder / "gate.json"
    if not path.exists():
        command = f"fidpipe gate {folder} --max r_lambda.mean=0.4"
        return None, [f"No acceptance limits are set yet: {command} sets one."]
    try:
        criteria = _CRITERIA.validate_python(orjson.loads(path.read_bytes())["criteria"])
        result = judge_run(folder, criteria, None if excess is None else excess.best_case)
    except (RunError, ValueError, LookupError, TypeError) as error:
        return None, [f"The criteria of {path} cannot be evaluated again: {error}"]
    checks = gate_checks(result)
    failed = [sentence(check.found) for check in checks if check.fault]
    word = "No" if failed else "Yes"
    n_met = len(checks) - len(failed)
    return not failed, [f"{word}: {n_met} of {len(checks)} criteria are met.", *failed]


_CRITERIA = TypeAdapter(list[Criterion])
