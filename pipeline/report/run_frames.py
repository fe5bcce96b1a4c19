"""A finished run as a report reads it: its pairs and objects, and the points of one pair.

Recomputed is the piece that holds each point.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache
from pathlib import Path

import numpy as np
import pandas as pd

from ...schemas.columns import SIDES
from ...schemas.metric_catalogue import QUADRANT_SCORES
from ...schemas.settings import PieceSettings
from ...stages.arrays import BoolArray, FloatArray
from ...stages.pieces import CutScan, label_pieces
from ..results.finished import FinishedRun
from ..results.overview import NO_LABEL


@dataclass(frozen=True, eq=False)
class RunResults:
    """A finished run.

    run : its folder, its record (`run.json`), and where single tables are read from
    pairs : `pairs.parquet`, the scored pairs only, worst first
    objects : matched objects once, with the place of the real one, worst first; then those that
        only one side has, largest first
    class_is : "class" where the scans are labelled, else "shape"

    Objects have the columns of `object_frame`, and

    - pair : index of their pair in `pairs`
    - name : such as "real 3"; of a matched object that of its real side
    - real_id, sim_id : -1 for a side that does not have the object
    - status : that of the scores if matched, else not_found or extra
    - group : class or shape
    - n_real, n_sim, covered_real_0p3m, covered_sim_0p3m : null for a side without the object
    - n_keep, quadrant : null if it is not matched
    """

    run: FinishedRun
    pairs: pd.DataFrame
    objects: pd.DataFrame
    class_is: str

    @cached_property
    def matched(self) -> pd.DataFrame:
        """The objects that both sides have, worst first."""
        return self.objects[self.objects.partner >= 0]

    @cached_property
    def unmatched(self) -> pd.DataFrame:
        """The objects that only one side has, largest first."""
        return self.objects[self.objects.partner < 0]


def read_results(folder: Path) -> RunResults:
    """The tables of a run that has ended, checked against its index.

    Pairs are ordered by match rate, as `show --all` has them, matched objects by the mean of their
    ranks in CDC and r_lambda: an order to look at, not a score.

    Raises
    ------
    RunError
        The folder is not a run, the run has not ended, a table is damaged, or no pair is scored.
    """
    run = FinishedRun(folder)
    scored = run.pairs[run.pairs.pair_id.isin(run.select())]
    pairs = scored.sort_values("match_rate", kind="stable", ignore_index=True)
    objects = run.objects_of(pairs.pair_id.tolist())
    is_labelled = bool(objects["label"].notna().any())
    objects["group"] = objects["label"].fillna(NO_LABEL) if is_labelled else objects["shape"]
    return RunResults(run, pairs, _both_sides(objects), "class" if is_labelled else "shape")


def _both_sides(objects: pd.DataFrame) -> pd.DataFrame:
    """One row per object, with the columns of either side."""
    objects = objects.drop(columns=["n_real", "n_sim"])  # null without a score
    for side in SIDES:
        is_of_side = objects["side"] == side
        objects[f"{side}_id"] = objects["community_id"].where(is_of_side, objects["partner"])
        of_side = objects.loc[is_of_side, ["pair", "community_id", "n_points", "covered_0p3m"]]
        of_side.columns = ["pair", f"{side}_id", f"n_{side}", f"covered_{side}_0p3m"]
        objects = objects.merge(of_side, how="left", on=["pair", f"{side}_id"])
        objects[f"n_{side}"] = objects[f"n_{side}"].astype("Int64")
    is_matched = objects["partner"] >= 0
    objects["n_keep"] = objects["n_keep"].where(is_matched).astype("Int64")
    objects["quadrant"] = objects["quadrant"].where(is_matched)
    objects["status"] = objects["status"].where(is_matched, objects["fate"])
    objects["name"] = objects["side"] + " " + objects["community_id"].astype(str)
    matched = _worst_first(objects[is_matched & (objects["side"] == "real")])
    unmatched = objects[~is_matched & (objects["fate"] != "remnant")]
    unmatched = unmatched.sort_values(["n_points", "pair_id"], ascending=[False, True])
    return pd.concat([matched, unmatched], ignore_index=True)


def _worst_first(objects: pd.DataFrame) -> pd.DataFrame:
    """Matched objects by the mean of their ranks in CDC and r_lambda, worst first; without r_lambda last."""
    ranks = (
        objects[[*QUADRANT_SCORES]].rank(ascending=False, pct=True).sum(axis=1, skipna=False)
    )
    ranked = objects.assign(_order=ranks).sort_values(["_order", "pair_id"], kind="stable")
    return ranked.drop(columns="_order")


@lru_cache(maxsize=8)  # the worst places of a pair and its view read the same points
def points_of(run: FinishedRun, pair_id: str) -> dict[str, pd.DataFrame]:
    """The clean points of a scored pair by side: `FinishedRun.points`, and `piece_id`.

    That is the missing (real) or invented (sim) piece that holds the point; -1 for none.

    Raises
    ------
    RunError
        A table is damaged or gone.
    """
    points = {side: run.points(pair_id, side) for side in SIDES}
    scans = []
    for rows in points.values():
        is_ground = rows["is_ground"].to_numpy()
        scans.append(CutScan(coordinates(rows), is_ground, rows["height_m"].to_numpy()))
    settings = PieceSettings.model_validate(run.record.settings["pieces"])
    for side, scan, other in zip(SIDES, scans, scans[::-1], strict=True):
        points[side]["piece_id"] = label_pieces(scan, other, settings)
    return points


def coordinates(points: pd.DataFrame) -> FloatArray:
    """Coordinates of points, (n, 3) float64 metres, in the real sensor's frame."""
    return points[["x", "y", "z"]].to_numpy()


def inside(points: FloatArray, low: FloatArray, high: FloatArray) -> BoolArray:
    """(n,) which points lie in a box."""
    return np.all((points >= low) & (points <= high), axis=1)
