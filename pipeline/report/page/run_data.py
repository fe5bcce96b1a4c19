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
from ....schemas.metric_catalogue import METRIC, metric_of
from ....schemas.results import Evidence
from ....stages.sensor_description import sensor_lines
from ...results.best_case import RunExcess
from ...results.causes import MOST_SHOWN
from ...results.diagnosis import unexplained_words
from ...results.gate import Criterion, judge_run
from ...results.object_frame import CDC_LIMIT, QUADRANTS, R_LAMBDA_LIMIT, plain_rows
from ...terminal import STEERING
from ..charts import MOST_DOTS, along_the_sequence, evidence_chart, run_charts
from ..look import PAGE_COLOURS, SIGNED_RAMP_M
from ..pictures import FRAME, draw_pieces
from ..run_frames import OBJECT_COVERAGE, OBJECT_ROAD, SCORES, RunResults, frames_of, quadrants
from ..view import Note, Table, number, percent, sentence
from ..views.answer_view import (
    NO_CAUSE,
    amount_words,
    change_words,
    pieces_words,
    surface_words,
    trust_words,
    unknown_words,
)
from ..views.best_case_view import excess_view
from ..views.run_view import (
    coverage_table,
    dataset_table,
    preset_line,
    range_table,
    surface_line,
    surface_table,
    unmatched_lines,
)
from .pair_data import FACTS, FAR_M, OBJECT_COLUMNS, SIGNED_M

#: More rows would make the page slow; the table then says what part it shows.
_MOST_ROWS = 5000
_MOST_FAILURES = 5
_DIGITS = 6
#: Quantiles of a score at the ends of its colours.
_COLOURED = (0.02, 0.98)

_WORDS = ("pair_id", "object", "group", "quadrant", "status")
_SCORES = (
    "cdc", "r_lambda", "alignment_rms_m", "max_eigenvalue_shift", "laplacian_change", "r_gap", "centroid_distance_m",
)  # fmt: skip
#: Scores of the section `details`.
_DATASET = (
    *("match_rate", "found", "cdc_mean", "r_lambda_mean", "max_eigenvalue_shift_mean", "laplacian_change_mean"),
    *("r_gap_mean", "alignment_rms_m_mean", "centroid_distance_m_mean"),
)
#: Columns of the tables of pairs and objects.
_PAIRS = (
    *("pair_id", "n_matched", "n_missing", "n_hallucinated", "match_rate"),
    *(METRIC[score].mean_column for score in _SCORES),
    *OBJECT_COVERAGE,
)
_OBJECTS = (
    *("object", "pair_id", "group", "quadrant", "status", "range_m"),
    *(*_SCORES, "n_real", "n_sim", "n_keep", *OBJECT_COVERAGE),
)

#: Headings of columns without a score; other names are their own heading.
_HEADINGS = {
    "pair_id": "pair", "range_m": "range (m)", "bearing_deg": "bearing (°, left positive)",
    "n_real": "points, real", "n_sim": "points, simulated", "n_keep": "nodes kept",
    **dict(zip(OBJECT_ROAD, ("real, road on sim side", "sim, road on real side"), strict=True)),
    **{name: name for name in ("object", "quadrant", "status", "reason")},
}  # fmt: skip


def page_data(results: RunResults) -> dict[str, Any]:
    """Data of the whole run for the page's JavaScript: charts, colours, tables; no points."""
    charts = run_charts(results)
    for name, evidence in _curves(results).items():
        charts[f"cause_{name}"] = evidence_chart(evidence)
    order = "matched objects by the mean of their ranks in CDC and r_lambda, then unmatched ones, largest first"
    part = f" The page holds {_MOST_ROWS:,} of {len(results.objects):,}; the rest is in the run's tables."
    objects_note = f"Worst first: {order}.{part if len(results.objects) > _MOST_ROWS else ''}"
    return {
        "steering": STEERING,
        "names": results.pairs.pair_id.tolist(),
        "charts": {name: chart for name, (chart, _) in charts.items()},
        "alternatives": {name: words for name, (_, words) in charts.items()},
        "colours": PAGE_COLOURS,
        "far_m": FAR_M,
        "signed_m": SIGNED_M,
        "signed_ramp_m": SIGNED_RAMP_M,
        "scores": {
            score: {"name": METRIC[score].label, "low": low, "high": high}
            for score, (low, high) in score_limits(results).items()
        },
        "columns": _described(results.class_is),
        "pairs": _table(
            results.pairs, _PAIRS, "Worst first, by the mean of the ranks in match rate, CDC and r_lambda."
        ),
        "objects": _table(results.objects.head(_MOST_ROWS), _OBJECTS, objects_note),
        "facts": FACTS,
        "object_columns": OBJECT_COLUMNS,
    }


