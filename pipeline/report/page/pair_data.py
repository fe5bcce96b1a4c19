"""Content of a page about one pair: its objects, the points of both sides, road, aligned nodes.

Points are integers in units of a small step. Large arrays are packed: sorted so that neighbours follow one another,
as differences of successive numbers, low bytes before high ones, deflated, in base64. The browser reverses that.
"""

from __future__ import annotations

import base64
import zlib
from collections.abc import Iterable
from typing import Any

import numpy as np
import pandas as pd

from ....schemas.columns import SIDES, Row
from ....stages.arrays import FloatArray, IndexArray
from ....stages.coverage import COVERAGE_DISTANCES_M
from ....stages.surface import signed_distances
from ...results.object_frame import plain_rows
from ..run_frames import OBJECT_COVERAGE, OBJECT_ROAD, PairFrames, RunResults, frames_of
from ..views.show_view import alone_judgement, judgement

#: Properties shown of a chosen object, the first ones at first sight; an object shows those that it has.
FACTS = (
    *("range_m", "cdc", "r_lambda", *OBJECT_COVERAGE, "centroid_distance_m", "n_real", "n_sim", "bearing_deg"),
    *("r_gap", "quadrant", *OBJECT_ROAD, "alignment_rms_m", "n_keep", "group", "status", "reason"),
    *("max_eigenvalue_shift", "laplacian_change", "eigenspectrum_distance", "gap_real", "gap_sim"),
)
#: Columns of the objects, in the order of their rows in the page.
OBJECT_COLUMNS = ("name", "real_id", "sim_id", "cx", "cy", "cz", "sentence", *FACTS)
#: The distance of a point to the other side is a byte, the largest for this many metres and more.
FAR_M = COVERAGE_DISTANCES_M[-1]
_FAR = 255
#: The signed distance to the planes of the real side is a byte from -SIGNED_M to SIGNED_M, the last one for none.
SIGNED_M = 0.5
_NO_SIGN = 255
#: Largest number of object points of a page; of an object at most `_MOST_OF_OBJECT`, at least `_FEWEST`.
MOST_POINTS = 1_000_000
_MOST_OF_OBJECT, _FEWEST = 20_000, 80
_MOST_ROAD_POINTS, _ROAD_CELL_M = 4000, 0.4
_STEPS = 32767
_RINGS_PER_RADIAN = 400


