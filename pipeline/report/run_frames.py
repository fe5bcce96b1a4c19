"""A finished run as a report reads it: its tables in one frozen object, and the points of one pair.

Everything is checked before anything is drawn. Recomputed are the distance of each point to the other side, and which
points are in a piece.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from ...schemas.columns import SIDES
from ...schemas.errors import RunError
from ...schemas.settings import PieceSettings
from ...stages.arrays import BoolArray, FloatArray, IntArray
from ...stages.coverage import nearest_distances
from ...stages.inspect.sensor_description import SensorDescription
from ...stages.pieces import CutScan, label_pieces
from ..results.finished import FinishedRun
from ..results.overview import NO_LABEL
from .look import OUTCOME_COLOURS

#: How much of an object the other side has, as objects show it: of the real one, and of the simulated one.
OBJECT_COVERAGE = tuple(f"covered_{side}_0p3m" for side in SIDES)
#: How much of an object is road to the other side (below its ground cut): of the real one, and of the simulated one.
OBJECT_ROAD = tuple(f"road_share_{side}" for side in SIDES)


@dataclass(frozen=True)
class RunResults:
    """A finished run.

    run : its folder, its record (`run.json`), and where single tables are read from
    pairs : `pairs.parquet`, the scored pairs only, worst first
    failures : why each failed pair failed
    matched : `metrics` with place and class (`group`) of the real object, and `quadrant`; worst first
    unmatched : `objects` that only one side has, with class and `status` (missing or hallucinated); largest first
    class_is : "class" where the scans are labelled, else "shape"

    Objects also have `pair`, the position of their pair among `pairs`, `name`, such as "real 3" (a matched one that of
    its real side), and the columns `OBJECT_COVERAGE` and `OBJECT_ROAD`, null for a side that does not have the object.
    """

    run: FinishedRun
    pairs: pd.DataFrame
    failures: dict[str, str]
    matched: pd.DataFrame
    unmatched: pd.DataFrame
    class_is: str

    def select(self, pattern: str | None) -> list[str]:
        """Names of the scored pairs that match, worst first.

        Raises
        ------
        RunError
            None does.
        """
        chosen = set(self.run.select(pattern))
        return [name for name in self.pairs.pair_id if name in chosen]


def read_results(folder: Path) -> RunResults:
    """The tables of a run that has ended, checked against its index.

    Pairs are ordered by the mean of their ranks in match rate, CDC and r_lambda, matched objects by the mean of their
    ranks in CDC and r_lambda (those without r_lambda last): an order to look at, no score.

    Raises
    ------
    RunError
        The folder is not a run, the run has not ended, a table is damaged, or no pair is scored.
    """
    run = FinishedRun(folder)
    rows = run.pairs
    is_scored = rows.status == "scored"
    failures = dict(zip(rows.pair_id[~is_scored], rows.reason[~is_scored], strict=True))
    if not is_scored.any():
        raise RunError(f"run {folder}: none of its {len(rows)} pairs is scored, so there is nothing to report")
    pairs = _worst_first(rows[is_scored], ("match_rate", "cdc_mean", "r_lambda_mean"))
    names = pairs.pair_id.tolist()
    for name in names:
        run.check_tables(name)
    objects = run.objects_of(names)
    is_labelled = bool(objects["label"].notna().any())
    objects["group"] = objects["label"].fillna(NO_LABEL) if is_labelled else objects["shape"]
    objects["name"] = objects["side"] + " " + objects["community_id"].astype(str)
    for column, of_sides in (("covered_0p3m", OBJECT_COVERAGE), ("road_share", OBJECT_ROAD)):
        for name, side in zip(of_sides, SIDES, strict=True):
            objects[name] = objects[column].where(objects["side"] == side)
    matched, unmatched = _matched_and_not(objects)
    return RunResults(
        run=run,
        pairs=pairs,
        failures=failures,
        matched=matched,
        unmatched=unmatched,
        class_is="class" if is_labelled else "shape",
    )


#: Columns of `ground` for a `Cloud`.
GROUND_COLUMNS = ["point_id", "x", "y", "z", "is_ground"]


@dataclass(frozen=True)
class Cloud:
    """The object points of one side.

    point_ids : (n,) int32, ascending
    points : (n, 3) float64, metres, real sensor's frame
    community : (n,) int32
    """

    point_ids: IntArray
    points: FloatArray
    community: IntArray

    @classmethod
    def of(cls, ground: pd.DataFrame, communities: pd.DataFrame) -> Cloud:
        """The object points of a side, from the rows of its tables."""
        points = ground[~ground.is_ground]
        return cls(points.point_id.to_numpy(), points[["x", "y", "z"]].to_numpy(), communities.community_id.to_numpy())

    def members(self, community_id: int) -> FloatArray:
        """The points of one object, (m, 3)."""
        members: FloatArray = self.points[self.community == community_id]
        return members


class PairFrames:
    """The tables of one scored pair, each read when first requested.

    Raises
    ------
    RunError
        From every property and method: a table is damaged or gone.
    """

    def __init__(self, results: RunResults, pair_id: str) -> None:
        self.matched = results.matched[results.matched.pair_id == pair_id]
        self.unmatched = results.unmatched[results.unmatched.pair_id == pair_id]
        self._run, self._pair_id = results.run, pair_id

    @cached_property
    def _ground(self) -> dict[str, pd.DataFrame]:
        return {side: self._columns("ground", side, GROUND_COLUMNS) for side in SIDES}

    @cached_property
    def road(self) -> dict[str, FloatArray]:
        """The points that were removed as ground, (r, 3) metres, by side."""
        return {side: rows.loc[rows.is_ground, ["x", "y", "z"]].to_numpy() for side, rows in self._ground.items()}

    @cached_property
    def clouds(self) -> dict[str, Cloud]:
        """The object points by side."""
        return {
            side: Cloud.of(self._ground[side], self._columns("communities", side, ["community_id"])) for side in SIDES
        }

    @cached_property
    def sensors(self) -> dict[str, SensorDescription]:
        """The sensor of each side, as stage `sensor` describes it."""
        jobs = self._run.store.ledger.jobs(self._pair_id)
        return {side: SensorDescription(**jobs["sensor", side].metadata["sensor"]) for side in SIDES}

    @cached_property
    def ray_image(self) -> NDArray[np.uint8]:
        """(beams, columns) place in `OUTCOME_COLOURS`, 255 for none; left on the left, the highest beam on top."""
        rays = self._columns("rays", "", ["beam", "column", "outcome"])
        return ray_image(rays, outcome_places(rays), 255)

    @cached_property
    def distances_m(self) -> dict[str, FloatArray]:
        """The distance of each object point of a side to the nearest one of the other side, (n,), by side."""
        real, sim = (self.clouds[side].points for side in SIDES)
        return dict(zip(SIDES, nearest_distances(real, sim), strict=True))

    def is_piece(self, side: str) -> BoolArray:
        """Mask of the object points of a side that are in a missing (real side) or an invented piece, (n,)."""
        settings = PieceSettings.model_validate(self._run.record.settings["pieces"])
        points, other = (
            np.concatenate([self.clouds[one].points, self.road[one]])
            for one in (SIDES if side == "real" else SIDES[::-1])
        )
        n = len(self.clouds[side].points)
        own = CutScan(points, np.arange(len(points)) >= n, np.empty(0))
        labels = label_pieces(own, CutScan(other, np.empty(0, dtype=np.bool_), np.empty(0)), settings)
        is_piece: BoolArray = labels[:n] >= 0
        return is_piece

    @cached_property
    def alignment_moves(self) -> dict[int, FloatArray]:
        """Motion of the simulated object onto the real one, by real id: mean of kept real less simulated nodes, (3,).

        The nodes are aligned with both sides centred so (`stages.selection`), and `alignment_rms_m` is of it.
        """
        real, sim = (
            cloud.points[np.searchsorted(cloud.point_ids, self.selection[f"{side}_point_id"])]
            for side, cloud in self.clouds.items()
        )
        moves = pd.DataFrame(real - sim).groupby(self.selection.real_id.to_numpy()).mean()
        return {int(real_id): move for real_id, move in zip(moves.index, moves.to_numpy(), strict=True)}

    @cached_property
    def selection(self) -> pd.DataFrame:
        """The kept nodes of each matched object, in aligned pairs: real_id, real_point_id, sim_point_id."""
        return self._columns("selection", "", ["real_id", "real_point_id", "sim_point_id"])

    def _columns(self, table: str, side: str, columns: list[str]) -> pd.DataFrame:
        rows: pd.DataFrame = self._run.read_table(table, self._pair_id, side, columns).to_pandas()
        return rows


def ray_image(rays: pd.DataFrame, values: NDArray[Any], empty: float) -> NDArray[Any]:
    """(beams, columns) the value of each ray, `empty` for none; left on the left, the highest beam on top.

    Beams with more returns than firings in a turn have more columns than most; these are left out.
    """
    last = rays.groupby("beam").column.max()
    image = np.full((len(last), int(last.median()) + 1 if len(last) else 0), empty, dtype=values.dtype)
    shown = (rays.column < image.shape[1]).to_numpy()
    image[rays.beam[shown], rays.column[shown]] = values[shown]
    return image[::-1, ::-1]


def outcome_places(rays: pd.DataFrame) -> NDArray[np.uint8]:
    """(n,) place of the outcome of each ray in `OUTCOME_COLOURS`, 255 for none."""
    places = {name: place for place, name in enumerate(OUTCOME_COLOURS)}
    found: NDArray[np.uint8] = np.array(rays.outcome.map(places).fillna(255), dtype=np.uint8)
    return found


def _matched_and_not(objects: pd.DataFrame) -> tuple[pd.DataFrame, pd.DataFrame]:
    """The matched objects by their real side, worst first; the objects without a partner, largest first."""
    of_sim = (OBJECT_COVERAGE[1], OBJECT_ROAD[1])
    is_matched, is_real = objects["partner"] >= 0, objects["side"] == "real"
    sim = objects.loc[is_matched & ~is_real, ["pair", "community_id", *of_sim]]
    real = objects[is_matched & is_real].drop(columns=[*of_sim, "n_points"])
    real = real.rename(columns={"community_id": "real_id", "partner": "sim_id"})
    matched = real.merge(sim.rename(columns={"community_id": "sim_id"}), on=["pair", "sim_id"], validate="1:1")
    unmatched = objects[objects["fate"].isin(["missing", "hallucinated"])]
    unmatched = unmatched.assign(status=unmatched["fate"])
    unmatched = unmatched.sort_values(["n_points", "pair_id"], ascending=[False, True], ignore_index=True)
    return _worst_first(matched, ("cdc", "r_lambda")), unmatched


def _worst_first(rows: pd.DataFrame, by: tuple[str, ...]) -> pd.DataFrame:
    """Rows by the mean of their ranks, worst first; a null in any of the columns goes last."""
    ranks = [rows[column].rank(ascending=column == "match_rate", pct=True) for column in by]
    order = sum(ranks[1:], ranks[0])
    ordered = rows.assign(_order=order).sort_values(["_order", "pair_id"], na_position="last", kind="stable")
    plain: pd.DataFrame = ordered.drop(columns="_order").reset_index(drop=True)
    return plain
