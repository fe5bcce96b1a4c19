"""Pictures of pieces as seen by a camera, the points of objects that changed, and addresses of objects in a report.

The camera looks from the sensor's side, where the points are; the drawings have the colours of the page.
"""

from __future__ import annotations

import cmath
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any
from urllib.parse import quote, urlencode

import numpy as np

from ...schemas.columns import SIDES
from ...schemas.metric_catalogue import METRIC
from ...schemas.results import Piece
from ...stages.arrays import BoolArray, FloatArray
from ..results.finished import FinishedRun
from ..results.followed import SHARED_SCORES, ObjectChange
from .aggregates import evenly
from .figures.style import VIEW
from .run_frames import GROUND_COLUMNS, Cloud, PairFrames, RunResults
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


@dataclass(frozen=True)
class Picture:
    """A drawing with its title and words.

    link : address of the object in the report
    layers : SVG paths of points: "others" in grey, then those of the sides
    ahead : SVG path of a needle that points ahead
    bar, bar_m : a bar of some metres as the scale
    """

    title: str
    words: str
    link: str
    layers: dict[str, str]
    ahead: str
    bar: float
    bar_m: float


@dataclass(frozen=True)
class _Box:
    """Content of a picture: points by kind, (n, 3), and the address of an object."""

    layers: dict[str, FloatArray]
    link: str

    @property
    def points(self) -> FloatArray:
        """All points, which the picture is as wide and as high as."""
        return np.concatenate([*self.layers.values()])

    @property
    def axes(self) -> FloatArray:
        """Right and up of the picture, (2, 3): from the sensor's side, turned by 25 degrees, and from above."""
        x, y, _ = (self.points.min(axis=0) + self.points.max(axis=0)) / 2
        azimuth = np.arctan2(-y, -x) + np.radians(_TURN_DEG)
        elevation = np.radians(VIEW["elev"])
        up = [-np.sin(elevation) * np.cos(azimuth), -np.sin(elevation) * np.sin(azimuth), np.cos(elevation)]
        return np.array([[-np.sin(azimuth), np.cos(azimuth), 0.0], up])

    @property
    def span(self) -> FloatArray:
        """Lowest and highest place of the points along right and up, (2, 2)."""
        places = self.points @ self.axes.T
        return np.stack([places.min(axis=0), places.max(axis=0)])

    @property
    def scale(self) -> float:
        """The largest scale at which the box fits into a drawing, units per metre."""
        return float(((np.array(FRAME) - 2 * _MARGIN) / (np.ptp(self.span, axis=0) + _PAD_M)).min())

    def drawn(self, scale: float, title: str, words: str) -> Picture:
        """A picture without perspective, true to scale; points evenly over their order where they are too many."""
        middle, paths = self.span.mean(axis=0), {}
        for kind, points in self.layers.items():
            right, up = ((_few(points) @ self.axes.T - middle) * scale).T
            dots = zip(FRAME[0] / 2 + right, FRAME[1] / 2 - up, strict=True)
            paths[kind] = "".join(f"M{x:.1f} {y:.1f}h0" for x, y in dots)
        bar_m = max((m for m in _BARS_M if m * scale <= FRAME[0] / 3), default=_BARS_M[0])
        needle = 16 * complex(*self.axes[:, 0] * (1, -1))
        barbs = [needle * cmath.rect(0.4, turn) for turn in (2.6, -2.6)]
        middle_px = complex(FRAME[0] - 66, FRAME[1] - 8)
        ends = [middle_px - needle / 2, tip := middle_px + needle / 2, tip + barbs[0], tip, tip + barbs[1]]
        ahead = "M" + "L".join(f"{end.real:.1f} {end.imag:.1f}" for end in ends)
        return Picture(title, words, self.link, paths, ahead, bar_m * scale, bar_m)


def draw_pieces(results: RunResults, pieces: Sequence[Piece]) -> list[Picture]:
    """Pictures of the largest pieces, all to one scale: in colour the piece's points, everything else in grey."""
    boxes = [_piece(results, piece) for piece in pieces]
    scale = min((box.scale for box in boxes), default=1.0)
    words = [f"{one.fate_words}; pair {one.pair_id}, {one.n_points:,} points" for one in pieces]
    return [box.drawn(scale, one.words, text) for one, text, box in zip(pieces, words, boxes, strict=True)]


def _piece(results: RunResults, piece: Piece) -> _Box:
    """The points of a piece and those around it, with the address of the object that most of its points belong to."""
    tables = PairFrames(results, piece.pair_id)
    clouds = tables.clouds
    row = next(
        row
        for row in results.run.read_table("pieces", piece.pair_id).to_pylist()
        if (row["side"], row["piece_id"]) == (piece.side, piece.piece_id)
    )
    centre, extents = np.array([row["cx"], row["cy"], row["cz"]]), np.array(piece.extents_m)
    moved = np.array([row[f"moved_{axis}_m"] or 0.0 for axis in "xyz"])
    ends = np.stack([centre, centre + moved])
    low, high = ends.min(axis=0) - extents, ends.max(axis=0) + extents
    sides = SIDES if moved.any() else (piece.side,)
    is_own = {side: tables.is_piece(side) & inside(clouds[side].points, low, high) for side in sides}
    low, high = box_around(np.concatenate([clouds[side].points[own] for side, own in is_own.items()]))
    low, high = low - _AROUND_M, high + _AROUND_M
    around = [
        *(clouds[side].points[~is_own.get(side, np.zeros(len(clouds[side].points), np.bool_))] for side in SIDES),
        *tables.road.values(),
    ]
    others = np.concatenate([points[inside(points, low, high)] for points in around])
    layers = {"others": others, **{side: clouds[side].points[own] for side, own in is_own.items()}}
    communities = clouds[piece.side].community[is_own[piece.side]]
    return _Box(layers, object_address(piece.pair_id, f"{piece.side} {np.bincount(communities).argmax()}"))


def draw_change(change: ObjectChange, runs: Sequence[FinishedRun]) -> list[dict[str, Any]]:
    """The points of a real object, and the simulated ones before and after: words, own points, others in its box.

    Parameters
    ----------
    runs : the base and the other run

    Raises
    ------
    RunError
        A table is damaged or gone.
    """
    clouds = [_cloud(runs[0], change.pair_id, "real"), *(_cloud(run, change.pair_id, "sim") for run in runs)]
    ids = (change.real_id, change.sim_before, change.sim_after)
    is_own = [np.equal(cloud.community, np.nan if i is None else i) for cloud, i in zip(clouds, ids, strict=True)]
    low, high = box_around(np.concatenate([cloud.points[own] for cloud, own in zip(clouds, is_own, strict=True)]))
    places = []
    for cloud, own, when in zip(clouds, is_own, ("", "before", "after"), strict=True):
        others = inside(cloud.points, low, high) & ~own
        scores = {METRIC[score].label: getattr(change, f"{score}_{when}") for score in SHARED_SCORES if when}
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
    is_outside = (points < low) | (points > high)
    return ~is_outside[:, 0] & ~is_outside[:, 1] & ~is_outside[:, 2]


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


def _cloud(run: FinishedRun, pair_id: str, side: str) -> Cloud:
    """The object points of a side."""
    ground = run.read_table("ground", pair_id, side, GROUND_COLUMNS).to_pandas()
    return Cloud.of(ground, run.read_table("communities", pair_id, side, ["community_id"]).to_pandas())
