"""What a page holds of a whole run: data for its JavaScript, and the words and numbers that its template shows."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import pandas as pd

from ....schemas.metrics import METRIC
from ....schemas.results import RunRecord
from ..aggregates import SCORES, plain_rows
from ..charts import MOST_DOTS, MOST_SCANS, outlines, run_charts
from ..colours import FATE_COLOURS, GREY, RAMPS, SIDE_COLOURS, on_page
from ..names import STEERING
from ..results import RunResults
from ..verdict import limits_in_words, verdict_of
from .pair import FACTS, MATCHED_COLUMNS, UNMATCHED_COLUMNS, headings

#: More rows would make the page slow; the table then says what part it shows.
_MOST_ROWS = 5000
_MOST_FAILURES = 5
_DIGITS = 6  # of the tables; the panel of an object has all

_WORDS = ("pair_id", "object", "group", "quadrant", "status")
_SCORES = (
    "cdc", "r_lambda", "r_gap", "max_eigenvalue_shift", "laplacian_change", "alignment_rms_m", "centroid_distance_m",
)  # fmt: skip
_PAIR_COLUMNS = (
    *("pair_id", "n_matched", "n_missing", "n_hallucinated", "match_rate"),
    *(METRIC[score].mean_column for score in _SCORES),
)
_OBJECT_COLUMNS = (
    "object", "pair_id", "group", "quadrant", "status", "range_m", "n_real", "n_sim", "n_keep", *_SCORES
)  # fmt: skip


def page_data(results: RunResults) -> dict[str, Any]:
    """What the page's JavaScript reads of the whole run: charts, colours, tables; no points."""
    return {
        "steering": STEERING,
        "names": results.pairs.pair_id.tolist(),
        "charts": run_charts(results),
        "outlines": outlines(),
        "colours": {
            "sides": {side: on_page(colour) for side, colour in SIDE_COLOURS.items()},
            "fates": {fate: on_page(colour) for fate, colour in FATE_COLOURS.items()},
            "ramps": RAMPS,
            "none": GREY,
        },
        "scores": {score: {"name": METRIC[score].label, "bound": METRIC[score].high} for score in SCORES},
        "pairs": _table(results, results.pairs, _PAIR_COLUMNS)
        | {"note": "Worst first, by the mean of the ranks in match rate, CDC and r_lambda."},
        "objects": _objects(results),
        "facts": headings(results, FACTS),
        "matched_columns": MATCHED_COLUMNS,
        "unmatched_columns": UNMATCHED_COLUMNS,
    }


def page_words(results: RunResults) -> dict[str, Any]:
    """What the page's template shows of the whole run."""
    return {
        "title": results.run.folder.resolve().name,
        "verdict": verdict_of(results),
        "n_failures": len(results.failures),
        "failures": list(results.failures.items())[:_MOST_FAILURES],
        "notes": _notes(results),
        "settings": results.run.record.settings,
        "versions": _versions(results.run.record),
    }


def _table(results: RunResults, rows: pd.DataFrame, columns: Sequence[str]) -> dict[str, Any]:
    """A table with its columns; `up` is set where the lowest values are the worst."""
    described = [
        {
            "key": key,
            "title": title,
            "text": key in _WORDS,
            "up": key in METRIC and METRIC[key].higher_is_better,
            "digits": 1 if key == "range_m" else 3,
        }
        for key, title in headings(results, columns).items()
    ]
    return {"columns": described, "rows": plain_rows(rows.round(_DIGITS), columns)}


def _objects(results: RunResults) -> dict[str, Any]:
    """Rows of matched objects, worst first, then of unmatched ones, largest first."""
    matched, lone = results.matched, results.unmatched
    matched = matched.assign(object=matched.name + ", sim " + matched.sim_id.astype(str))
    counts = {f"n_{side}": lone.n_points.where(lone.side == side) for side in SIDE_COLOURS}
    both = pd.concat([matched, lone.assign(object=lone.name, **counts)])
    rows, n_all = both.head(_MOST_ROWS), len(both)
    cut = f" The page holds {len(rows):,} of {n_all:,}; the rest is in the run's tables." if len(rows) < n_all else ""
    return _table(results, rows, _OBJECT_COLUMNS) | {
        "note": "Worst first: matched objects by the mean of their ranks in CDC and r_lambda, then unmatched ones, "
        f"largest first.{cut}"
    }


def _notes(results: RunResults) -> dict[str, str]:
    """What stands under those charts that may show a part only."""
    n_pairs, n_matched, n_unmatched = len(results.pairs), len(results.matched), len(results.unmatched)
    n_scored = int(results.matched.r_lambda.notna().sum())
    kind = "class (label)" if results.class_is == "class" else "shape of the real object (the scans have no labels)"
    whiskers = (
        "Boxes: quartiles and median; whiskers to 1.5 times the quartile distance; in brackets, how many objects."
    )
    chosen = f"{MOST_SCANS} of {n_pairs}, evenly from worst to best" if n_pairs > MOST_SCANS else "worst first"
    dots = " objects are drawn, evenly over the order from worst to best; the counts are of all"
    seen = "Unmatched objects of all pairs around the sensor, at their centroids, seen from above."
    return {
        "quadrants": f"Limits: {limits_in_words()}.{_drawn(min(n_scored, MOST_DOTS), n_matched, dots)}",
        "polar": f"{seen}{_drawn(min(n_unmatched, MOST_DOTS), n_unmatched, ' are drawn, largest first')}",
        "box_scan": f"By scan, {chosen}. {whiskers}",
        "box_class": f"By {kind}, the most frequent first. {whiskers}",
    }


def _drawn(n: int, n_all: int, how: str) -> str:
    """Which part is drawn, "" if all is."""
    return f" {n:,} of {n_all:,}{how}." if n < n_all else ""


def _versions(record: RunRecord) -> dict[str, Any]:
    """By group, what made the run."""
    run = {name: getattr(record, name) for name in ("fidpipe", "written", "dataset", "seed", "workers")}
    run["seconds"] = round(record.wall_s["total"], 1)
    return {"": run, "stage version": record.stages, "library": record.libraries, "machine": record.machine.as_dict()}
