"""Counts over many objects for the charts of the page and for the figures; no new scores."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd

from ...schemas.metric_catalogue import METRIC
from ..results.quadrants import QUADRANTS, UNKNOWN
from .look import OUTCOME_COLOURS
from .run_frames import RunResults

#: The two scores that are drawn side by side.
SCORES = ("r_lambda", "cdc")
#: Fewer objects have no quartiles.
FEWEST_IN_BOX = 3
_RANGE_BIN_M, _MOST_RANGE_BINS = 10.0, 12
_QUARTILES = {"q1": 0.25, "median": 0.5, "q3": 0.75}
_COLOURED = (0.02, 0.98)


def axis_title(score: str) -> str:
    """Label of the axis of a score: its heading and its best end."""
    return f"{METRIC[score].label} ({METRIC[score].scale})"


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


def ray_outcomes(results: RunResults) -> pd.DataFrame:
    """Shares of the outcomes of rays (columns) by range (rows, near to far), and `n_rays`, over the scored pairs."""
    outcomes = {f"rays_{name}": name for name in OUTCOME_COLOURS}
    part = {("ray_scores", ""): ["by", "band", "n_rays", *outcomes]}
    table, _ = results.run.store.read_pairs(results.pairs.pair_id.tolist(), part)["ray_scores", ""]
    rows = table.to_pandas().query("by == 'range'").set_index("band").rename(columns=outcomes)
    rows[[*OUTCOME_COLOURS]] = rows[[*OUTCOME_COLOURS]].mul(rows.n_rays, axis=0)
    total: pd.DataFrame = rows.drop(columns="by").groupby(level=0, sort=False).sum()
    total = total.loc[sorted(total.index, key=lambda band: float(band.removeprefix("over ").split()[0]))]
    total[[*OUTCOME_COLOURS]] = total[[*OUTCOME_COLOURS]].div(total.n_rays, axis=0)
    return total


def range_bins(objects: pd.DataFrame) -> tuple[list[str], pd.Series]:
    """Names of bins of the distance from the sensor, and the bin of each object.

    Bins of 10 m from 0 to the farthest object; of 20, 30 ... m where those were more than twelve.
    """
    farthest_m = float(objects.range_m.max()) if len(objects) else 0.0
    width = _RANGE_BIN_M * max(1, math.ceil(farthest_m / (_RANGE_BIN_M * _MOST_RANGE_BINS)))
    lows = [width * i for i in range(math.floor(farthest_m / width) + 1)]
    names = [f"{low:g} to {low + width:g} m" for low in lows]
    return names, (objects.range_m // width).astype(int).map(dict(enumerate(names)))


def score_spread(matched: pd.DataFrame, group: pd.Series, names: list[str]) -> dict[str, pd.DataFrame]:
    """By score, for each named group of objects: how many have the score (n), and its q1, median and q3.

    Fewer than three have no quartiles (NaN), none have no median.
    """
    by_score = {}
    for score in SCORES:
        values = matched[score].astype(float).groupby(group)
        rows = pd.DataFrame({"n": values.count()} | {q: values.quantile(at) for q, at in _QUARTILES.items()})
        rows = rows.reindex(names)
        rows["n"] = rows.n.fillna(0).astype(int)
        rows.loc[rows.n < FEWEST_IN_BOX, ["q1", "q3"]] = np.nan
        by_score[score] = rows
    return by_score


def along_the_sequence(results: RunResults, times_s: Mapping[str, float]) -> tuple[bool, pd.DataFrame]:
    """The scored pairs by the time of their real scans if known of each (then True), else by name.

    Their `place` is the number of seconds since the first one, or their number from 1.
    """
    rows = results.pairs.assign(time_s=results.pairs.pair_id.map(times_s).astype(float))
    has_times = bool(rows.time_s.notna().all())
    rows = rows.sort_values(["time_s", "pair_id"] if has_times else "pair_id", ignore_index=True)
    return has_times, rows.assign(place=rows.time_s - rows.time_s[0] if has_times else np.arange(1.0, len(rows) + 1))


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


def plain_rows(rows: pd.DataFrame, columns: Sequence[str]) -> list[list[Any]]:
    """Rows as lists of numbers, strings and None (for null), as JSON has them."""
    objects = rows[list(columns)].astype(object)
    lists: list[list[Any]] = objects.where(objects.notna(), None).to_numpy().tolist()
    return lists
