"""A finished run as a report reads it: its tables in one frozen object, and the points of one pair.

Everything is checked before anything is drawn. Recomputed are the distance of each point to the
other side, and which points are in a piece.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from ...schemas.columns import SIDES
from ...schemas.errors import RunError
from ...schemas.metric_catalogue import METRIC, QUADRANT_SCORES
from ...schemas.settings import PieceSettings
from ...stages.arrays import BoolArray, FloatArray, IntArray
from ...stages.coverage import nearest_distances
from ...stages.pieces import CutScan, label_pieces
from ...stages.sensor_description import SensorDescription
from ..results.finished import FinishedRun
from ..results.object_frame import QUADRANTS, UNKNOWN
from ..results.overview import NO_LABEL

#: The two scores that are drawn side by side.
SCORES = QUADRANT_SCORES[::-1]
_NONE = -1  # no object has this number
#: Columns of the share of a real and of a simulated object that the other side has.
OBJECT_COVERAGE = tuple(f"covered_{side}_0p3m" for side in SIDES)
#: Columns of the share of an object that is below the ground cut of the other side.
OBJECT_ROAD = tuple(f"road_share_{side}" for side in SIDES)
#: Columns of both sides of an object, and those of one side that they come from.
_OF_SIDES = {
    "n_{}": "n_points",
    "covered_{}_0p3m": "covered_0p3m",
    "road_share_{}": "road_share",
}


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
    - name, object : such as "real 3" (a matched one that of its real side), and "real 3, sim 5"
    - real_id, sim_id : -1 for a side that does not have the object
    - status : that of the scores if matched, else not_found or extra
    - group : class or shape
    - n_real, n_sim, `OBJECT_COVERAGE`, `OBJECT_ROAD` : null for a side without the object
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

    def select(self, pattern: str | None) -> list[str]:
        """Names of the scored pairs that match, worst first.

        Raises
        ------
        RunError
            None does.
        """
        chosen = set(self.run.select(pattern))
        return [name for name in self.pairs.pair_id if name in chosen]


def axis_title(score: str) -> str:
    """Label of the axis of a score: its heading and its best end."""
    return f"{METRIC[score].label} ({METRIC[score].scale})"


def quadrants(results: RunResults) -> dict[str, dict[str, Any]]:
    """By quadrant, and of the objects without a score: number (n) and share of matched objects."""
    counts = results.matched.quadrant.value_counts()
    by_quadrant = {}
    for key in (*QUADRANTS, UNKNOWN):
        n = int(counts.get(key, 0))
        by_quadrant[key] = {"n": n, "share": n / max(1, len(results.matched))}
    return by_quadrant


def read_results(folder: Path) -> RunResults:
    """The tables of a run that has ended, checked against its index.

    Pairs are ordered by the mean of their ranks in match rate, CDC and r_lambda, matched objects by
    the mean of their ranks in CDC and r_lambda (those without r_lambda last): an order to look at,
    not a score.

    Raises
    ------
    RunError
        The folder is not a run, the run has not ended, a table is damaged, or no pair is scored.
    """
    run = FinishedRun(folder)
    scored = run.pairs.query("status == 'scored'")
    if scored.empty:
        raise RunError(
            f"run {folder}: none of its {len(run.rows)} pairs is scored, so there is nothing to "
            "report"
        )
    means = [METRIC[score].mean_column for score in QUADRANT_SCORES]
    pairs = _worst_first(scored, ("match_rate", *means))
    names = pairs.pair_id.tolist()
    for name in names:
        run.check_tables(name)
    objects = run.objects_of(names)
    is_labelled = bool(objects["label"].notna().any())
    objects["group"] = objects["label"].fillna(NO_LABEL) if is_labelled else objects["shape"]
    return RunResults(run, pairs, _both_sides(objects), "class" if is_labelled else "shape")


def _both_sides(objects: pd.DataFrame) -> pd.DataFrame:
    """One row per object, with the columns of either side."""
    is_matched = objects["partner"] >= 0
    other = objects["side"].map({"real": "sim", "sim": "real"})
    partner_ids = pd.MultiIndex.from_arrays([objects["pair"], other, objects["partner"]])
    partners = objects.set_index(["pair", "side", "community_id"]).reindex(partner_ids)
    for side in SIDES:
        is_of_side = objects["side"] == side
        objects[f"{side}_id"] = objects["community_id"].where(is_of_side, objects["partner"])
        for name, source in _OF_SIDES.items():
            values = objects[source].where(is_of_side, partners[source].to_numpy())
            objects[name.format(side)] = values
        objects[f"n_{side}"] = objects[f"n_{side}"].astype("Int64")
    objects["n_keep"] = objects["n_keep"].where(is_matched).astype("Int64")
    objects["quadrant"] = objects["quadrant"].where(is_matched)
    objects["status"] = objects["status"].where(is_matched, objects["fate"])
    objects["name"] = objects["side"] + " " + objects["community_id"].astype(str)
    partner_names = ", sim " + objects["partner"].astype(str)
    objects["object"] = objects["name"] + partner_names.where(is_matched, "")
    matched = _worst_first(objects[is_matched & (objects["side"] == "real")], QUADRANT_SCORES)
    unmatched = objects[~is_matched & (objects["fate"] != "remnant")]
    unmatched = unmatched.sort_values(["n_points", "pair_id"], ascending=[False, True])
    return pd.concat([matched, unmatched], ignore_index=True)


def _worst_first(rows: pd.DataFrame, by: tuple[str, ...]) -> pd.DataFrame:
    """Rows by the mean of their ranks, worst first; a null in any of the columns goes last."""
    ranks = [rows[column].rank(ascending=column == "match_rate", pct=True) for column in by]
    ranked = rows.assign(_order=sum(ranks))
    ordered = ranked.sort_values(["_order", "pair_id"], na_position="last", kind="stable")
    return ordered.drop(columns="_order").reset_index(drop=True)


@dataclass(frozen=True)
class Cloud:
    """The points of one side.

    point_ids : (n,) int32, ascending, of the object points
    points : (n, 3) float64, the object points, metres, real sensor's frame
    community : (n,) int32
    road : (r, 3) float64, the points that were removed as ground
    """

    point_ids: IntArray
    points: FloatArray
    community: IntArray
    road: FloatArray

    @property
    def everything(self) -> FloatArray:
        """All points, (n + r, 3): those of objects, then the road."""
        return np.concatenate([self.points, self.road])

    def split(self, community: int | None) -> tuple[FloatArray, FloatArray]:
        """The points of an object, and the object points of all others; None has no points."""
        is_member = self.community == (_NONE if community is None else community)
        return self.points[is_member], self.points[~is_member]


def read_cloud(run: FinishedRun, pair_id: str, side: str) -> Cloud:
    """The points of a side; `RunError` if a table is damaged or gone."""
    ground = run.read_table("ground", pair_id, side, ["point_id", "x", "y", "z", "is_ground"])
    communities = run.read_table("communities", pair_id, side, ["community_id"])
    is_ground = ground["is_ground"].to_numpy()
    points = np.column_stack([ground[axis] for axis in "xyz"])
    return Cloud(
        point_ids=ground["point_id"].to_numpy()[~is_ground],
        points=points[~is_ground],
        community=communities["community_id"].to_numpy(),
        road=points[is_ground],
    )


def read_clouds(run: FinishedRun, pair_id: str) -> dict[str, Cloud]:
    """The points of a pair by side; `RunError` if a table is damaged or gone."""
    return {side: read_cloud(run, pair_id, side) for side in SIDES}


class PairFrames:
    """The tables of one scored pair, each read when first requested.

    Raises
    ------
    RunError
        From every property and method: a table is damaged or gone.
    """

    def __init__(self, results: RunResults, pair_id: str) -> None:
        self.objects = results.objects[results.objects.pair_id == pair_id]
        self._run = results.run
        self._pair_id = pair_id

    @cached_property
    def clouds(self) -> dict[str, Cloud]:
        """The points by side."""
        return read_clouds(self._run, self._pair_id)

    @cached_property
    def sensors(self) -> dict[str, SensorDescription]:
        """The sensor of each side, as stage `sensor` describes it."""
        jobs = self._run.store.ledger.jobs(self._pair_id)
        return {
            side: SensorDescription(**jobs["sensor", side].metadata["sensor"]) for side in SIDES
        }

    @cached_property
    def distances_m(self) -> dict[str, FloatArray]:
        """By side the distance of each object point to the nearest one of the other side, (n,)."""
        real, sim = nearest_distances(self.clouds["real"].points, self.clouds["sim"].points)
        return {"real": real, "sim": sim}

    @cached_property
    def is_piece(self) -> dict[str, BoolArray]:
        """By side the mask of the object points in a missing (real) or an invented piece, (n,)."""
        settings = PieceSettings.model_validate(self._run.record.settings["pieces"])
        scans = {}
        for side, cloud in self.clouds.items():
            points = cloud.everything
            is_road = np.arange(len(points)) >= len(cloud.points)
            scans[side] = CutScan(points, is_road, np.empty(0))
        missing = label_pieces(scans["real"], scans["sim"], settings) >= 0
        invented = label_pieces(scans["sim"], scans["real"], settings) >= 0
        return {
            "real": missing[: len(self.clouds["real"].points)],
            "sim": invented[: len(self.clouds["sim"].points)],
        }


#: The tables of a pair, kept for a while: pictures of its pieces and its view read the same ones.
frames_of = lru_cache(maxsize=8)(PairFrames)


def ray_image(rays: pd.DataFrame, values: pd.Series) -> FloatArray:
    """(beams, columns) the value of each ray, NaN for none.

    Left is on the left, the highest beam on top. Beams with more returns than firings in a turn
    have more columns than most; these columns are left out.
    """
    n_columns = int(rays.groupby("beam").column.max().median()) + 1
    by_ray = values.astype(float).set_axis([rays.beam, rays.column])
    image: FloatArray = by_ray.unstack().reindex(columns=range(n_columns)).to_numpy()
    return image[::-1, ::-1]
