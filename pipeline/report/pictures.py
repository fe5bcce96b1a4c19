"""Pictures of pieces as seen by a camera, points of changed objects, and addresses in a report.

The camera looks from the sensor's side, where the points are; drawings have the page's colours.
"""

from __future__ import annotations

import cmath
from collections.abc import Iterable, Sequence
from typing import Any
from urllib.parse import quote, urlencode

import numpy as np

from ...schemas.columns import Row
from ...schemas.metric_catalogue import METRIC, QUADRANT_SCORES
from ...schemas.results import Piece
from ...stages.arrays import BoolArray, FloatArray
from ...stages.statistics.findings import evenly
from ..results.finished import FinishedRun
from .figures.style import VIEW
from .run_frames import RunResults, frames_of, read_cloud
from .view import number

#: Width and height of a drawing, in the units of its paths.
FRAME = (300, 210)
_MARGIN = 8.0
_MOST_DOTS = 1000
_TURN_DEG = 25.0
_PAD_M = 0.3
_BARS_M = (0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0)
#: Surroundings of a piece in its picture.
_AROUND_M = 1.0
_ARROW_LENGTH = 16.0
#: Directions of the two ends of an arrow's head, relative to its shaft.
_HEAD = (cmath.rect(0.4, 2.6), cmath.rect(0.4, -2.6))


def draw_pieces(results: RunResults, pieces: Sequence[Piece]) -> list[dict[str, Any]]:
    """Pictures of the largest pieces to one scale: a piece in colour, everything else in grey.

    Without perspective; points evenly over their order where they are too many. Each picture has

    - title, words
    - link : address of the object in the report
    - layers : SVG paths of points: "others" in grey, then those of the sides
    - ahead : SVG path of an arrow that points ahead
    - bar, bar_m : a bar of some metres as the scale
    """
    sizes = [np.full(2, _PAD_M)]
    drawings = []
    for piece in pieces:
        layers, name = _piece(results, piece)
        places, ahead = _seen(layers)
        everywhere = np.concatenate(list(places.values()))
        sizes.append(np.ptp(everywhere, axis=0) + _PAD_M)
        drawings.append((piece, name, places, ahead))
    room = np.array(FRAME) - 2 * _MARGIN
    scale = float((room / np.max(sizes, axis=0)).min())
    fitting = [m for m in _BARS_M if m * scale <= FRAME[0] / 3]
    bar_m = max(fitting, default=_BARS_M[0])
    pictures = []
    for piece, name, places, ahead in drawings:
        pictures.append(
            {
                "title": piece.words,
                "words": f"{piece.fate_words}; pair {piece.pair_id}, {piece.n_points:,} points",
                "link": object_address(piece.pair_id, name),
                "layers": {kind: _dots(points, scale) for kind, points in places.items()},
                "ahead": _arrow(_ARROW_LENGTH * complex(*ahead)),
                "bar": bar_m * scale,
                "bar_m": bar_m,
            }
        )
    return pictures


def _dots(places: FloatArray, scale: float) -> str:
    """SVG path of dots, around the middle of a drawing."""
    dots = np.array(FRAME) / 2 + scale * _few(places)
    return "".join(f"M{x:.1f} {y:.1f}h0" for x, y in dots)


def _piece(results: RunResults, piece: Piece) -> tuple[dict[str, FloatArray], str]:
    """The points of a piece and those around it, and the object that most of its points are of."""
    tables = frames_of(results, piece.pair_id)
    row = _row_of(results.run, piece)
    moved = np.array([row[f"moved_{axis}_m"] or 0.0 for axis in "xyz"])
    centroid = np.array([row[f"c{axis}"] for axis in "xyz"])
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


def _row_of(run: FinishedRun, piece: Piece) -> Row:
    """The row of table `pieces` of a piece."""
    rows: list[Row] = run.read_table("pieces", piece.pair_id).to_pylist()
    for row in rows:
        if row["side"] == piece.side and row["piece_id"] == piece.piece_id:
            return row
    raise KeyError(piece.piece_id)


def _seen(layers: dict[str, FloatArray]) -> tuple[dict[str, FloatArray], FloatArray]:
    """Places of points as seen from the sensor's side, and the direction ahead.

    Places, (n, 2), are metres to the right and down of the middle.
    """
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
    return {kind: layer @ axes - middle for kind, layer in layers.items()}, axes[0]


def _arrow(shaft: complex) -> str:
    """SVG path of an arrow at the lower right of a drawing."""
    tip = complex(FRAME[0] - 66, FRAME[1] - 8) + shaft / 2
    left, right = [tip + shaft * direction for direction in _HEAD]
    ends = (tip - shaft, tip, left, tip, right)
    return "M" + "L".join(f"{end.real:.1f} {end.imag:.1f}" for end in ends)


def draw_change(change: Row, runs: Sequence[FinishedRun]) -> list[dict[str, Any]]:
    """The points of a real object, and the simulated ones before and after.

    Each with words, its own points, and other points in its box.

    Parameters
    ----------
    runs : the base and the other run

    Raises
    ------
    RunError
        A table is damaged or gone.
    """
    base, other = runs
    pair_id = change["pair_id"]
    views = {
        "": read_cloud(base, pair_id, "real").split(change["real_id"]),
        "before": read_cloud(base, pair_id, "sim").split(change["sim_before"]),
        "after": read_cloud(other, pair_id, "sim").split(change["sim_after"]),
    }
    members = [points for points, _ in views.values()]
    places = []
    for when, (points, others) in views.items():
        near = surroundings(members, [others])
        words = [f"{len(points):,} points"]
        if when:
            for score in QUADRANT_SCORES:
                words.append(f"{METRIC[score].label} {number(change[f'{score}_{when}'])}")
        if not len(points):
            words = [f"not matched; {len(near):,} points of other objects here"]
        places.append(
            {"words": ", ".join(words), "own": _columns(points), "others": _columns(near)}
        )
    return places


def _columns(points: FloatArray) -> list[list[float]]:
    """All x, all y and all z of some points, rounded."""
    columns: list[list[float]] = _few(points).T.round(2).tolist()
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


def _few(points: FloatArray) -> FloatArray:
    """At most `_MOST_DOTS` of some points, evenly over their order."""
    places = np.array(evenly(len(points), _MOST_DOTS), dtype=np.intp)
    few: FloatArray = points[places]
    return few
