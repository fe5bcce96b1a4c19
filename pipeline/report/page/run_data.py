"""Content of a page about a whole run: data for its JavaScript and texts for its template."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Any

import pandas as pd

from ....schemas.columns import SIDES
from ....schemas.metric_catalogue import METRIC, metric_of
from ....stages.inspect.sensor_description import differences, pair_columns, sensor_lines
from ...results.causes import with_tolerance
from ...results.diagnosis import gain_words, interval_words, read_diagnosis
from ...results.floor import RunExcess
from ...results.quadrants import CDC_LIMIT, R_LAMBDA_LIMIT
from ...terminal import STEERING
from ..aggregates import along_the_sequence, plain_rows, score_limits, stage_times
from ..charts import MOST_DOTS, evidence_chart, run_charts
from ..look import PAGE_COLOURS, SIGNED_RAMP_M
from ..pictures import FRAME
from ..run_frames import OBJECT_COVERAGE, OBJECT_ROAD, RunResults, frames_of
from ..verdict import verdict_of
from ..view import Table
from ..views.floor_view import excess_view
from ..views.run_view import preset_line, range_table
from .pair_data import FACTS, FAR_M, OBJECT_COLUMNS, SIGNED_M

#: More rows would make the page slow; the table then says what part it shows.
_MOST_ROWS = 5000
_MOST_FAILURES = 5
_DIGITS = 6

_WORDS = ("pair_id", "object", "group", "quadrant", "status")
_SCORES = (
    "cdc", "r_lambda", "alignment_rms_m", "max_eigenvalue_shift", "laplacian_change", "r_gap", "centroid_distance_m",
)  # fmt: skip
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
    found = read_diagnosis(results.run.folder, results.run.record)
    # Causes with the same curves show them once.
    evidence = {
        cause.evidence.model_dump_json(): (cause.name, cause.evidence)
        for cause in reversed(found.causes if found else ())
        if cause.evidence
    }
    charts = run_charts(results) | {f"cause_{name}": evidence_chart(curves) for name, curves in evidence.values()}
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
    return {"keys": keys, "rows": plain_rows(rows.round(_DIGITS), keys), "note": note}


def page_words(results: RunResults, excess: RunExcess | None = None) -> dict[str, Any]:
    """Values of the whole run for the page's template: versions by group, and scores over a floor if any."""
    record, times = results.run.record, ("stage", "step", "seconds")
    found = read_diagnosis(results.run.folder, record)
    causes = found.causes if found else ()
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
        "diagnosis": found,
        "amounts": {cause.name: f"{interval_words(cause)}; {gain_words(cause)}".removesuffix("; ") for cause in causes},
        "failures": results.failures,
        "most_failures": _MOST_FAILURES,
        "floor": excess_view(excess) if excess else [],
        "sensor_pair": sensor_pair,
        "sensors": {side: sensor_lines(sensors[side]) for side in SIDES},
        "sensor_differences": with_tolerance(
            differences(sensors["real"], sensors["sim"]),
            pair_columns(sensors["real"], "real") | pair_columns(sensors["sim"], "sim"),
        ),
        "ranges": [range_table(record.findings)] if record.findings else [],
        "times": Table("", times, plain_rows(stage_times(results), times), words=(0, 1)),
        "settings": record.settings,
        "versions": {
            "": {name: getattr(record, name) for name in ("fidpipe", "written", "dataset", "seed", "workers")}
            | {"seconds": round(record.wall_s["total"], 1)},
            "stage version": record.stages,
            "library": record.libraries,
            "machine": record.machine.as_dict(),
        },
    }
