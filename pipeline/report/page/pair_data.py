"""Content of a page about one pair: its objects, the points of both sides, road.

Points are 16-bit integers in units of a small step. Each array is packed as base64 of its deflated
bytes, which the browser reads as a typed array.
"""

from __future__ import annotations

import base64
import zlib
from collections.abc import Iterable
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from ....schemas.columns import SIDES
from ....schemas.metric_catalogue import scores_in
from ....stages.arrays import FloatArray, IndexArray
from ....stages.coverage import COVERAGE_DISTANCES_M
from ....stages.statistics.findings import evenly
from ....stages.surface import signed_distances
from ...results.object_frame import plain_rows
from ..run_frames import OBJECT_COVERAGE, OBJECT_ROAD, PairFrames, RunResults, frames_of
from ..view import columns_of
from ..views.show_view import alone_judgement, judgement

#: Properties of a chosen object, the first ones at first sight; an object shows those it has.
_FACTS = (
    *("range_m", *scores_in("panel"), *OBJECT_COVERAGE, "n_real", "n_sim", "bearing_deg"),
    *("quadrant", *OBJECT_ROAD, "n_keep", "group", "status", "reason", *scores_in("object")),
)
FACTS = tuple(dict.fromkeys(_FACTS))  # each once
#: Columns of the objects, in the order of their rows in the page.
OBJECT_COLUMNS = ("name", "real_id", "sim_id", "cx", "cy", "cz", "sentence", *FACTS)
#: The distance of a point to the other side is a byte, its largest value for this and more metres.
FAR_M = COVERAGE_DISTANCES_M[-1]
_FAR = 255
#: The signed distance to the planes of the real side is a byte, from -SIGNED_M to SIGNED_M.
SIGNED_M = 0.5
_NO_SIGN = 255
#: Largest number of object points of a page.
MOST_POINTS = 1_000_000
#: Of one object.
_MOST_OF_OBJECT = 20_000
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
    tables = frames_of(results, pair_id)
    step_m = _step_m(tables)
    objects = plain_rows(tables.objects)
    for row in objects:
        row["sentence"] = judgement(row) if row["partner"] >= 0 else alone_judgement(row)
    return {
        "step_m": step_m,
        "sides": {side: _side_data(tables, side, most_points // 2, step_m) for side in SIDES},
        "objects": columns_of(objects, OBJECT_COLUMNS),
    }


def _step_m(tables: PairFrames) -> float:
    """The step with which the farthest coordinate of a pair fits into 16 bits."""
    farthest_m = 0.0
    for cloud in tables.clouds.values():
        for points in (cloud.points, cloud.road):
            farthest_m = max(farthest_m, float(np.abs(points).max(initial=0.0)))
    return farthest_m / _STEPS


def thinned(community: Iterable[int], most: int) -> IndexArray:
    """Indices of about `most` points, of each object the same share but not too few.

    For display only.

    Examples
    --------
    >>> import numpy as np
    >>> kept = thinned(np.repeat([0, 1], [10_000, 50]), most=1000)
    >>> np.bincount(np.repeat([0, 1], [10_000, 50])[kept]).tolist()
    [996, 50]
    """
    ids = np.asarray(community)
    share = min(1.0, most / max(1, len(ids)))
    n_all = np.bincount(ids)[ids]
    n_kept = np.maximum(_FEWEST_OF_OBJECT, np.ceil(share * n_all))
    n_kept = np.minimum(np.minimum(n_kept, n_all), _MOST_OF_OBJECT)
    place = pd.Series(ids).groupby(ids).cumcount().to_numpy()
    steps = np.floor(place * n_kept / n_all)
    kept: IndexArray = np.flatnonzero(np.floor((place + 1) * n_kept / n_all) > steps)
    return kept


def _side_data(tables: PairFrames, side: str, most: int, step_m: float) -> dict[str, Any]:
    """The points of a side: how many of each object, and the packed arrays of objects and road."""
    cloud = tables.clouds[side]
    shown = thinned(cloud.community, most)
    shown = shown[np.argsort(cloud.community[shown], kind="stable")]
    points = cloud.points[shown]
    road = _some_road(cloud.road)
    ids, counts = np.unique(cloud.community[shown], return_counts=True)
    data = {
        "n": len(cloud.points),
        "ids": ids.tolist(),
        "counts": counts.tolist(),
        "points": _packed_points(points, step_m),
        "distance": _packed(_in_bytes(tables.distances_m[side][shown] / FAR_M, _FAR)),
        "piece": _packed(tables.is_piece[side][shown]),
        "road": _packed_points(road, step_m),
    }
    if side == "sim":
        surface = tables.clouds["real"].everything
        signed = signed_distances(np.concatenate([points, road]), surface, SIGNED_M)
        steps = _in_bytes((signed / SIGNED_M + 1) / 2, _NO_SIGN - 1)
        data["signed"] = _packed(steps[: len(points)])
        data["road_signed"] = _packed(steps[len(points) :])
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
