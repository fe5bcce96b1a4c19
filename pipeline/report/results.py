"""The tables of a finished run as a report reads them: one frozen object, checked before anything is drawn."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from fnmatch import fnmatchcase
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow as pa

from ...schemas.columns import SIDES
from ...schemas.errors import RunError
from ..results.finished import FinishedRun
from .quadrants import quadrant_of

SHAPES = ("linear", "planar", "scattered")
_SHAPE_COLUMNS = ["linearity", "planarity", "scattering"]


@dataclass(frozen=True)
class RunResults:
    """A finished run.

    run : its folder, its record (`run.json`), and where single tables are read from
    pairs : `pairs.parquet`, the scored pairs only, worst first
    failures : why each failed pair failed
    matched : `metrics` with place and class (`group`) of the real object, and `quadrant`; worst first
    unmatched : `objects` that only one side has, with class and `status` (missing or hallucinated); largest first
    timings : `timings.parquet`
    class_is : "class" where the scans are labelled, else "shape"

    Objects also have `pair`, the position of their pair among `pairs`, and `name`, such as "real 3" (a matched one that
    of its real side).
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
    rows: pd.DataFrame = run.read_table("pairs").to_pandas()
    is_scored = rows.status == "scored"
    failures = dict(zip(rows.pair_id[~is_scored], rows.reason[~is_scored], strict=True))
    if not is_scored.any():
        raise RunError(f"run {folder}: none of its {len(rows)} pairs is scored, so there is nothing to report")
    pairs = _worst_first(rows[is_scored], ("match_rate", "cdc_mean", "r_lambda_mean"))
    names = pairs.pair_id.tolist()
    for name in names:
        run.check_tables(name)
    objects = _with_class(_read(run, "objects", names, SIDES), names)
    matched, unmatched = _matched_and_not(_read(run, "metrics", names), objects)
    return RunResults(
        run=run,
        pairs=pairs,
        failures=failures,
        matched=matched,
        unmatched=unmatched,
        timings=run.read_table("timings").to_pandas(),
        class_is="class" if objects.label.notna().any() else "shape",
    )


def _read(run: FinishedRun, table: str, names: Iterable[str], sides: Iterable[str] = ("",)) -> pd.DataFrame:
    """A table of all pairs, one pair after the other."""
    rows: pd.DataFrame = pa.concat_tables(
        [run.read_table(table, name, side) for name in names for side in sides]
    ).to_pandas()
    return rows


def _with_class(objects: pd.DataFrame, names: list[str]) -> pd.DataFrame:
    """Objects with bearing (degrees, 0 ahead, 90 left), the class that the report goes by, their pair and name."""
    shape = np.array(SHAPES)[objects[_SHAPE_COLUMNS].to_numpy().argmax(axis=1)]
    return objects.assign(
        bearing_deg=np.degrees(np.arctan2(objects.cy, objects.cx)),
        group=objects.label.fillna("(no label)") if objects.label.notna().any() else shape,
        pair=objects.pair_id.map({name: i for i, name in enumerate(names)}),
        name=objects.side + " " + objects.community_id.astype(str),
    )


def _matched_and_not(metrics: pd.DataFrame, objects: pd.DataFrame) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Scores with what is known of the real objects, worst first; the objects without a partner, largest first."""
    real = objects[objects.side == "real"].rename(columns={"community_id": "real_id"}).drop(columns="n_points")
    matched = metrics.merge(real, on=["pair_id", "real_id"], validate="1:1")
    matched["quadrant"] = quadrant_of(matched.cdc.to_numpy(), matched.r_lambda.to_numpy(dtype=float))
    alone = []
    for side, status in zip(SIDES, ("missing", "hallucinated"), strict=True):
        own = objects[objects.side == side]
        partnered = pd.MultiIndex.from_frame(metrics[["pair_id", f"{side}_id"]])
        is_alone = ~pd.MultiIndex.from_frame(own[["pair_id", "community_id"]]).isin(partnered)
        alone.append(own[is_alone].assign(status=status))
    unmatched = pd.concat(alone).sort_values(["n_points", "pair_id"], ascending=[False, True], ignore_index=True)
    return _worst_first(matched, ("cdc", "r_lambda")), unmatched


def _worst_first(rows: pd.DataFrame, by: tuple[str, ...]) -> pd.DataFrame:
    """Rows by the mean of their ranks, worst first; a null in any of the columns goes last."""
    ranks = [rows[column].rank(ascending=column == "match_rate", pct=True) for column in by]
    order = sum(ranks[1:], ranks[0])
    ordered = rows.assign(_order=order).sort_values(["_order", "pair_id"], na_position="last", kind="stable")
    plain: pd.DataFrame = ordered.drop(columns="_order").reset_index(drop=True)
    return plain
