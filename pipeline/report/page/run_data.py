"""Content of a page about a whole run: data for its JavaScript and texts for its template."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from typing import Any

import pandas as pd

from ....schemas.columns import SIDES
from ....schemas.metric_catalogue import METRIC, metric_of
from ....stages.inspect.sensor_description import differences, sensor_lines
from ...results.compare import recorded_times_s
from ...results.diagnosis import gain_words, interval_words, read_diagnosis
from ...results.floor import RunExcess
from ...terminal import STEERING
from ..aggregates import along_the_sequence, plain_rows, score_limits, stage_times
from ..charts import MOST_DOTS, evidence_chart, run_charts
from ..look import PAGE_COLOURS, SIDE_COLOURS, SIGNED_RAMP_M
from ..pictures import FRAME
from ..run_frames import OBJECT_COVERAGE, OBJECT_ROAD, PairFrames, RunResults
from ..verdict import limits_in_words, verdict_of
from ..view import Table
from ..views.floor_view import excess_view
from ..views.run_view import preset_line, range_table
from .pair_data import FACTS, FAR_M, FIRST_FACTS, MATCHED_COLUMNS, SIGNED_M, UNMATCHED_COLUMNS

#: More rows would make the page slow; the table then says what part it shows.
_MOST_ROWS = 5000
_MOST_FAILURES = 5
_DIGITS = 6

_WORDS = ("pair_id", "object", "group", "quadrant", "status")
_SCORES = (
    "cdc", "r_lambda", "alignment_rms_m", "max_eigenvalue_shift", "laplacian_change", "r_gap", "centroid_distance_m",
)  # fmt: skip
_PAIR_COLUMNS = (
    *("pair_id", "n_matched", "n_missing", "n_hallucinated", "match_rate"),
    *(METRIC[score].mean_column for score in _SCORES),
    *OBJECT_COVERAGE,
)
_OBJECT_COLUMNS = (
    *("object", "pair_id", "group", "quadrant", "status", "range_m"),
    *(*_SCORES, "n_real", "n_sim", "n_keep", *OBJECT_COVERAGE),
)

#: Headings of columns without a score; other names are their own heading.
_HEADINGS = {
    "pair_id": "pair", "range_m": "range (m)", "bearing_deg": "bearing (°, left positive)", "n_points": "points",
    "n_real": "points, real", "n_sim": "points, simulated", "n_keep": "nodes kept",
    **dict(zip(OBJECT_ROAD, ("real, road on sim side", "sim, road on real side"), strict=True)),
    **{name: name for name in ("object", "quadrant", "status", "reason")},
}  # fmt: skip
#: Decimals of the properties of an object; metres are shown to the centimetre.
_FACT_DIGITS, _METRE_DIGITS = 3, 2


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
    pairs_note = "Worst first, by the mean of the ranks in match rate, CDC and r_lambda."
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
        "pairs": _table(results, results.pairs, _PAIR_COLUMNS, pairs_note),
        "objects": _objects(results),
        "facts": _facts(results),
        "first_facts": FIRST_FACTS,
        "matched_columns": MATCHED_COLUMNS,
        "unmatched_columns": UNMATCHED_COLUMNS,
    }


def page_words(results: RunResults, excess: RunExcess | None = None) -> dict[str, Any]:
    """Values of the whole run for the page's template: versions by group, and scores over a floor if any."""
    record, times = results.run.record, ("stage", "step", "seconds")
    return {
        "title": results.run.folder.resolve().name,
        "preset": preset_line(record),
        "verdict": verdict_of(results, excess),
        "frame": FRAME,
        "class_is": results.class_is,
        **_diagnosis(results),
        "failures": results.failures,
        "most_failures": _MOST_FAILURES,
        "notes": _notes(results),
        "floor": excess_view(excess) if excess else [],
        "sensors": _sensors(results),
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


def _diagnosis(results: RunResults) -> dict[str, Any]:
    """The run's diagnosis, None without one, and the gain of each cause as text."""
    found = read_diagnosis(results.run.folder, results.run.record)
    causes = found.causes if found else ()
    return {
        "diagnosis": found,
        "amounts": {cause.name: f"{interval_words(cause)}; {gain_words(cause)}".removesuffix("; ") for cause in causes},
    }


def _sensors(results: RunResults) -> dict[str, Any]:
    """Sensors of both sides, estimated from the first pair by name."""
    pair_id = results.pairs.pair_id.min()
    facts = PairFrames(results, pair_id).sensors
    lines = {side: sensor_lines(facts[side]) for side in SIDES}
    return {"pair_id": pair_id, "lines": lines, "differences": differences(facts["real"], facts["sim"])}


def _headings(results: RunResults, columns: Iterable[str]) -> dict[str, str]:
    """By column of a table of pairs or objects, its heading: of scores that of the catalogue, class or shape by run."""
    known = {**_HEADINGS, "group": results.class_is}
    headings = {column: known.get(column) or metric_of(column).label for column in columns}
    return {column: re.sub(r"(?<=\d) (?=m\b)", "\N{NO-BREAK SPACE}", heading) for column, heading in headings.items()}


def _facts(results: RunResults) -> dict[str, dict[str, Any]]:
    """Heading and decimals of each property of a chosen object."""
    return {
        key: {
            "title": title,
            "digits": 0 if key == "bearing_deg" else _METRE_DIGITS if key.endswith("_m") else _FACT_DIGITS,
        }
        for key, title in _headings(results, FACTS).items()
    }


def _table(results: RunResults, rows: pd.DataFrame, columns: Sequence[str], note: str) -> dict[str, Any]:
    """A table with its columns; `up` is set if the lowest values are the worst, `about` describes a score."""
    described = []
    for key, title in _headings(results, columns).items():
        metric = METRIC.get(key.removesuffix("_mean"))
        described.append(
            {
                "key": key,
                "title": title,
                "about": f"{key}: {metric.reading or metric.meaning}" if metric else "",
                "text": key in _WORDS,
                "up": metric is not None and metric.higher_is_better,
                "digits": 1 if key == "range_m" else 3,
            }
        )
    return {"columns": described, "rows": plain_rows(rows.round(_DIGITS), columns), "note": note}


def _objects(results: RunResults) -> dict[str, Any]:
    """Rows of matched objects, worst first, then of unmatched ones, largest first."""
    matched, lone = results.matched, results.unmatched
    matched = matched.assign(object=matched.name + ", sim " + matched.sim_id.astype(str))
    counts = {f"n_{side}": lone.n_points.where(lone.side == side) for side in SIDE_COLOURS}
    both = pd.concat([matched, lone.assign(object=lone.name, **counts)])
    order = "matched objects by the mean of their ranks in CDC and r_lambda, then unmatched ones, largest first"
    note = f"Worst first: {order}."
    if len(both) > _MOST_ROWS:
        note += f" The page holds {_MOST_ROWS:,} of {len(both):,}; the rest is in the run's tables."
    return _table(results, both.head(_MOST_ROWS), _OBJECT_COLUMNS, note)


def _notes(results: RunResults) -> dict[str, str]:
    """Notes below charts that may show only a part."""
    n_matched, n_unmatched = len(results.matched), len(results.unmatched)
    n_scored = int(results.matched.r_lambda.notna().sum())
    kind = "class (label)" if results.class_is == "class" else "shape of the real object (the scans have no labels)"
    dots = " objects are drawn, evenly over the order from worst to best; the counts are of all"
    binned = "Dots: medians; bars: the middle half of the objects, only for three or more; below, their number."
    order = (
        "by the time of the real scan"
        if along_the_sequence(results, recorded_times_s(results.run))[0]
        else "in the order of their names: the dataset does not say when the scans were taken"
    )
    seen = "Unmatched objects of all pairs around the sensor, at their centroids, seen from above."
    limits = f"Shares are of the matched objects. Limits: {limits_in_words()}. Grey: the distribution of each score."
    return {
        "quadrants": f"{limits}{_part(min(n_scored, MOST_DOTS), n_matched, dots)}",
        "polar": f"{seen}{_part(MOST_DOTS, n_unmatched, ' are drawn, largest first')}",
        "scores_class": f"By {kind}, the most frequent first. {binned}",
        "scores_range": f"Matched objects by the distance of the real one. {binned}",
        "sequence": f"Match rate and the mean scores of each pair, {order}.",
    }


def _part(most: int, n_all: int, how: str) -> str:
    """Description of the part shown, "" for everything."""
    return f" {most:,} of {n_all:,}{how}." if most < n_all else ""
