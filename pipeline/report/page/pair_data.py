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

from ....schemas.columns import SIDES
from ....schemas.metric_catalogue import scores_in
from ....stages.arrays import BoolArray, FloatArray
from ....stages.coverage import COVERAGE_DISTANCES_M
from ....stages.statistics.findings import evenly
from ....stages.surface import signed_distances
from ...results.object_frame import plain_rows
from ..run_frames import OBJECT_COVERAGE, OBJECT_ROAD, RunResults, coordinates, points_of
from ..view import columns_of
from ..views.show_view import alone_judgement, judgement

#: Properties of a chosen object, the first ones at first sight; an object shows those it has.
_FACTS = (
    *("range_m", *scores_in("panel"), *OBJECT_COVERAGE, "n_real", "n_sim", "bearing_deg"),
    *("quadrant", *OBJECT_ROAD, "n_keep", "group", "status", "reason", *scores_in("object")),
)
FACTS = tuple(dict.fromkeys(_FACTS))  # each once
#: Columns of the objects, in the order of their rows in the page.
OBJECT_COLUMNS = ("name", "real_id", "sim_id", "sentence", *FACTS)
#: The distance of a point to the other side is a byte, its largest value for this and more metres.
FAR_M = COVERAGE_DISTANCES_M[-1]
_FAR = 255
#: The signed distance to the planes of the real side is a byte, from -SIGNED_M to SIGNED_M.
SIGNED_M = 0.5
_NO_SIGN = 255
#: Largest number of object points of a page.
MOST_POINTS = 1_000_000
#: Of one object, if it has as many.
_FEWEST_OF_OBJECT = 80
_MOST_ROAD_POINTS = 4000
_ROAD_CELL_M = 0.4
_STEPS = 32767


def pair_data(results: RunResults, pair_id: str, most_points: int = MOST_POINTS) -> dict[str, Any]:
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
    objects = plain_rows(results.objects[results.objects["pair_id"] == pair_id])
    for row in objects:
        row["sentence"] = judgement(row) if row["partner"] >= 0 else alone_judgement(row)
    return {
        "step_m": step_m,
        "sides": {side: _side_data(points, side, most_points // 2, step_m) for side in SIDES},
        "objects": columns_of(objects, OBJECT_COLUMNS),
    }


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
    """The points of a side: how many of each object, and the packed arrays of objects and road."""
    rows = points[side]
    of_objects = rows[rows["community_id"].fillna(-1) >= 0]  # without those left out
    of_objects = of_objects.sort_values("community_id", kind="stable")
    shown = of_objects[thinned(of_objects["community_id"], most)]
    road = _some_road(coordinates(rows[rows["is_ground"]]))
    counts = shown["community_id"].value_counts(sort=False)
    data = {
        "n": len(of_objects),
        "ids": counts.index.tolist(),
        "counts": counts.tolist(),
        "points": _packed_points(coordinates(shown), step_m),
        "distance": _packed(_in_bytes(shown["distance_m"].to_numpy() / FAR_M, _FAR)),
        "piece": _packed((shown["piece_id"] >= 0).to_numpy()),
        "road": _packed_points(road, step_m),
    }
    if side == "sim":
        places = np.concatenate([coordinates(shown), road])
        signed = signed_distances(places, coordinates(points["real"]), SIGNED_M)
        steps = _in_bytes((signed / SIGNED_M + 1) / 2, _NO_SIGN - 1)
        data["signed"] = _packed(steps[: len(shown)])
        data["road_signed"] = _packed(steps[len(shown) :])
    return data


def _some_road(road: FloatArray) -> FloatArray:
    """Road points evenly over the ground, one per cell; for display only."""
    cells = np.floor(road[:, :2] / _ROAD_CELL_M)
    _, first = np.unique(cells, axis=0, return_index=True)
    return road[first[evenly(len(first), _MOST_ROAD_POINTS)]]


def _in_bytes(share: FloatArray, whole: int) -> Any:
    """Shares of `whole`, cut off at 0 and 1; NaN is `_NO_SIGN`."""
    steps = np.rint(whole * np.clip(share, 0, 1))
    return np.nan_to_num(steps, nan=_NO_SIGN).astype(np.uint8)


def _packed_points(points: FloatArray, step_m: float) -> str:
    """Points in steps: all x, all y, all z."""
    return _packed(np.rint(points / step_m).astype("<i2").T)


def _packed(values: NDArray[Any]) -> str:
    """Base64 of the deflated bytes of an array."""
    return base64.b64encode(zlib.compress(values.tobytes(), 9)).decode("ascii")
