"""Content of a page about a whole run: data for its JavaScript and texts for its template."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import orjson
import pandas as pd
from pydantic import TypeAdapter

from ....schemas.columns import SIDES
from ....schemas.errors import RunError
from ....schemas.metric_catalogue import METRIC, metric_of, pair_columns_in, scores_in
from ....schemas.results import Cause, Evidence
from ....stages.sensor_description import sensor_lines
from ...results.best_case import RunExcess
from ...results.causes import MOST_SHOWN, no_cause_words
from ...results.diagnosis import unexplained_words
from ...results.gate import Criterion, judge_run
from ...results.object_frame import CDC_LIMIT, QUADRANTS, R_LAMBDA_LIMIT, plain_rows
from ...terminal import STEERING
from ..charts import MOST_DOTS, along_the_sequence, evidence_chart, run_charts
from ..look import PAGE_COLOURS, SIGNED_RAMP_M
from ..pictures import FRAME, draw_pieces
from ..run_frames import OBJECT_COVERAGE, SCORES, RunResults, frames_of, quadrants
from ..view import Note, columns_of, number, percent, sentence
from ..views.answer_view import (
    amount_words,
    caution_words,
    change_words,
    pieces_words,
    surface_words,
    task_words,
    trust_words,
)
from ..views.best_case_view import excess_view
from ..views.run_view import (
    coverage_table,
    dataset_table,
    preset_line,
    range_table,
    surface_line,
    surface_table,
    tasks_view,
    unmatched_lines,
)
from .pair_data import FACTS, FAR_M, OBJECT_COLUMNS, SIGNED_M

#: More rows would make the page slow; the table then says what part it shows.
_MOST_ROWS = 5000
_MOST_FAILURES = 5
_DIGITS = 6
#: Quantiles of a score at the ends of its colours.
_COLOURED = (0.02, 0.98)

#: Parts of a bar of surface: within each reach of coverage, beyond the one before.
_REACHES = {"0p1m": "within 0.1 m", "0p3m": "0.1 to 0.3 m", "1m": "0.3 to 1 m"}

_WORDS = ("pair_id", "object", "group", "quadrant", "status")
#: Columns of the tables of pairs and objects.
_PAIRS = (
    *("pair_id", "n_matched", "n_missing", "n_hallucinated", "match_rate"),
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
        "charts": {name: chart for name, (chart, _) in charts.items()},
        "alternatives": {name: words for name, (_, words) in charts.items()},
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
    sensors = frames_of(results, sensor_pair).sensors
    run_values = {
        name: getattr(record, name) for name in ("fidpipe", "written", "dataset", "seed", "workers")
    }
    run_values["seconds"] = round(record.wall_s["total"], 1)
    return {
        "title": results.run.folder.resolve().name,
        "preset": preset_line(record),
        "verdict": verdict_of(results, excess),
        "frame": FRAME,
        "limits": (CDC_LIMIT, R_LAMBDA_LIMIT),
        "class_is": results.class_is,
        "most_dots": MOST_DOTS,
        "n_scored": int(results.matched.r_lambda.notna().sum()),
        "n_matched": len(results.matched),
        "n_unmatched": len(results.unmatched),
        "has_times": along_the_sequence(results, results.run.record.times_s)[0],
        "diagnosis": diagnosis,
        "diagnosed": _with_amounts(diagnosis.causes if diagnosis else ()),
        "unexplained": sentence(unexplained_words(diagnosis)) if diagnosis else "",
        "failures": {
            row["pair_id"]: row["reason"] for row in results.run.rows if row["status"] == "failed"
        },
        "most_failures": _MOST_FAILURES,
        "best_case": excess_view(excess) if excess else [],
        "sensor_pair": sensor_pair,
        "sensors": {side: sensor_lines(sensors[side]) for side in SIDES},
        "ranges": [range_table(record.findings)] if record.findings else [],
        "settings": record.settings,
        "versions": {
            "": run_values,
            "stage version": record.stages,
            "library": record.libraries,
            "machine": record.machine.as_dict(),
        },
    }


def _with_amounts(causes: Sequence[Cause]) -> list[tuple[Cause, str]]:
    return [(cause, amount_words(cause)) for cause in causes]


def verdict_of(results: RunResults, excess: RunExcess | None = None) -> dict[str, Any]:
    """The first screen of a run's page, over a best case if any, and the section `details`.

    is_met is True if the acceptance criteria of the last gate are met, None without any.
    """
    record = results.run.record
    overview = results.run.overview
    if overview is None:
        raise RunError(
            f"run {results.run.folder}: no pair is scored, so there is nothing to report"
        )
    tasks = task_words(record, excess)
    is_met, good_enough = _good_enough(results, excess)
    warning = [f"Warning: {words}" for words in caution_words(overview, ("frames",))]
    return {
        "sentence": sentence(surface_words(record, excess)),
        "pieces": sentence(pieces_words(record).replace(" missing", " pieces missing", 1)),
        "tasks": sentence(tasks) if tasks else "",
        "bars": _bars(results, excess),
        "causes": _with_amounts(overview.causes[:MOST_SHOWN]),
        "no_cause": sentence(no_cause_words(overview.unknown)),
        "doubts": [sentence(words) for words in overview.doubts],
        "worst": draw_pieces(results, overview.pieces),
        "is_met": is_met,
        "good_enough": good_enough,
        "warning": " ".join(warning),
        "change": sentence(change_words(record)) if record.previous else "",
        "trust": [sentence(words) for words in trust_words(results.run.folder, overview)],
        "details": [
            dataset_table(record, pair_columns_in("numbers")),
            Note(
                "Unmatched as worst: each missing and each invented object counted with the worst "
                "value."
            ),
            *tasks_view(record.tasks),
            coverage_table(record),
            surface_table(overview),
            Note(
                "Real points that are not covered are missing surface, simulated ones invented "
                "surface."
            ),
            *map(Note, (*unmatched_lines(record), surface_line(record))),
        ],
    }


def _bars(results: RunResults, excess: RunExcess | None) -> list[dict[str, Any]]:
    """Stacked bars: surface of both sides by distance to the other one, and real objects.

    The parts of each, from good to bad, are kind (its look), words, and share of the whole.
    """
    surfaces = (("real", "Real surface", "missing"), ("sim", "Simulated surface", "invented"))
    bars = [_surface_bar(results, excess, *surface) for surface in surfaces]
    counts = {name: quadrant["n"] for name, quadrant in quadrants(results).items()}
    counts["missing"] = int((results.unmatched.status == "missing").sum())
    n_all = max(1, len(results.matched) + counts["missing"])
    kinds = (*QUADRANTS, "unknown", "real step3")
    parts = []
    for kind, (name, n) in zip(kinds, counts.items(), strict=True):
        parts.append((kind, name, n / n_all))
    value = f"{percent(parts[0][2])} faithful"
    return [*bars, {"name": "Real objects", "value": value, "note": "", "parts": parts}]


def _surface_bar(
    results: RunResults, excess: RunExcess | None, side: str, name: str, alone: str
) -> dict[str, Any]:
    """The surface of a side by distance to the other one; `alone` is what the other side lacks."""
    parts = []
    covered = 0.0
    for i, (reach, words) in enumerate(_REACHES.items()):
        farther = results.run.record.summary[f"covered_{side}_{reach}"].mean or 0.0
        parts.append((f"{side} step{i}", words, farther - covered))
        covered = farther
    parts.append((f"{side} step{len(_REACHES)}", alone, 1.0 - covered))
    near = f"covered_{side}_0p3m"
    share = percent(results.run.record.summary[near].mean or 0.0)
    note = f"best case {percent(excess.scores[near].best_case)}" if excess else ""
    return {"name": name, "value": f"{share} within 0.3 m", "note": note, "parts": parts}


def _good_enough(results: RunResults, excess: RunExcess | None) -> tuple[bool | None, list[str]]:
    """The criteria of the folder's last gate, evaluated again; or how to set some."""
    folder = results.run.folder
    path = folder / "gate.json"
    criteria = _last_criteria(path)
    if criteria is None:
        command = f"fidpipe gate {folder} --max r_lambda.mean=0.4"
        return None, [f"No acceptance limits are set yet: {command} sets one."]
    try:
        result = judge_run(folder, criteria, None if excess is None else excess.best_case)
    except (RunError, ValueError) as error:
        return None, [f"The criteria of {path} cannot be evaluated again: {error}"]
    on_scores = [judged for judged in result.judged if not judged.measure.startswith("pairs.")]
    n_met = sum(judged.passed for judged in on_scores)
    met = f"{n_met} of {len(on_scores)} acceptance criteria on scores are met"
    unmet = [judged for judged in result.judged if not judged.passed]
    if not unmet:
        on_run = "and those on the run itself (complete, no pair failed, nothing changed since)"
        return True, [f"Yes: {met}, {on_run}."]
    why = [f"{judged.name}: {judged.why or number(judged.value)}" for judged in unmet[:3]]
    return False, [f"No: {met}.", *map(sentence, why)]


_CRITERIA = TypeAdapter(list[Criterion])


def _last_criteria(path: Path) -> list[Criterion] | None:
    """The criteria that a gate wrote down; None if none can be read."""
    try:
        return _CRITERIA.validate_python(orjson.loads(path.read_bytes())["criteria"])
    except (OSError, ValueError, KeyError, TypeError):
        return None
