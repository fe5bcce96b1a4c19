"""Content of a page about one pair: its objects, the points of both sides, road.

Points are 16-bit integers in units of a small step. Each array is packed as base64 of its deflated
bytes, which the browser reads as a typed array.
"""

from __future__ import annotations

import base64
import zlib
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from ....schemas.columns import SIDES, Row
from ....schemas.metric_catalogue import COVERED, labels, scores_in
from ....stages.arrays import BoolArray
from ....stages.statistics.bands import evenly
from ....stages.surface import signed_distances
from ...results.object_frame import plain_rows
from ..run_frames import RunResults, coordinates, points_of
from ..view import Table
from ..views.show_view import alone_judgement, judgement

#: Columns of an object that the page draws it by.
_COLUMNS = (
    *("name", "real_id", "sim_id", "status", "group", "quadrant", "cdc", "r_lambda"),
    *("n_real", "n_sim", "n_keep"),
)
#: Scores of a chosen object.
_PANEL = (*scores_in("panel"), *COVERED)
#: The signed distance to the planes of the real side is a byte, from -SIGNED_M to SIGNED_M.
SIGNED_M = 0.5
_NO_SIGN = 255
#: Largest number of object points of a page.
MOST_POINTS = 1_000_000
#: Of one object, if it has as many.
_FEWEST_OF_OBJECT = 80
_MOST_ROAD_POINTS = 4000
_STEPS = 32767


def pair_data(
    results: RunResults, pair_id: str, most_points: int = MOST_POINTS
) -> dict[str, Any]:
    """One pair for the page: points of both sides, and objects.

    Parameters
    ----------
    most_points : of both sides together, about; road points come on top

    Raises
    ------
    RunError
        One of the pair's tables is damaged.
    """
    points = points_of(results.run, pair_id)
    farthest_m = max(float(np.abs(coordinates(rows)).max()) for rows in points.values())
    step_m = farthest_m / _STEPS  # coordinates fit into 16 bits
    rows = plain_rows(results.objects[results.objects["pair_id"] == pair_id])
    return {
        "step_m": step_m,
        "sides": {side: _side_data(points, side, most_points // 2, step_m) for side in SIDES},
        "objects": [_object_data(row) for row in rows],
    }


def _object_data(row: Row) -> Row:
    """An object for the page: what is wrong with it, and the numbers that it has."""
    judged = judgement(row) if row["partner"] >= 0 else alone_judgement(row)
    facts: list[tuple[str, object]] = [("range (m)", row["range_m"])]
    facts += zip(labels(_PANEL), (row[name] for name in _PANEL), strict=True)
    facts += [("real points", row["n_real"]), ("simulated points", row["n_sim"])]
    known = [fact for fact in facts if fact[1] is not None]
    texts = {"sentence": judged, "facts": Table("", ("", ""), known).cells}
    return texts | {name: row[name] for name in _COLUMNS}


def thinned(ids: pd.Series, most: int) -> BoolArray:
    """(n,) about `most` of the points of objects with these ids: every k-th, of each object enough.

    For display only.

    Examples
    --------
    >>> ids = pd.Series([0] * 10_000 + [1] * 50)
    >>> ids[thinned(ids, most=1000)].value_counts().tolist()
    [910, 50]
    """
    place = ids.groupby(ids).cumcount()
    n_points = ids.groupby(ids).transform("size")
    step = (n_points // _FEWEST_OF_OBJECT).clip(1, -(-len(ids) // most))
    return (place % step == 0).to_numpy()


def _side_data(
    points: dict[str, pd.DataFrame], side: str, most: int, step_m: float
) -> dict[str, Any]:
    """The points of a side: how many of each object, and the packed arrays: objects, then road."""
    rows = points[side]
    of_objects = rows[rows["community_id"].fillna(-1) >= 0]  # without those left out
    of_objects = of_objects.sort_values("community_id", kind="stable")
    shown = of_objects[thinned(of_objects["community_id"], most)]
    road = coordinates(rows[rows["is_ground"]])
    places = np.concatenate([coordinates(shown), road[evenly(len(road), _MOST_ROAD_POINTS)]])
    counts = shown["community_id"].value_counts(sort=False)
    data = {
        "n": len(of_objects),
        "ids": counts.index.tolist(),
        "counts": counts.tolist(),
        "points": _packed(np.rint(places / step_m).astype("<i2").T),  # all x, all y, all z
        "piece": _packed((shown["piece_id"] >= 0).to_numpy()),
    }
    if side == "sim":
        signed_m = signed_distances(places, coordinates(points["real"]), SIGNED_M)
        shares = np.clip((signed_m / SIGNED_M + 1) / 2, 0, 1)
        steps = np.rint((_NO_SIGN - 1) * shares)
        data["signed"] = _packed(np.nan_to_num(steps, nan=_NO_SIGN).astype(np.uint8))
    return data


def _packed(values: NDArray[Any]) -> str:
    """Base64 of the deflated bytes of an array."""
    return base64.b64encode(zlib.compress(values.tobytes(), 9)).decode("ascii")
