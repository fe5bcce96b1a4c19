"""Pictures of pieces as seen by a camera, the points of objects that changed, and addresses of objects in a report.

The camera looks from the sensor's side, where the points are; the drawings have the colours of the page.
"""

from __future__ import annotations

import cmath
from collections.abc import Sequence
from typing import Any
from urllib.parse import quote, urlencode

import numpy as np

from ...schemas.columns import Row
from ...schemas.metric_catalogue import METRIC
from ...schemas.results import Piece
from ...stages.arrays import BoolArray, FloatArray
from ...stages.statistics.findings import evenly
from ..results.finished import FinishedRun
from ..results.followed import SHARED_SCORES
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


def draw_pieces(results: RunResults, pieces: Sequence[Piece]) -> list[dict[str, Any]]:
    """Pictures of the largest pieces, all to one scale: in colour the piece's points, everything else in grey.

    Without perspective; points evenly over their order where they are too many. Each picture has

    - title, words
    - link : address of the object in the report
    - layers : SVG paths of points: "others" in grey, then those of the sides
    - ahead : SVG path of an arrow that points ahead
    - bar, bar_m : a bar of some metres as the scale
    """
    shown = [_piece(results, piece) for piece in pieces]
    views = [_seen(layers) for layers, _ in shown]
    extents = [np.ptp(np.concatenate([*places.values()]), axis=0) + _PAD_M for places, _ in views]
    scale = float(((np.array(FRAME) - 2 * _MARGIN) / np.max(extents, axis=0, initial=_PAD_M)).min())
    bar_m = max((m for m in _BARS_M if m * scale <= FRAME[0] / 3), default=_BARS_M[0])
    drawn = []
    for piece, (_, name), (places, ahead) in zip(pieces, shown, views, strict=True):
        dots = {kind: np.array(FRAME) / 2 + scale * _few(own) for kind, own in places.items()}
        drawn.append(
            {
                "title": piece.words,
                "words": f"{piece.fate_words}; pair {piece.pair_id}, {piece.n_points:,} points",
                "link": object_address(piece.pair_id, name),
                "layers": {kind: "".join(f"M{x:.1f} {y:.1f}h0" for x, y in own) for kind, own in dots.items()},
                "ahead": _arrow(16 * complex(*ahead)),
                "bar": bar_m * scale,
                "bar_m": bar_m,
            }
        )
    return drawn


def _piece(results: RunResults, piece: Piece) -> tuple[dict[str, FloatArray], str]:
    """The points of a piece and those around it, and the object that most of its points belong to."""
    tables = frames_of(results, piece.pair_id)
    row = next(
        row
        for row in results.run.read_table("pieces", piece.pair_id).to_pylist()
        if (row["side"], row["piece_id"]) == (piece.side, piece.piece_id)
    )
    moved = np.array([row[f"moved_{axis}_m"] or 0.0 for axis in "xyz"])
    ends = np.array([row[f"c{axis}"] for axis in "xyz"]) + np.array([np.zeros(3), moved])
    low, high = ends.min(axis=0) - piece.extents_m, ends.max(axis=0) + piece.extents_m
    own = {
        side: tables.is_piece[side] & inside(cloud.points, low, high) & np.bool_(side == piece.side or moved.any())
        for side, cloud in tables.clouds.items()
    }
    layers = {side: cloud.points[own[side]] for side, cloud in tables.clouds.items()}
    low, high = box_around(np.concatenate([*layers.values()]))
    around = [points for side, cloud in tables.clouds.items() for points in (cloud.points[~own[side]], cloud.road)]
    others = [points[inside(points, low - _AROUND_M, high + _AROUND_M)] for points in around]
    community = np.bincount(tables.clouds[piece.side].community[own[piece.side]]).argmax()
    return {"others": np.concatenate(others), **layers}, f"{piece.side} {community}"


def _seen(layers: dict[str, FloatArray]) -> tuple[dict[str, FloatArray], FloatArray]:
    """Places of points, (n, 2) metres right and down of the middle, as seen from the sensor's side; where ahead is."""
    points = np.concatenate([*layers.values()])
    x, y, _ = (points.min(axis=0) + points.max(axis=0)) / 2
    azimuth, elevation = np.arctan2(-y, -x) + np.radians(_TURN_DEG), np.radians(VIEW["elev"])
    down = [np.sin(elevation) * np.cos(azimuth), np.sin(elevation) * np.sin(azimuth), -np.cos(elevation)]
    axes = np.array([[-np.sin(azimuth), np.cos(azimuth), 0.0], down]).T
    middle = ((points @ axes).min(axis=0) + (points @ axes).max(axis=0)) / 2
    return {kind: own @ axes - middle for kind, own in layers.items()}, axes[0]


def _arrow(shaft: complex) -> str:
    """SVG path of an arrow at the lower right of a drawing."""
    tip = complex(FRAME[0] - 66, FRAME[1] - 8) + shaft / 2
    ends = (tip - shaft, tip, tip + shaft * cmath.rect(0.4, 2.6), tip, tip + shaft * cmath.rect(0.4, -2.6))
    return "M" + "L".join(f"{end.real:.1f} {end.imag:.1f}" for end in ends)


def draw_change(change: Row, runs: Sequence[FinishedRun]) -> list[dict[str, Any]]:
    """The points of a real object, and the simulated ones before and after: words, own points, others in its box.

    Parameters
    ----------
    runs : the base and the other run

    Raises
    ------
    RunError
        A table is damaged or gone.
    """
    pair = change["pair_id"]
    clouds = [read_cloud(runs[0], pair, "real"), *(read_cloud(run, pair, "sim") for run in runs)]
    ids = (change["real_id"], change["sim_before"], change["sim_after"])
    is_own = [np.equal(cloud.community, np.nan if i is None else i) for cloud, i in zip(clouds, ids, strict=True)]
    low, high = box_around(np.concatenate([cloud.points[own] for cloud, own in zip(clouds, is_own, strict=True)]))
    places = []
    for cloud, own, when in zip(clouds, is_own, ("", "before", "after"), strict=True):
        others = inside(cloud.points, low, high) & ~own
        scores = {METRIC[score].label: change[f"{score}_{when}"] for score in SHARED_SCORES if when}
        words = ", ".join([f"{own.sum():,} points", *(f"{name} {number(value)}" for name, value in scores.items())])
        if not own.any():
            words = f"not matched; {others.sum():,} points of other objects here"
        layers = {"own": cloud.points[own], "others": cloud.points[others]}
        places.append({"words": words} | {kind: _few(points).T.round(2).tolist() for kind, points in layers.items()})
    return places


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
    few: FloatArray = points[np.array(evenly(len(points), _MOST_DOTS), dtype=np.intp)]
    return few
