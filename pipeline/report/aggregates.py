"""What is drawn of many objects at once, counted here for the page (`charts`) and for the figures; no new score."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
import pandas as pd

from ...schemas.metrics import METRIC
from ...stages.statistics.findings import BAND_EDGES_M, BAND_NAMES
from ..results.quadrants import QUADRANTS, UNKNOWN
from .results import RunResults

#: The two scores that are drawn side by side.
SCORES = ("r_lambda", "cdc")
_BINS = 25
_FEWEST_IN_BOX = 3


def axis_title(score: str) -> str:
    """What stands along an axis of a score: its heading, and which end is the best."""
    return f"{METRIC[score].label} ({METRIC[score].scale})"


def histograms(results: RunResults) -> dict[str, dict[str, Any]]:
    """By score: counts in equal bins over its whole range, their edges, median, number with (n) and without a score.

    Where no object has a score, all counts are 0 and the median is None.
    """
    by_score = {}
    for score in SCORES:
        values = results.matched[score].dropna().to_numpy(dtype=float)
        counts, edges = np.histogram(values, bins=_BINS, range=(0.0, METRIC[score].high or 1.0))
        median = float(np.median(values)) if len(values) else None
        n_null = len(results.matched) - len(values)
        by_score[score] = {"counts": counts, "edges": edges, "median": median, "n": len(values), "n_null": n_null}
    return by_score


def quadrants(results: RunResults) -> dict[str, dict[str, Any]]:
    """By quadrant, and of the objects without a score: number (n) and share of the matched objects."""
    counts = results.matched.quadrant.value_counts()
    numbers = {key: int(counts.get(key, 0)) for key in (*QUADRANTS, UNKNOWN)}
    return {key: {"n": n, "share": n / max(1, len(results.matched))} for key, n in numbers.items()}


def evenly(n: int, most: int) -> list[int]:
    """Places of at most `most` of n things, evenly over their order, the first and the last among them.

    Examples
    --------
    >>> evenly(9, 3), evenly(2, 3), evenly(0, 3)
    ([0, 4, 8], [0, 1], [])
    """
    return list(map(int, np.unique(np.linspace(0, n - 1, min(n, most)).round())))


def boxes(results: RunResults, column: str, groups: Iterable[str]) -> list[dict[str, Any]]:
    """For each group of objects name, number (n), and what a box plot shows of both scores.

    By score med, q1, q3, whislo, whishi and fliers, as matplotlib calls them (whiskers at 1.5 quartile distances); None
    for fewer than three values.

    Parameters
    ----------
    column : of `RunResults.matched` to group by
    groups : values of that column, in the order of the boxes; one that no object has is left out
    """
    from matplotlib.cbook import boxplot_stats

    by_group = dict(list(results.matched.groupby(column)))
    made = []
    for name in groups:
        if name in by_group:
            values = {score: by_group[name][score].dropna().to_numpy(dtype=float) for score in SCORES}
            stats = {k: boxplot_stats(v)[0] if len(v) >= _FEWEST_IN_BOX else None for k, v in values.items()}
            made.append({"name": name, "n": len(by_group[name]), **stats})
    return made


def band_of(range_m: pd.Series[float]) -> pd.Series[Any]:
    """The band of distance from the sensor that each range is in, such as "10 to 20 m", in order."""
    return pd.cut(range_m, [*BAND_EDGES_M, math.inf], right=False, labels=list(BAND_NAMES))


def range_bands(results: RunResults) -> pd.DataFrame:
    """Objects by band (rows) and fate (matched, missing, hallucinated); matched ones count at their real side."""
    objects = pd.concat([results.matched.assign(status="matched")[["range_m", "status"]], results.unmatched])
    counts = pd.crosstab(band_of(objects.range_m), objects.status)
    return counts.reindex(columns=["matched", "missing", "hallucinated"], fill_value=0)


def stage_times(results: RunResults) -> pd.DataFrame:
    """By stage and step in the order of the pipeline: median over pairs of the `seconds` of both sides together."""
    times = results.timings[results.timings.pair_id.isin(results.pairs.pair_id)]
    order = [*results.run.record.stages, *times.stage]
    times = times.assign(stage=pd.Categorical(times.stage, list(dict.fromkeys(order))))
    per_pair = times.groupby(["stage", "step", "pair_id"], sort=False, observed=True).seconds.sum()
    median = per_pair.groupby(["stage", "step"], sort=False, observed=True).median()
    return median.reset_index().sort_values("stage", kind="stable")


def plain_rows(rows: pd.DataFrame, columns: Sequence[str]) -> list[list[Any]]:
    """Rows as lists of numbers, strings and None (for null), as JSON has them."""
    objects = rows[list(columns)].astype(object)
    lists: list[list[Any]] = objects.where(objects.notna(), None).to_numpy().tolist()
    return lists