def _curves(results: RunResults) -> dict[str, Evidence]:
    """Curves of the diagnosis by name of the cause; those of several causes belong to the first one."""
    diagnosis = results.run.diagnosis
    curves: dict[str, Evidence] = {}
    for cause in diagnosis.causes if diagnosis else ():
        if cause.evidence and cause.evidence not in curves.values():
            curves[cause.name] = cause.evidence
    return curves


def _described(class_is: str) -> dict[str, dict[str, Any]]:
    """By column of pairs or objects: heading and decimals; `about` describes a score, `up` if low values are worst."""
    known, described = {**_HEADINGS, "group": class_is}, {}
    for key in dict.fromkeys((*_PAIRS, *_OBJECTS, *FACTS)):
        metric = METRIC.get(key.removesuffix("_mean"))
        is_metres = metric is not None and metric.unit == "m"
        described[key] = {
            "title": re.sub(r"(?<=\d) (?=m\b)", "\N{NO-BREAK SPACE}", known.get(key) or metric_of(key).label),
            "about": f"{key}: {metric.reading or metric.meaning}" if metric else "",
            "text": key in _WORDS,
            "up": metric is not None and metric.higher_is_better,
            "digits": {"range_m": 1, "bearing_deg": 0}.get(key, 2 if is_metres else 3),
        }
    return described


def _table(rows: pd.DataFrame, keys: Sequence[str], note: str) -> dict[str, Any]:
    return {"keys": keys, "rows": _plain(rows.round(_DIGITS), keys), "note": note}


def _plain(rows: pd.DataFrame, keys: Sequence[str]) -> list[list[Any]]:
    return [[*row.values()] for row in plain_rows(rows[[*keys]])]


def score_limits(results: RunResults) -> dict[str, tuple[float, float]]:
    """By score the range that occurs, for colours: its quantiles 0.02 and 0.98 over the objects of all pairs.

    Without such a range (no object with a score, or all equal) it is that of the score's definition.
    """
    limits = {}
    for score in SCORES:
        values = results.matched[score].dropna().to_numpy(dtype=float)
        low, high = np.quantile(values, _COLOURED).tolist() if len(values) else (0.0, 0.0)
        limits[score] = (low, high) if high > low else (0.0, METRIC[score].high or 1.0)
    return limits


def stage_times(results: RunResults) -> pd.DataFrame:
    """By stage and step in the order of the pipeline: median over pairs of the `seconds` of both sides together."""
    times: pd.DataFrame = results.run.read_table("timings").to_pandas()
    times = times[times.pair_id.isin(results.pairs.pair_id)]
    order = [*results.run.record.stages, *times.stage]
    times = times.assign(stage=pd.Categorical(times.stage, list(dict.fromkeys(order))))
    per_pair = times.groupby(["stage", "step", "pair_id"], sort=False, observed=True).seconds.sum()
    median = per_pair.groupby(["stage", "step"], sort=False, observed=True).median()
    return median.reset_index().sort_values("stage", kind="stable")


def page_words(results: RunResults, excess: RunExcess | None = None) -> dict[str, Any]:
    """Values of the whole run for the page's template: versions by group, and scores over a best case if any."""
    record, times = results.run.record, ("stage", "step", "seconds")
    diagnosis = results.run.diagnosis
    sensor_pair = results.pairs.pair_id.min()
    sensors = frames_of(results, sensor_pair).sensors
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
        "diagnosed": [(cause, amount_words(cause)) for cause in diagnosis.causes] if diagnosis else [],
        "unexplained": sentence(unexplained_words(diagnosis)) if diagnosis else "",
        "failures": {row["pair_id"]: row["reason"] for row in results.run.rows if row["status"] == "failed"},
        "most_failures": _MOST_FAILURES,
        "best_case": excess_view(excess) if excess else [],
        "sensor_pair": sensor_pair,
        "sensors": {side: sensor_lines(sensors[side]) for side in SIDES},
        "ranges": [range_table(record.findings)] if record.findings else [],
        "times": Table("", times, _plain(stage_times(results), times), words=(0, 1)),
        "settings": record.settings,
        "versions": {
            "": {name: getattr(record, name) for name in ("fidpipe", "written", "dataset", "seed", "workers")}
            | {"seconds": round(record.wall_s["total"], 1)},
            "stage version": record.stages,
            "library": record.libraries,
            "machine": record.machine.as_dict(),
        },
    }


