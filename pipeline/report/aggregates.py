"""What is drawn of many objects at once: histograms, boxes, shares by range band, seconds by step. Plain numbers.

Counts and quantiles of finished scores, no new score. Leaves to others: drawing (`figures`, `assets/charts.js`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import numpy as np
import pandas as pd

from ...stages.arrays import FloatArray
from ...stages.statistics.findings import BAND_EDGES_M
from .results import RunResults

#: The two scores that are drawn side by side: column, its name in words, and its upper bound.
SCORES = {"r_lambda": ("structure: r_lambda", 1.0), "cdc": ("geometry: CDC", 2.0)}
_BINS = 25
_FEWEST_IN_BOX = 3


def histograms(results: RunResults) -> dict[str, dict[str, Any]]:
    """Of each score: counts in equal bins over its whole range, median, and how many objects have no score."""
    found = {}
    for column, (name, bound) in SCORES.items():
        values = results.matched[column].dropna().to_numpy(dtype=float)
        counts, edges = np.histogram(values, bins=_BINS, range=(0, bound))
        found[column] = {
            "name": name,
            "bound": bound,
            "edges": edges.tolist(),
            "counts": counts.tolist(),
            "median": float(np.median(values)) if len(values) else None,
            "n": len(values),
            "n_null": int(results.matched[column].isna().sum()),
        }
    return found


def boxes(results: RunResults, column: str, groups: Sequence[str]) -> list[dict[str, Any]]:
    """For each group of objects, the five numbers of a box plot of both scores (whiskers at 1.5 quartile distances).

    Parameters
    ----------
    column : of `RunResults.matched` to group by
    groups : values of that column, in the order of the boxes
    """
    by_group = dict(list(results.matched.groupby(column)))
    found = []
    for group in groups:
        rows = by_group.get(group)
        if rows is None:
            continue
        box = {"name": group, "n": len(rows)}
        box |= {score: _box(rows[score].dropna().to_numpy(dtype=float)) for score in SCORES}
        found.append(box)
    return found


def _box(values: FloatArray) -> dict[str, Any] | None:
    if len(values) < _FEWEST_IN_BOX:
        return None
    q1, median, q3 = np.quantile(values, [0.25, 0.5, 0.75])
    inside = values[(values >= q1 - 1.5 * (q3 - q1)) & (values <= q3 + 1.5 * (q3 - q1))]
    return {
        "q1": q1,
        "median": median,
        "q3": q3,
        "low": float(inside.min()),
        "high": float(inside.max()),
        "outside": np.sort(values[(values < inside.min()) | (values > inside.max())]).tolist(),
    }


def groups_by_size(results: RunResults) -> list[str]:
    """Classes (or shapes) of the matched objects, the most frequent first."""
    return [str(name) for name in results.matched.group.value_counts().index]


def range_bands(results: RunResults) -> list[dict[str, Any]]:
    """By distance of the centroid from the sensor: objects of each fate; matched ones count at their real side."""
    ranges = {
        "matched": results.matched.range_m,
        **{fate: results.unmatched.range_m[results.unmatched.status == fate] for fate in ("missing", "hallucinated")},
    }
    bands = []
    for low, high in pairwise((*BAND_EDGES_M, math.inf)):
        name = f"{low:.0f} to {high:.0f} m" if math.isfinite(high) else f"over {low:.0f} m"
        counts = {fate: int(((of >= low) & (of < high)).sum()) for fate, of in ranges.items()}
        if sum(counts.values()):
            bands.append({"name": name, **counts})
    return bands


def stage_times(results: RunResults) -> list[dict[str, Any]]:
    """By stage and step in the order of the pipeline: median over pairs of the seconds of both sides together."""
    times = results.timings[results.timings.pair_id.isin(results.pairs.pair_id)]
    per_pair = times.groupby(["stage", "step", "pair_id"], sort=False).seconds.sum()
    median = per_pair.groupby(["stage", "step"], sort=False).median().reset_index()
    order = list(results.run.record["stages"])
    rows = [dict(zip(median.columns, row, strict=True)) for row in plain_rows(median, median.columns.tolist())]
    return sorted(rows, key=lambda row: order.index(row["stage"]) if row["stage"] in order else len(order))


def plain_rows(rows: pd.DataFrame, columns: Sequence[str]) -> list[list[Any]]:
    """Rows as lists of numbers, strings and None (for null), as JSON has them."""
    lists = (rows[column].tolist() for column in columns)
    return [[None if _is_null(value) else value for value in row] for row in zip(*lists, strict=True)]


def _is_null(value: Any) -> bool:
    return value is None or value is pd.NA or (isinstance(value, float) and math.isnan(value))
