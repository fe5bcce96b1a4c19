"""What is drawn of many objects at once: histograms, quadrants, boxes, counts by range band, seconds by step.

Plain numbers, counted once for the page (`charts`) and for the figures; counts and quantiles of finished scores, no new
score.
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
from .quadrants import QUADRANTS, UNKNOWN
from .results import RunResults

#: The two scores that are drawn side by side: column, its name in words, and its upper bound.
SCORES = {"r_lambda": ("structure: r_lambda", 1.0), "cdc": ("geometry: CDC", 2.0)}
_BINS = 25
_FEWEST_IN_BOX = 3


def histograms(results: RunResults) -> dict[str, dict[str, Any]]:
    """Of each score: counts in equal bins over its whole range, median, and how many objects have no score.

    Where no object has a score, all counts are 0 and the median is None.
    """
    by_score = {}
    for column, (name, bound) in SCORES.items():
        values = results.matched[column].dropna().to_numpy(dtype=float)
        counts, edges = np.histogram(values, bins=_BINS, range=(0, bound))
        by_score[column] = {
            "name": name,
            "bound": bound,
            "edges": edges.tolist(),
            "counts": counts.tolist(),
            "shares": (counts / max(1, len(values))).tolist(),
            "median": float(np.median(values)) if len(values) else None,
            "n": len(values),
            "n_null": int(results.matched[column].isna().sum()),
        }
    return by_score


def quadrants(results: RunResults) -> dict[str, dict[str, Any]]:
    """Of each quadrant, and of the objects without a score: title, number and share of the matched objects."""
    counts = results.matched.quadrant.value_counts()
    return {
        key: {"title": title, "n": int(counts.get(key, 0)), "share": counts.get(key, 0) / max(1, len(results.matched))}
        for key, title in {**QUADRANTS, UNKNOWN: UNKNOWN}.items()
    }


def evenly(n: int, most: int) -> list[int]:
    """Places of at most `most` of n things, evenly over their order, the first and the last among them.

    Examples
    --------
    >>> evenly(9, 3), evenly(2, 3), evenly(0, 3)
    ([0, 4, 8], [0, 1], [])
    """
    places: list[int] = np.unique(np.linspace(0, n - 1, min(n, most)).round().astype(int)).tolist()
    return places


def boxes(results: RunResults, column: str, groups: Sequence[str]) -> list[dict[str, Any]]:
    """For each group of objects, the five numbers of a box plot of both scores (whiskers at 1.5 quartile distances).

    Parameters
    ----------
    column : of `RunResults.matched` to group by
    groups : values of that column, in the order of the boxes; one that no object has is left out

    Returns
    -------
    list
        `name`, `n`, and for each score q1, median, q3, low, high, outside; None for fewer than three values
    """
    by_group = dict(list(results.matched.groupby(column)))
    made = []
    for group in groups:
        rows = by_group.get(group)
        if rows is None:
            continue
        box = {"name": group, "n": len(rows)}
        box |= {score: _box(rows[score].dropna().to_numpy(dtype=float)) for score in SCORES}
        made.append(box)
    return made


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
        counts = {fate: int(((range_m >= low) & (range_m < high)).sum()) for fate, range_m in ranges.items()}
        if sum(counts.values()):
            bands.append({"name": name, **counts})
    return bands


def stage_times(results: RunResults) -> list[dict[str, Any]]:
    """By stage and step in the order of the pipeline: median over pairs of the seconds of both sides together."""
    times = results.timings[results.timings.pair_id.isin(results.pairs.pair_id)]
    per_pair = times.groupby(["stage", "step", "pair_id"], sort=False).seconds.sum()
    median = per_pair.groupby(["stage", "step"], sort=False).median().reset_index()
    order = list(results.run.record.stages)
    rows = [dict(zip(median.columns, row, strict=True)) for row in plain_rows(median, median.columns.tolist())]
    return sorted(rows, key=lambda row: order.index(row["stage"]) if row["stage"] in order else len(order))


def plain_rows(rows: pd.DataFrame, columns: Sequence[str]) -> list[list[Any]]:
    """Rows as lists of numbers, strings and None (for null), as JSON has them."""
    lists = (rows[column].tolist() for column in columns)
    return [[None if _is_null(value) else value for value in row] for row in zip(*lists, strict=True)]


def _is_null(value: Any) -> bool:
    return value is None or value is pd.NA or (isinstance(value, float) and math.isnan(value))
