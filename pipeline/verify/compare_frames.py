"""Comparison of a stored table with the recomputed one, with one rule per column."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from ...schemas.metric_catalogue import SHIFT_COLUMNS
from ...stages.arrays import BoolArray, FloatArray

#: Tolerance of every number without a rule: metres, shares, eigenvalues. Counts and ids are exact all the same.
DEFAULT_TOLERANCE = 1e-9
_RELATIVE = 1e-12
MERGE_GAIN = "modularity gained by joining two communities"

#: By `table.column` or `table`: the absolute tolerance if it is not the default, or why it is not recomputed.
RULES: dict[str, float | str] = {
    "ground.intensity": 0.0,
    "graph.length_m": 0.0,
    # stored with nine decimals: two roundings may be one step apart
    "selection.real_influence": 1.5e-9,
    "selection.sim_influence": 1.5e-9,
    **{f"surface.{name}": 1e-8 for name in SHIFT_COLUMNS},
    # scikit-network's Louvain computes in single precision
    f"communities.{MERGE_GAIN}": 1e-5,
    # the arccosine is steep where the axis is upright
    "ground.metadata tilt_deg": 1e-5,
    "pairs.ground_real_tilt_deg": 1e-5,
    "pairs.ground_sim_tilt_deg": 1e-5,
    "baselines.reason": "text for people",
    "nvs.reason": "text for people",
    "pairs.reason": "why a pair failed: it is not tried again",
    "timings": "seconds of a clock",
}
#: Columns and tables that are not recomputed, and why.
NOT_COMPARED = {name: rule for name, rule in RULES.items() if isinstance(rule, str)}


@dataclass(frozen=True)
class ColumnComparison:
    """Stored and recomputed values of one column.

    rows : keys of the values
    difference : (n,) float64, absolute; 0 for text, and if one value is null
    is_wrong : (n,) True if the values differ by more than the tolerance
    """

    column: str
    rows: pd.Index[Any]
    stored: Any
    recomputed: Any
    difference: FloatArray
    is_wrong: BoolArray


def compare(
    table: str, stored: pd.DataFrame, recomputed: pd.DataFrame, *, is_whole: bool = True
) -> Iterator[ColumnComparison]:
    """Compare the rows of two frames by their index, then each recomputed column; null equals null.

    Parameters
    ----------
    table : name for the rules
    stored, recomputed : frames with the same keys as index
    is_whole : the stored frame must have the recomputed rows and no others; otherwise at least these
    """
    if not stored.index.equals(recomputed.index):
        is_twice = stored.index.duplicated()
        is_surplus = is_twice | ~stored.index.isin(recomputed.index) if is_whole else np.zeros(len(stored), dtype=bool)
        is_missing = ~recomputed.index.isin(stored.index)
        for rows, words in (
            (stored.index[is_surplus], ("present", "absent")),
            (recomputed.index[is_missing], ("absent", "present")),
        ):
            if len(rows):
                a, b = (np.full(len(rows), word, dtype=object) for word in words)
                yield ColumnComparison("row", rows, a, b, np.zeros(len(rows)), np.ones(len(rows), dtype=bool))
        recomputed = recomputed[~is_missing]
        stored = stored[~is_twice].reindex(recomputed.index)
    for name in stored.index.names if is_whole else ():
        if name is not None:
            key = recomputed.index.get_level_values(str(name)).to_numpy()
            yield ColumnComparison(str(name), recomputed.index, key, key, np.zeros(len(key)), np.zeros(len(key), bool))
    for column in recomputed.columns:
        tolerance = RULES.get(f"{table}.{column}", DEFAULT_TOLERANCE)
        assert isinstance(tolerance, float), f"{table}.{column} is recomputed though a rule says it is not"
        yield _compare_column(column, stored[column], recomputed[column], tolerance)


def _compare_column(
    name: str, stored: pd.Series[Any], recomputed: pd.Series[Any], tolerance: float
) -> ColumnComparison:
    a, b = _values(stored), _values(recomputed)
    if object in (a.dtype, b.dtype):
        is_wrong = np.array([x != y for x, y in zip(a.tolist(), b.tolist(), strict=True)], dtype=np.bool_)
        return ColumnComparison(name, recomputed.index, a, b, np.zeros(len(a)), is_wrong)
    difference = np.abs(a - b)
    allowed = tolerance + _RELATIVE * np.abs(b) if tolerance else 0.0
    is_wrong = ~((np.isnan(a) & np.isnan(b)) | (difference <= allowed))
    return ColumnComparison(name, recomputed.index, a, b, np.nan_to_num(difference), is_wrong)


def _values(column: pd.Series[Any]) -> Any:
    """Numbers as float64 with NaN for null; text as objects with None for null."""
    if pd.api.types.is_numeric_dtype(column.dtype):  # flags too
        return column.to_numpy(dtype=np.float64)
    values = column.to_numpy(dtype=object, copy=True)
    values[pd.isna(values)] = None
    return values if any(isinstance(value, str) for value in values) else values.astype(np.float64)