def verdict_of(results: RunResults, excess: RunExcess | None = None) -> dict[str, Any]:
    """The first screen of a run's page, over a best case if there is one, and the section `details`.

    is_met is True if the acceptance criteria of the last gate are met, None without any.
    """
    record = results.run.record
    overview = results.run.overview
    if overview is None:
        raise RunError(f"run {results.run.folder}: no pair is scored, so there is nothing to report")
    is_met, good_enough = _good_enough(results, excess)
    cautions = [caution for caution in overview.trust if caution.kind not in ("frames", "failed")]
    trust = trust_words(results.run.folder, cautions)
    if overview.unknown:
        trust.append(unknown_words(overview))
    return {
        "sentence": sentence(surface_words(record, excess)),
        "pieces": sentence(pieces_words(record).replace(" missing", " pieces missing", 1)),
        "bars": _bars(results, excess),
        "causes": [(cause, amount_words(cause)) for cause in overview.causes[:MOST_SHOWN]],
        "no_cause": sentence(NO_CAUSE),
        "worst": draw_pieces(results, overview.pieces),
        "is_met": is_met,
        "good_enough": good_enough,
        "warning": " ".join(f"Warning: {one.words}" for one in overview.trust if one.kind == "frames"),
        "change": sentence(change_words(record)) if record.previous else "",
        "trust": [sentence(words) for words in trust],
        "details": [
            dataset_table(record, _DATASET),
            Note("Unmatched as worst: each missing and each invented object counted with the worst value."),
            coverage_table(record),
            surface_table(overview),
            Note("Real points that are not covered are missing surface, simulated ones invented surface."),
            *map(Note, (*unmatched_lines(record), surface_line(record))),
        ],
    }


def _bars(results: RunResults, excess: RunExcess | None) -> list[dict[str, Any]]:
    """Stacked bars: surface of both sides by distance to the other one, and real objects by quadrant.

    The parts of each, from good to bad, are kind (its look), words, and share of the whole.
    """
    summary, bars = results.run.record.summary, list[dict[str, Any]]()
    for side, name, alone in (("real", "Real surface", "missing"), ("sim", "Simulated surface", "invented")):
        reaches = [f"covered_{side}_{reach}" for reach in ("0p1m", "0p3m", "1m")]
        ends = [0.0, *(summary[column].mean or 0.0 for column in reaches), 1.0]
        words = ("within 0.1 m", "0.1 to 0.3 m", "0.3 to 1 m", alone)
        parts = [
            (f"{side} step{i}", text, high - low)
            for i, (text, low, high) in enumerate(zip(words, ends[:-1], ends[1:], strict=True))
        ]
        note = f"best case {percent(excess.scores[reaches[1]].best_case)}" if excess else ""
        bars.append({"name": name, "value": f"{percent(ends[2])} within 0.3 m", "note": note, "parts": parts})
    counted = quadrants(results)
    n_missing = int((results.unmatched.status == "missing").sum())
    n_all = max(1, len(results.matched) + n_missing)
    fates = {**{key: own["n"] for key, own in counted.items()}, "missing": n_missing}
    kinds = (*QUADRANTS, "unknown", "real step3")
    shares = [(kind, name, n / n_all) for kind, (name, n) in zip(kinds, fates.items(), strict=True)]
    return [*bars, {"name": "Real objects", "value": f"{percent(shares[0][2])} faithful", "parts": shares}]


def _good_enough(results: RunResults, excess: RunExcess | None) -> tuple[bool | None, list[str]]:
    """The criteria of the folder's last gate, evaluated again; or how to set some."""
    folder = results.run.folder
    criteria = _last_criteria(folder / "gate.json")
    if criteria is None:
        return None, [f"No acceptance limits are set yet: fidpipe gate {folder} --max r_lambda.mean=0.4 sets one."]
    try:
        result = judge_run(folder, criteria, None if excess is None else excess.best_case)
    except (RunError, ValueError) as error:
        return None, [f"The criteria of {folder / 'gate.json'} cannot be evaluated again: {error}"]
    unmet = [verdict for verdict in result.judged if not verdict.passed]
    on_scores = [verdict for verdict in result.judged if not verdict.measure.startswith("pairs.")]
    n_met = sum(verdict.passed for verdict in on_scores)
    met = f"{n_met} of {len(on_scores)} acceptance criteria on scores are met"
    if not unmet:
        return True, [f"Yes: {met}, and those on the run itself (complete, no pair failed, nothing changed since)."]
    why = [f"{one.name}: {one.why or number(one.value)}" for one in unmet[:3]]
    return False, [f"No: {met}.", *map(sentence, why)]


_CRITERIA = TypeAdapter(list[Criterion])


def _last_criteria(path: Path) -> list[Criterion] | None:
    """The criteria that a gate wrote down; None if none can be read."""
    try:
        return _CRITERIA.validate_python(orjson.loads(path.read_bytes())["criteria"])
    except (OSError, ValueError, KeyError, TypeError):
        return None
