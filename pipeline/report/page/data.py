"""What the page holds of a run, as plain numbers and strings: the one object that its charts and tables are drawn from.

Leaves to others: points and spectra of a pair (`pair_view`), the page around it (`page`).
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ..aggregates import boxes, groups_by_size, histograms, plain_rows, range_bands, stage_times
from ..quadrants import CDC_LIMIT, QUADRANTS, R_LAMBDA_LIMIT, UNKNOWN
from ..results import RunResults
from ..verdict import limits_in_words, verdict_of
from .pair import MATCHED_COLUMNS, UNMATCHED_COLUMNS

#: More than these would make the page slow; the tables and charts then say what part they show.
_MOST_DOTS = 3000
_MOST_ROWS = 5000
_MOST_SCANS, _MOST_CLASSES, _MOST_FAILURES = 16, 10, 5
_DIGITS = 6  # of the tables; the panel of an object has all

_PAIR_COLUMNS = (
    "pair_id", "n_matched", "n_missing", "n_hallucinated", "match_rate", "cdc_mean", "r_lambda_mean", "r_gap_mean",
    "max_eigenvalue_shift_mean", "laplacian_change_mean", "alignment_rms_m_mean", "centroid_distance_m_mean",
)  # fmt: skip
_OBJECT_COLUMNS = (
    "object", "pair_id", "group", "quadrant", "status", "range_m", "n_real", "n_sim", "n_keep", "cdc", "r_lambda",
    "r_gap", "max_eigenvalue_shift", "laplacian_change", "alignment_rms_m", "centroid_distance_m",
)  # fmt: skip


def page_data(results: RunResults) -> dict[str, Any]:
    """All that the page says of the whole run; no points."""
    verdict = verdict_of(results)
    matched, unmatched = results.matched, results.unmatched
    dots = matched[matched.r_lambda.notna()]
    dots = dots.iloc[np.unique(np.linspace(0, len(dots) - 1, min(len(dots), _MOST_DOTS)).round().astype(int))]
    lone = unmatched.head(_MOST_DOTS)
    lone_ids = zip(
        lone.status, lone.range_m.round(2), lone.bearing_deg.round(1), lone.pair, lone.community_id, strict=True
    )
    quadrants = matched.quadrant.value_counts()
    return {
        "title": results.run.folder.resolve().name,
        "verdict": verdict.sentence,
        "weakest": verdict.weakest,
        "numbers": verdict.numbers,
        "failures": {"n": len(results.failures), "first": dict(list(results.failures.items())[:_MOST_FAILURES])},
        "names": results.pairs.pair_id.tolist(),
        "n_matched": len(matched),
        "class_is": results.class_is,
        "limits": {"cdc": CDC_LIMIT, "r_lambda": R_LAMBDA_LIMIT, "words": limits_in_words()},
        "quadrants": {
            key: {"title": title, "n": int(quadrants.get(key, 0))}
            for key, title in {**QUADRANTS, UNKNOWN: UNKNOWN}.items()
        },
        "histograms": histograms(results),
        "scatter": {
            "cdc": dots.cdc.round(4).tolist(),
            "r_lambda": dots.r_lambda.round(4).tolist(),
            "quadrant": dots.quadrant.tolist(),
            "pair": dots.pair.tolist(),
            "real_id": dots.real_id.tolist(),
        },
        "boxes": _boxes(results),
        "fates": {fate: int((unmatched.status == fate).sum()) for fate in ("missing", "hallucinated")},
        "unmatched_points": [list(row) for row in lone_ids],
        "bands": range_bands(results),
        "times": stage_times(results),
        "pairs": {
            "columns": _PAIR_COLUMNS,
            "rows": plain_rows(results.pairs.round(_DIGITS), _PAIR_COLUMNS),
            "note": "Worst first, by the mean of the ranks in match rate, CDC and r_lambda.",
        },
        "objects": _objects(results),
        "matched_columns": MATCHED_COLUMNS,
        "unmatched_columns": UNMATCHED_COLUMNS,
        "settings": results.run.record["settings"],
        "versions": _versions(results.run.record),
    }


def _boxes(results: RunResults) -> dict[str, Any]:
    """Boxes of some scans, evenly over the order from worst to best, and of the most frequent classes."""
    names = results.pairs.pair_id.tolist()
    some = np.unique(np.linspace(0, len(names) - 1, min(len(names), _MOST_SCANS)).round().astype(int))
    classes = groups_by_size(results)
    kind = "class (label)" if results.class_is == "label" else "shape of the real object (the scans have no labels)"
    whiskers = (
        "Boxes: quartiles and median; whiskers to 1.5 times the quartile distance; in brackets, how many objects."
    )
    chosen = f", {len(some)} of {len(names)}, evenly from worst to best" if len(some) < len(names) else ", worst first"
    return {
        "scan": boxes(results, "pair_id", [names[i] for i in some]),
        "scan_note": f"By scan{chosen}. {whiskers}",
        "class": boxes(results, "group", classes[:_MOST_CLASSES]),
        "class_note": f"By {kind}, the most frequent first. {whiskers}",
    }


def _objects(results: RunResults) -> dict[str, Any]:
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
        "columns": _OBJECT_COLUMNS,
        "rows": plain_rows(matched.round(_DIGITS), _OBJECT_COLUMNS) + plain_rows(lone.round(_DIGITS), _OBJECT_COLUMNS),
        "note": "Worst first: matched objects by the mean of their ranks in CDC and r_lambda, then unmatched ones, "
        f"largest first.{cut}",
    }


def _versions(record: dict[str, Any]) -> dict[str, Any]:
    run = {
        "fidpipe": record["fidpipe"],
        "written": record["written"],
        "dataset": record["dataset"],
        "seed": record["seed"],
        "workers": record["workers"],
        "seconds": round(record["wall_s"]["total"], 1),
    }
    return {"": run, "stage version": record["stages"], "library": record["libraries"], "machine": record["machine"]}
