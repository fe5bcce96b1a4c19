"""The tables of a finished run as a report reads them: one frozen object, checked before anything is drawn."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from fnmatch import fnmatchcase
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from ...schemas.columns import SIDES
from ...schemas.errors import RunError
from ...schemas.tables import PAIRS
from ..results.finished import FinishedRun
from ..results.tables import check_tables, read_table
from .quadrants import quadrant_of

SHAPES = ("linear", "planar", "scattered")
_SHAPE_COLUMNS = ["linearity", "planarity", "scattering"]
_PLACE = ["n_points", "range_m", "bearing_deg", "cx", "cy", "cz", "extent_x", "extent_y", "extent_z"]


@dataclass(frozen=True)
class RunResults:
    """A finished run.

    run : its folder, its record (`run.json`), and where single tables are read from
    pairs : `pairs.parquet`, the scored pairs only, worst first
    failures : why each failed pair failed
    matched : `metrics` with place and class of the real object, `quadrant`, and the position of its pair; worst first
    unmatched : `objects` that only one side has, with `status`; largest first
    timings : `timings.parquet`
    class_is : "label" where the scans are labelled, else "shape"
    """

    run: FinishedRun
    pairs: pd.DataFrame
    failures: dict[str, str]
    matched: pd.DataFrame
    unmatched: pd.DataFrame
    timings: pd.DataFrame
    class_is: str

    def select(self, pattern: str | None) -> list[str]:
        """Names of the scored pairs that match, worst first.

        Raises
        ------
        RunError
            None does.
        """
        names: list[str] = self.pairs.pair_id.tolist()
        if pattern is None:
            return names
        chosen = [name for name in names if fnmatchcase(name, pattern)]
        if not chosen:
            known = ", ".join(sorted(names)[:5])
            raise RunError(f"--pairs {pattern!r} matches none of the {len(names)} scored pairs ({known} ...)")
        return chosen


def read_results(folder: Path) -> RunResults:
    """The tables of a run that has ended, checked against its index.

    Pairs are ordered by the mean of their ranks in match rate, CDC and r_lambda, matched objects by the mean of their
    ranks in CDC and r_lambda (those without r_lambda last): an order to look at, no score.

    Raises
    ------
    RunError
        The folder is no run, the run has not ended, a table is damaged, or no pair is scored.
    """
    run = FinishedRun(folder)
    rows: pd.DataFrame = pa.Table.from_pylist(run.rows, schema=PAIRS.schema).to_pandas()
    is_scored = rows.status == "scored"
    failures = dict(zip(rows.pair_id[~is_scored], rows.reason[~is_scored], strict=True))
    if not is_scored.any():
        raise RunError(f"run {folder}: none of its {len(rows)} pairs is scored, so there is nothing to report")
    pairs = _worst_first(rows[is_scored], ("match_rate", "cdc_mean", "r_lambda_mean"))
    names = pairs.pair_id.tolist()
    for name in names:
        check_tables(run, name)
    objects = _with_place(_read(run, "objects", names, SIDES))
    return RunResults(
        run=run,
        pairs=pairs,
        failures=failures,
        matched=_matched(_read(run, "metrics", names), objects, names),
        unmatched=_unmatched(_read(run, "matching", names), objects, names),
        timings=pq.read_table(folder / "timings.parquet").to_pandas(),
        class_is="label" if objects.label.notna().any() else "shape",
    )


def _read(run: FinishedRun, table: str, names: Iterable[str], sides: Iterable[str] = ("",)) -> pd.DataFrame:
    """A table of all pairs, one pair after the other."""
    tables = [read_table(run, table, name, side) for name in names for side in sides]
    rows: pd.DataFrame = pa.concat_tables(tables).to_pandas()
    return rows


def _with_place(objects: pd.DataFrame) -> pd.DataFrame:
    """Objects with bearing (degrees, 0 ahead, 90 left), shape class, and the class that the report goes by."""
    bearing = np.degrees(np.arctan2(objects.cy, objects.cx))
    shape = np.array(SHAPES)[objects[_SHAPE_COLUMNS].to_numpy().argmax(axis=1)]
    objects = objects.assign(bearing_deg=bearing, shape=shape)
    labels = objects.label
    group = labels.fillna("(no label)") if labels.notna().any() else objects["shape"]
    grouped: pd.DataFrame = objects.assign(group=group)
    return grouped


def _matched(metrics: pd.DataFrame, objects: pd.DataFrame, names: list[str]) -> pd.DataFrame:
    real = objects[objects.side == "real"][["pair_id", "community_id", *_PLACE, "group", "shape"]]
    both = metrics.merge(real, left_on=["pair_id", "real_id"], right_on=["pair_id", "community_id"], validate="1:1")
    both = both.drop(columns=["community_id", "n_points"])
    both["quadrant"] = quadrant_of(both.cdc.to_numpy(), both.r_lambda.to_numpy(dtype=float))
    both["pair"] = both.pair_id.map({name: i for i, name in enumerate(names)})
    return _worst_first(both, ("cdc", "r_lambda"))


def _unmatched(matching: pd.DataFrame, objects: pd.DataFrame, names: list[str]) -> pd.DataFrame:
    parts = []
    for side, status in zip(SIDES, ("missing", "hallucinated"), strict=True):
        alone = matching[matching.status == status][["pair_id", f"{side}_id", "status"]]
        alone = alone.rename(columns={f"{side}_id": "community_id"}).astype({"community_id": "int32"})
        parts.append(objects[objects.side == side].merge(alone, on=["pair_id", "community_id"], validate="1:1"))
    unmatched = pd.concat(parts)
    unmatched["pair"] = unmatched.pair_id.map({name: i for i, name in enumerate(names)})
    largest_first: pd.DataFrame = unmatched.sort_values(
        ["n_points", "pair_id"], ascending=[False, True], ignore_index=True
    )
    return largest_first


def _worst_first(rows: pd.DataFrame, by: tuple[str, ...]) -> pd.DataFrame:
    """Rows by the mean of their ranks, worst first; a null in any of the columns goes last."""
    ranks = [rows[column].rank(ascending=column == "match_rate", pct=True) for column in by]
    order = sum(ranks[1:], ranks[0])
    ordered = rows.assign(_order=order).sort_values(["_order", "pair_id"], na_position="last", kind="stable")
    plain: pd.DataFrame = ordered.drop(columns="_order").reset_index(drop=True)
    return plain
