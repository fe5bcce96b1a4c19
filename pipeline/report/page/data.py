"""What a page holds of a whole run: data for its JavaScript, and the words and numbers that its template shows."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from ....schemas.results import RunRecord
from ..aggregates import SCORES, plain_rows
from ..charts import MOST_DOTS, MOST_SCANS, outlines, run_charts
from ..colours import FATE_COLOURS, GREY, RAMPS, SIDE_COLOURS, on_page
from ..names import STEERING
from ..results import RunResults
from ..verdict import limits_in_words, verdict_of
from .pair import FACTS, MATCHED_COLUMNS, UNMATCHED_COLUMNS

#: More rows would make the page slow; the table then says what part it shows.
_MOST_ROWS = 5000
_MOST_FAILURES = 5
_DIGITS = 6  # of the tables; the panel of an object has all

#: Headings of the tables' columns; those of words, and one of which more is better.
_TITLES = {
    "pair_id": "pair", "object": "object", "quadrant": "quadrant", "status": "status", "n_matched": "matched",
    "n_missing": "missing", "n_hallucinated": "hallucinated", "match_rate": "match rate", "range_m": "range m",
    "n_real": "points real", "n_sim": "points sim", "n_keep": "nodes", "cdc": "CDC", "r_lambda": "r_lambda",
    "r_gap": "r_gap", "max_eigenvalue_shift": "shift", "laplacian_change": "change", "alignment_rms_m": "alignment m",
    "centroid_distance_m": "offset m",
}  # fmt: skip
_WORDS = ("pair_id", "object", "group", "quadrant", "status")
_HIGH_IS_GOOD = "match_rate"
_PAIR_COLUMNS = (
    "pair_id", "n_matched", "n_missing", "n_hallucinated", "match_rate", "cdc_mean", "r_lambda_mean", "r_gap_mean",
    "max_eigenvalue_shift_mean", "laplacian_change_mean", "alignment_rms_m_mean", "centroid_distance_m_mean",
)  # fmt: skip
_OBJECT_COLUMNS = (
    "object", "pair_id", "group", "quadrant", "status", "range_m", "n_real", "n_sim", "n_keep", "cdc", "r_lambda",
    "r_gap", "max_eigenvalue_shift", "laplacian_change", "alignment_rms_m", "centroid_distance_m",
)  # fmt: skip


def page_data(results: RunResults) -> dict[str, Any]:
    """What the page's JavaScript reads of the whole run: charts, colours, tables; no points."""
    class_is = "class" if results.class_is == "label" else "shape"
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
        "scores": {score: {"name": name, "bound": bound} for score, (name, bound) in SCORES.items()},
        "pairs": {
            "columns": _columns(_PAIR_COLUMNS, class_is),
            "rows": plain_rows(results.pairs.round(_DIGITS), _PAIR_COLUMNS),
            "note": "Worst first, by the mean of the ranks in match rate, CDC and r_lambda.",
        },
        "objects": _objects(results, class_is),
        "facts": {**FACTS, "group": class_is},
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


def _columns(keys: Iterable[str], class_is: str) -> list[dict[str, Any]]:
    titles = {**_TITLES, "group": class_is}
    return [
        {
            "key": key,
            "title": titles[key.removesuffix("_mean")],
            "text": key in _WORDS,
            "up": key == _HIGH_IS_GOOD,
            "digits": 1 if key == "range_m" else 3,
        }
        for key in keys
    ]


def _objects(results: RunResults, class_is: str) -> dict[str, Any]:
    """Rows of matched objects, worst first, then of unmatched ones, largest first."""
    matched = results.matched.head(_MOST_ROWS)
    matched = matched.assign(
        object=[f"real {a}, sim {b}" for a, b in zip(matched.real_id, matched.sim_id, strict=True)]
    )
    lone = results.unmatched.head(_MOST_ROWS - len(matched))
    is_real = lone.side == "real"
    lone = lone.assign(
        object=[f"{side} {i}" for side, i in zip(lone.side, lone.community_id, strict=True)],
        n_real=lone.n_points.where(is_real).astype("Int64"),
        n_sim=lone.n_points.where(~is_real).astype("Int64"),
        quadrant=None,
    )
    lone = lone.reindex(columns=_OBJECT_COLUMNS)
    n_all = len(results.matched) + len(results.unmatched)
    n_rows = len(matched) + len(lone)
    cut = f" The page holds {n_rows:,} of {n_all:,}; the rest is in the run's tables." if n_rows < n_all else ""
    return {
        "columns": _columns(_OBJECT_COLUMNS, class_is),
        "rows": plain_rows(matched.round(_DIGITS), _OBJECT_COLUMNS) + plain_rows(lone.round(_DIGITS), _OBJECT_COLUMNS),
        "note": "Worst first: matched objects by the mean of their ranks in CDC and r_lambda, then unmatched ones, "
        f"largest first.{cut}",
    }


def _notes(results: RunResults) -> dict[str, str]:
    """What stands under those charts that may show a part only."""
    n_pairs, n_matched, n_unmatched = len(results.pairs), len(results.matched), len(results.unmatched)
    n_scored = int(results.matched.r_lambda.notna().sum())
    kind = "class (label)" if results.class_is == "label" else "shape of the real object (the scans have no labels)"
    whiskers = (
        "Boxes: quartiles and median; whiskers to 1.5 times the quartile distance; in brackets, how many objects."
    )
    chosen = f"{MOST_SCANS} of {n_pairs}, evenly from worst to best" if n_pairs > MOST_SCANS else "worst first"
    return {
        "quadrants": f"Limits: {limits_in_words()}."
        + _drawn(
            min(n_scored, MOST_DOTS), n_matched,
            " objects are drawn, evenly over the order from worst to best; the counts are of all",
        ),
        "polar": "Unmatched objects of all pairs around the sensor, at their centroids, seen from above."
        + _drawn(min(n_unmatched, MOST_DOTS), n_unmatched, " are drawn, largest first"),
        "box_scan": f"By scan, {chosen}. {whiskers}",
        "box_class": f"By {kind}, the most frequent first. {whiskers}",
    }  # fmt: skip


def _drawn(n: int, n_all: int, how: str) -> str:
    """Which part is drawn, "" if all is."""
    return f" {n:,} of {n_all:,}{how}." if n < n_all else ""


def _versions(record: RunRecord) -> dict[str, Any]:
    """By group, what made the run."""
    run = {
        "fidpipe": record.fidpipe,
        "written": record.written,
        "dataset": record.dataset,
        "seed": record.seed,
        "workers": record.workers,
        "seconds": round(record.wall_s["total"], 1),
    }
    return {"": run, "stage version": record.stages, "library": record.libraries, "machine": record.machine.as_dict()}
