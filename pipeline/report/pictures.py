"""Pictures of pieces as seen by a camera, places of two runs, and addresses in a report.

The camera looks from the sensor's side, where the points are; drawings have the page's colours.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any
from urllib.parse import quote, urlencode

import numpy as np

from ...schemas.columns import Row
from ...schemas.results import Piece
from ...stages.arrays import BoolArray, FloatArray
from ...stages.statistics.findings import evenly
from ...stages.surface import signed_distances
from ..results.finished import FinishedRun
from .figures.style import VIEW
from .run_frames import RunResults, frames_of, read_cloud
from .view import percent

#: Width and height of a drawing, in the units of its paths.
FRAME = (300, 210)
_MARGIN = 8.0
_MOST_DOTS = 1000
_MOST_OF_PLACE = 5000
_TURN_DEG = 25.0
_PAD_M = 0.3
#: Surroundings of a piece in its picture.
_AROUND_M = 1.0
#: The place that shows a flaw of the sensor or its pose: half its width.
_NEAR_M = 10.0
_REACH_M = 0.5


def draw_pieces(results: RunResults, pieces: Sequence[Piece]) -> list[dict[str, Any]]:
    """Pictures of the largest pieces to one scale: a piece in colour, everything else in grey.

    Without perspective; points evenly over their order where they are too many. Each picture has

    - title, words
    - link : address of the object in the report
    - layers : SVG paths of points: "others" in grey, then those of the sides
    - metre : length of a metre
    """
    drawings = []
    sizes = [np.zeros(2)]
    for piece in pieces:
        layers, name = _piece(results, piece)
        places = _seen(layers)
        drawings.append((piece, name, places))
        sizes.append(np.ptp(np.concatenate(list(places.values())), axis=0))
    room = np.array(FRAME) - 2 * _MARGIN
    scale = float((room / (np.max(sizes, axis=0) + _PAD_M)).min())
    pictures = []
    for piece, name, places in drawings:
        pictures.append(
            {
                "title": piece.words,
                "words": f"{piece.fate_words}; pair {piece.pair_id}, {piece.n_points:,} points",
                "link": object_address(piece.pair_id, name),
                "layers": {kind: _dots(points, scale) for kind, points in places.items()},
                "metre": scale,
            }
        )
    return pictures


def _dots(places: FloatArray, scale: float) -> str:
    """SVG path of dots, around the middle of a drawing."""
    dots = np.array(FRAME) / 2 + scale * _few(places, _MOST_DOTS)
    return "".join(f"M{x:.1f} {y:.1f}h0" for x, y in dots)


def _piece(results: RunResults, piece: Piece) -> tuple[dict[str, FloatArray], str]:
    """The points of a piece and those around it, and the object that most of its points are of."""
    tables = frames_of(results, piece.pair_id)
    rows = results.run.read_table("pieces", piece.pair_id).to_pandas()
    row = rows[(rows.side == piece.side) & (rows.piece_id == piece.piece_id)].iloc[0]
    moved = np.nan_to_num(row[["moved_x_m", "moved_y_m", "moved_z_m"]].to_numpy(np.float64))
    centroid = row[["cx", "cy", "cz"]].to_numpy(np.float64)
    low = np.minimum(centroid, centroid + moved) - piece.extents_m
    high = np.maximum(centroid, centroid + moved) + piece.extents_m
    layers = {}
    around = []
    for side, cloud in tables.clouds.items():
        is_drawn = side == piece.side or moved.any()
        is_piece = tables.is_piece[side] & inside(cloud.points, low, high) & is_drawn
        layers[side] = cloud.points[is_piece]
        around += [cloud.points[~is_piece], cloud.road]
        if side == piece.side:
            community = np.bincount(cloud.community[is_piece]).argmax()
    others = surroundings(layers.values(), around, _AROUND_M)
    return {"others": others, **layers}, f"{piece.side} {community}"


def _seen(layers: dict[str, FloatArray]) -> dict[str, FloatArray]:
    """Places of points as seen from the sensor's side: (n, 2) metres to the right and down."""
    points = np.concatenate(list(layers.values()))
    x, y, _ = (points.min(axis=0) + points.max(axis=0)) / 2
    azimuth = np.arctan2(-y, -x) + np.radians(_TURN_DEG)
    elevation = np.radians(VIEW["elev"])
    right = [-np.sin(azimuth), np.cos(azimuth), 0.0]
    down = [
        np.sin(elevation) * np.cos(azimuth),
        np.sin(elevation) * np.sin(azimuth),
        -np.cos(elevation),
    ]
    axes = np.array([right, down]).T
    seen = points @ axes
    middle = (seen.min(axis=0) + seen.max(axis=0)) / 2
    return {kind: layer @ axes - middle for kind, layer in layers.items()}


