"""Counts over many objects for the charts of the page and for the figures; no new scores."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from ...schemas.metric_catalogue import METRIC
from ...stages.arrays import IntArray
from ..results.quadrants import QUADRANTS, UNKNOWN
from .look import OUTCOME_COLOURS
from .run_frames import RunResults

#: The two scores that are drawn side by side.
SCORES = ("r_lambda", "cdc")
_BINS = 25
_FEWEST_IN_BOX = 3
_FATES = ("matched", "missing", "hallucinated")
_RANGE_BIN_M, _MOST_RANGE_BINS = 10.0, 12
_QUARTILES = {"q1": 0.25, "median": 0.5, "q3": 0.75}
_COLOURED = (0.02, 0.98)


def axis_title(score: str) -> str:
    """Label of the axis of a score: its heading and its best end."""
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
    """Name, number (n) and box plot statistics of both scores for each group of objects.

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


@dataclass(frozen=True)
class Bins:
    """Equal bins of the distance from the sensor, from 0.

    width : metres
    names : of the bins, such as "10 to 20 m"
    """

    width: float
    names: tuple[str, ...]

    @property
    def middles(self) -> list[float]:
        """The middle of each bin."""
        return [(i + 0.5) * self.width for i in range(len(self.names))]

    def index(self, objects: pd.DataFrame) -> IntArray:
        """The bin of each object, (n,) int32."""
        index: IntArray = np.floor(objects.range_m.to_numpy(dtype=float) / self.width).astype(np.int32)
        return index


def range_bins(results: RunResults) -> Bins:
    """Bins of 10 m from 0 to the farthest object; of 20, 30 ... m where those were more than twelve."""
    ranges_m = pd.concat([results.matched.range_m, results.unmatched.range_m])
    farthest_m = float(ranges_m.max()) if len(ranges_m) else 0.0
    width = _RANGE_BIN_M * max(1, math.ceil(farthest_m / (_RANGE_BIN_M * _MOST_RANGE_BINS)))
    lows = [width * i for i in range(math.floor(farthest_m / width) + 1)]
    return Bins(width, tuple(f"{low:g} to {low + width:g} m" for low in lows))


def binned_scores(results: RunResults, bins: Bins) -> dict[str, pd.DataFrame]:
    """By score and bin (of the real object): how many objects have the score (n), and its q1, median and q3.

    The median of fewer than three is given, their quartiles are NaN; without any all three are.
    """
    index, by_score = bins.index(results.matched), {}
    for score in SCORES:
        values = results.matched[score].astype(float).groupby(index)
        rows = pd.DataFrame({"n": values.count()} | {q: values.quantile(at) for q, at in _QUARTILES.items()})
        rows = rows.reindex(range(len(bins.names)))
        rows["n"] = rows.n.fillna(0).astype(int)
        rows.loc[rows.n < _FEWEST_IN_BOX, ["q1", "q3"]] = np.nan
        by_score[score] = rows.set_axis(bins.names)
    return by_score


def binned_fates(results: RunResults, bins: Bins) -> pd.DataFrame:
    """By bin: objects by fate, matched ones at their real side, and which share is missing and hallucinated.

    missing_share = missing / (matched + missing), hallucinated_share = hallucinated / (matched + hallucinated); NaN
    for sides without objects.
    """
    objects = pd.concat([results.matched.assign(status="matched"), results.unmatched], ignore_index=True)
    counts = pd.crosstab(pd.Series(bins.index(objects), name="bin"), objects.status)
    counts = counts.reindex(index=range(len(bins.names)), columns=list(_FATES), fill_value=0)
    for fate in ("missing", "hallucinated"):
        n_all = counts.matched + counts[fate]
        counts[f"{fate}_share"] = (counts[fate] / n_all).where(n_all > 0)
    return counts.set_axis(bins.names)


@dataclass(frozen=True)
class PairsInOrder:
    """The scored pairs along the sequence.

    has_times : whether the dataset says of each when it was taken; else they are in the order of their names
    rows : of `RunResults.pairs`, first to last, with `place`, seconds since the first one, or its number from 1
    """

    has_times: bool
    rows: pd.DataFrame


def along_the_sequence(results: RunResults, times_s: Mapping[str, float]) -> PairsInOrder:
    """The scored pairs by the time of their real scans, if that is known of each, else by name."""
    rows = results.pairs.assign(time_s=results.pairs.pair_id.map(times_s).astype(float))
    if rows.time_s.notna().all():
        rows = rows.sort_values(["time_s", "pair_id"], ignore_index=True)
        return PairsInOrder(True, rows.assign(place=rows.time_s - rows.time_s[0]))
    rows = rows.sort_values("pair_id", ignore_index=True)
    return PairsInOrder(False, rows.assign(place=np.arange(1.0, len(rows) + 1)))


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