def pair_data(results: RunResults, pair_id: str, most_points: int = MOST_POINTS) -> dict[str, Any]:
    """One pair for the page: points of both sides, objects, aligned nodes.

    Parameters
    ----------
    most_points : of both sides together, about; road points come on top

    Raises
    ------
    RunError
        One of the pair's tables is damaged.
    """
    tables = frames_of(results, pair_id)
    clouds = [points for cloud in tables.clouds.values() for points in (cloud.points, cloud.road)]
    step_m = max(float(np.abs(points).max(initial=0.0)) for points in clouds) / _STEPS
    shown, sides = {}, {}
    for side, cloud in tables.clouds.items():
        chosen = thinned(cloud.community, most_points // 2)
        shown[side] = chosen[_ring_by_ring(cloud.points[chosen], cloud.community[chosen])]
        ids, counts = np.unique(cloud.community[chosen], return_counts=True)
        sides[side] = {"n": len(cloud.points), "ids": ids.tolist(), "counts": counts.tolist()}
    return {
        "step_m": step_m,
        "sides": sides,
        "n_beams": len(tables.ray_image),
        "packed": _packed(_points(tables, shown, step_m) | {"rays": tables.ray_image.ravel()}),
        "moves": {str(real_id): np.round(move, 4).tolist() for real_id, move in tables.alignment_moves.items()},
        "objects": [[row[column] for column in OBJECT_COLUMNS] for row in _with_sentences(tables.objects)],
    }


def _with_sentences(objects: pd.DataFrame) -> list[Row]:
    """The objects, each with a `sentence` on what is wrong with it."""
    rows = plain_rows(objects)
    return [row | {"sentence": judgement(row) if row["partner"] >= 0 else alone_judgement(row)} for row in rows]


def thinned(community: Iterable[int], most: int) -> IndexArray:
    """Indices of about `most` points, of each object the same share but at least `_FEWEST`; for display only.

    Examples
    --------
    >>> import numpy as np
    >>> kept = thinned(np.repeat([0, 1], [10_000, 50]), most=1000)
    >>> np.bincount(np.repeat([0, 1], [10_000, 50])[kept]).tolist()
    [996, 50]
    """
    ids = np.asarray(community)
    share = min(1.0, most / max(1, len(ids)))
    rng, chosen = np.random.default_rng(0), []
    for members in np.split(np.argsort(ids, kind="stable"), np.cumsum(np.bincount(ids))[:-1]):
        n = min(len(members), _MOST_OF_OBJECT, max(_FEWEST, int(np.ceil(share * len(members)))))
        chosen.append(rng.choice(members, n, replace=False))
    kept: IndexArray = np.sort(np.concatenate(chosen))
    return kept


def _ring_by_ring(points: FloatArray, first: Any) -> IndexArray:
    """Order of points by `first`, by elevation and by azimuth: neighbours follow one another."""
    elevation = np.arctan2(points[:, 2], np.hypot(points[:, 0], points[:, 1]))
    azimuth = np.arctan2(points[:, 1], points[:, 0])
    order: IndexArray = np.lexsort((azimuth, np.rint(elevation * _RINGS_PER_RADIAN), first))
    return order


def _points(tables: PairFrames, shown: dict[str, IndexArray], step_m: float) -> dict[str, Any]:
    """Packed columns of a pair by name; `lines` are the places of aligned nodes among the points of either side."""
    columns: dict[str, Any] = {}
    lines = np.ones(len(tables.selection), dtype=bool)
    places = {}
    real = np.concatenate([tables.clouds["real"].points, tables.clouds["real"].road])
    for side, own in shown.items():
        cloud, road = tables.clouds[side], _some_road(tables.clouds[side].road)
        place = np.full(len(cloud.points), -1)
        place[own] = np.arange(len(own))
        nodes = np.searchsorted(cloud.point_ids, tables.selection[f"{side}_point_id"])
        places[side] = place[nodes]
        lines &= places[side] >= 0
        columns |= _in_steps(side, cloud.points[own], step_m)
        columns[f"{side}_distance"] = _in_bytes(tables.distances_m[side][own] / FAR_M, _FAR)
        columns[f"{side}_kept"] = np.isin(own, nodes).astype(np.uint8)
        columns[f"{side}_piece"] = tables.is_piece[side][own].astype(np.uint8)
        columns |= _in_steps(f"{side}_road", road, step_m)
        if side == "sim":
            signed = signed_distances(np.concatenate([cloud.points[own], road]), real, SIGNED_M)
            signs = _in_bytes((signed / SIGNED_M + 1) / 2, _NO_SIGN - 1)
            columns["sim_signed"], columns["sim_road_signed"] = np.split(signs, [len(own)])
    order = np.argsort(places["real"][lines], kind="stable")
    return columns | {f"{side}_line": places[side][lines][order].astype(np.int32) for side in SIDES}


def _some_road(road: FloatArray) -> FloatArray:
    """Road points evenly over the ground, one a cell and not more than `_MOST_ROAD_POINTS`; for display only."""
    _, first = np.unique(np.floor(road[:, :2] / _ROAD_CELL_M), axis=0, return_index=True)
    if len(first) > _MOST_ROAD_POINTS:
        first = np.random.default_rng(0).choice(first, _MOST_ROAD_POINTS, replace=False)
    return road[first][_ring_by_ring(road[first], np.zeros(len(first)))]


def _in_steps(name: str, points: FloatArray, step_m: float) -> dict[str, Any]:
    steps = np.rint(points / step_m).astype(np.int16)
    return {f"{name}_{axis}": values for axis, values in zip("xyz", steps.T, strict=True)}


def _in_bytes(share: FloatArray, whole: int) -> Any:
    """Shares of `whole`, cut off at 0 and 1; NaN is `_NO_SIGN`."""
    return np.nan_to_num(np.rint(whole * np.clip(share, 0, 1)), nan=_NO_SIGN).astype(np.uint8)


def _packed(columns: dict[str, Any]) -> dict[str, Any]:
    """Columns of bytes as they are, of wider integers as differences (modulo their width), low bytes first."""
    content, parts = b"", []
    for name, values in columns.items():
        width = values.dtype.itemsize
        steps = values if width == 1 else np.diff(values, prepend=values.dtype.type(0)).astype(f"<i{width}")
        content += np.ascontiguousarray(steps).view(np.uint8).reshape(-1, width).T.tobytes()
        parts.append([name, width, len(values)])
    return {"parts": parts, "deflated": base64.b64encode(zlib.compress(content, 6)).decode("ascii")}