def draw_around_sensor(pair_id: str, runs: Sequence[FinishedRun]) -> dict[str, Any]:
    """Both simulated scans around the sensor, see `_place`."""
    corner = np.full(3, _NEAR_M)
    return _place(pair_id, -corner, corner, runs)


def draw_change(change: Row, runs: Sequence[FinishedRun]) -> dict[str, Any]:
    """Both simulated scans in the box of a real object and its counterparts, see `_place`."""
    base, other = runs
    members = [read_cloud(base, change["pair_id"], "real").split(change["real_id"])[0]]
    for run, when in ((base, "before"), (other, "after")):
        cloud = read_cloud(run, change["pair_id"], "sim")
        members.append(cloud.split(change[f"sim_{when}"])[0])
    return _place(change["pair_id"], *box_around(np.concatenate(members)), runs)


def _place(
    pair_id: str, low: FloatArray, high: FloatArray, runs: Sequence[FinishedRun]
) -> dict[str, Any]:
    """The points of both runs in a box: real ones, and simulated ones with their signed distances.

    Parameters
    ----------
    runs : the base and the other run

    Raises
    ------
    RunError
        A table is damaged or gone.
    """
    real = read_cloud(runs[0], pair_id, "real").everything
    surface = real[inside(real, low - _REACH_M, high + _REACH_M)]
    sims = []
    for run in runs:
        scan = read_cloud(run, pair_id, "sim").everything
        points = _few(scan[inside(scan, low, high)], _MOST_OF_PLACE)
        signed_m = signed_distances(points, surface, _REACH_M)
        known = signed_m[~np.isnan(signed_m)]
        words = "no simulated point with a real plane next to it"
        if len(known):
            middle_cm = 100 * float(np.median(known))
            where = "behind" if middle_cm < 0 else "in front of"
            share = percent(len(known) / len(points))
            words = (
                f"median {abs(middle_cm):.1f} cm {where} the real surface, which {share} of the "
                "simulated points have next to them"
            )
        plain = [None if np.isnan(value) else round(value, 3) for value in signed_m.tolist()]
        sims.append({"words": words, "points": _columns(points), "signed_m": plain})
    shown = _few(real[inside(real, low, high)], _MOST_OF_PLACE)
    return {"real": _columns(shown), "sims": sims}


def _columns(points: FloatArray) -> list[list[float]]:
    """All x, all y and all z of some points, rounded."""
    columns: list[list[float]] = points.T.round(2).tolist()
    return columns


def surroundings(
    members: Iterable[FloatArray], others: Iterable[FloatArray], margin_m: float = 0.0
) -> FloatArray:
    """The points of others, (n, 3), within a box around the members and a margin."""
    low, high = box_around(np.concatenate(list(members)))
    points = np.concatenate(list(others))
    return points[inside(points, low - margin_m, high + margin_m)]


def box_around(points: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Lowest and highest corner, (3,) each, of a box around points, with 0.3 m to spare."""
    return points.min(axis=0) - _PAD_M, points.max(axis=0) + _PAD_M


def inside(points: FloatArray, low: FloatArray, high: FloatArray) -> BoolArray:
    """(n,) which points lie in a box."""
    is_inside: BoolArray = np.asarray(((points >= low) & (points <= high)).all(axis=1))
    return is_inside


def object_address(pair_id: str, name: str) -> str:
    """Fragment of a report's address that opens one object.

    Examples
    --------
    >>> object_address("0007", "real 3")
    '#pair=0007&object=real%203'
    """
    return f"#{urlencode({'pair': pair_id, 'object': name}, quote_via=quote)}"


def _few(points: FloatArray, most: int) -> FloatArray:
    """At most so many of some points, evenly over their order."""
    few: FloatArray = points[evenly(len(points), most)]
    return few
