"""Checks that every score is within its bounds, and that a score that is null has a reason."""

import warnings

import numpy as np

from fidpipe import evaluate_pair
from fidpipe.schemas.metric_catalogue import METRIC

#: Settings under which every finite point is kept.
KEEP_ALL = {"input": {"min_range_m": 0, "max_range_m": 1e9}, "ground": {"method": "none"}}
_PAIR_TABLES = ("metrics", "matching", "coverage", "surface", "selection", "baselines", "seeds")


def evaluated(real, sim, settings):
    """The result of a pair, without the warning that its sides are in different frames."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "the simulated scan")
        return evaluate_pair(real, sim, settings)


def faults_of(result):
    """Faults of a `PairResult`; empty if all its values are possible."""
    faults = []
    for name, value in result.summary.items():
        if isinstance(value, float):
            faults += faults_of_column(name, [value])
    tables = [getattr(result, name) for name in _PAIR_TABLES]
    tables += [*result.points.values(), *result.edges.values(), *result.objects.values()]
    for table in tables:
        if table is not None:
            faults += faults_of_table(table)
    return faults


def faults_of_table(table):
    """Faults of the columns of a table, a data frame."""
    faults = []
    for name, column in table.select_dtypes("number").items():
        faults += faults_of_column(name, column.dropna())
    for name in ("r_lambda", "value"):
        if not {name, "reason"} <= set(table):
            continue
        if (table[name].isna() & table["reason"].isna()).any():
            faults.append(f"{name}: null without a reason")
    return faults


def faults_of_column(name, values):
    """Faults of known values of a column: infinite, or outside the bounds of the score."""
    values = np.asarray(values, dtype=np.float64)
    if not np.isfinite(values).all():
        return [f"{name}: infinite or not a number"]
    metric = METRIC.get(name) or METRIC.get(name.removesuffix("_mean"))
    if metric is None or not len(values):
        return []
    is_too_low = metric.low is not None and values.min() < metric.low
    is_too_high = metric.high is not None and values.max() > metric.high
    if is_too_low or is_too_high:
        expected = f"{metric.low} to {metric.high}"
        return [f"{name}: expected {expected}, got {values.min()} to {values.max()}"]
    return []
