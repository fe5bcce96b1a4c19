"""Pictures of one object: dots as seen by a camera, and the address at which a report shows it in 3D.

The camera looks from the sensor's side, where the points are; the drawings have the colours of the page.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any
from urllib.parse import quote, urlencode

import numpy as np

from ...schemas.columns import SIDES
from ...schemas.metric_catalogue import METRIC
from ...schemas.results import Evidence, Piece
from ...stages.arrays import BoolArray, FloatArray
from ..results.finished import FinishedRun
from ..results.followed import SHARED_SCORES, ObjectChange
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

    link : address of the object in a report; "" if there is none
    layers : SVG paths of points: "others" in grey, then those of the sides
    bar, bar_m : a bar of some metres as the scale
    points : the same dots in metres by layer: lists of x, y and z
    """

    title: str
    words: str
    link: str
    layers: dict[str, str]
    bar: float
    bar_m: float
    points: dict[str, list[list[float]]]


@dataclass(frozen=True)
class _Box:
    """Content of a picture.

    low, high : corners of a box, (3,) each, whose middle the camera looks at
    layers : points by kind, (n, 3)
    framed : points that the picture is as wide and as high as, (n, 3)
    """

    low: FloatArray
    high: FloatArray
    layers: dict[str, FloatArray]
    framed: FloatArray

    @property
    def axes(self) -> FloatArray:
        """Right and up of the picture, (2, 3): from the sensor's side, turned by 25 degrees, and from above."""
        centre = (self.low + self.high) / 2
        azimuth = np.arctan2(-centre[1], -centre[0]) + np.radians(_TURN_DEG)
        elevation = np.radians(VIEW["elev"])
        up = [-np.sin(elevation) * np.cos(azimuth), -np.sin(elevation) * np.sin(azimuth), np.cos(elevation)]
        return np.array([[-np.sin(azimuth), np.cos(azimuth), 0.0], up])

    @property
    def span(self) -> FloatArray:
        """Lowest and highest place of the points along right and up, (2, 2)."""
        places = self.framed @ self.axes.T
        return np.stack([places.min(axis=0), places.max(axis=0)])

    @property
    def scale(self) -> float:
        """The largest scale at which the box fits into a drawing, units per metre."""
        return float(((np.array(FRAME) - 2 * _MARGIN) / (np.ptp(self.span, axis=0) + _PAD_M)).min())

    def drawn(self, scale: float, title: str, words: str, link: str = "") -> Picture:
        """A picture without perspective, true to scale; points evenly over their order where they are too many."""
        middle, paths, kept = self.span.mean(axis=0), {}, {}
        for kind, points in self.layers.items():
            n = min(len(points), _MOST_DOTS)
            chosen = points[np.unique(np.linspace(0, len(points) - 1, n).round().astype(int))]
            kept[kind] = chosen.T.round(2).tolist()
            right, up = ((chosen @ self.axes.T - middle) * scale).T
            dots = zip(FRAME[0] / 2 + right, FRAME[1] / 2 - up, strict=True)
            paths[kind] = "".join(f"M{x:.1f} {y:.1f}h0" for x, y in dots)
        bar_m = max((m for m in _BARS_M if m * scale <= FRAME[0] / 3), default=_BARS_M[0])
        return Picture(title, words, link, paths, bar_m * scale, bar_m, kept)


def draw_pieces(results: RunResults, pieces: Sequence[Piece]) -> list[Picture]:
    """Pictures of the largest pieces, all to one scale: in colour the piece's points, everything else in grey."""
    found = [_piece(results, piece) for piece in pieces]
    scale = min((box.scale for box, _ in found), default=1.0)
    words = [f"{one.fate_words}; pair {one.pair_id}, {one.n_points:,} points" for one in pieces]
    return [
        box.drawn(scale, one.words, text, link) for one, text, (box, link) in zip(pieces, words, found, strict=True)
    ]


def _piece(results: RunResults, piece: Piece) -> tuple[_Box, str]:
    """The box around a piece, and the address of the object that most of its points belong to."""
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
    return _Box(low, high, layers, np.concatenate([*layers.values()])), object_address(
        piece.pair_id, f"{piece.side} {np.bincount(communities).argmax()}"
    )


def draw_change(change: ObjectChange, runs: Sequence[FinishedRun], links: Sequence[str]) -> list[Picture]:
    """Fate of an object: real points, simulated before and after, in one box and from one side.

    Parameters
    ----------
    runs : the base and the other run
    links : address of the object in the report of each; "" if there is none

    Raises
    ------
    RunError
        A table is damaged or gone.
    """
    real = _cloud(runs[0], change.pair_id, "real")
    clouds = [real, *(_cloud(run, change.pair_id, "sim") for run in runs)]
    is_own = [
        np.zeros(len(cloud.points), dtype=np.bool_) if own is None else cloud.community == own
        for cloud, own in zip(clouds, (change.real_id, change.sim_before, change.sim_after), strict=True)
    ]
    low, high = box_around(np.concatenate([cloud.points[own] for cloud, own in zip(clouds, is_own, strict=True)]))
    framed = np.concatenate([cloud.points[inside(cloud.points, low, high)] for cloud in clouds])
    words = [f"{change.n_points:,} points"]
    for cloud, own, when in zip(clouds[1:], is_own[1:], ("before", "after"), strict=True):
        scores = [f"{METRIC[score].label} {number(getattr(change, f'{score}_{when}'))}" for score in SHARED_SCORES]
        n_others = np.count_nonzero(inside(cloud.points, low, high))
        words.append(
            f"{own.sum():,} points, {', '.join(scores)}"
            if own.any()
            else f"not matched; {n_others:,} points of other objects here"
        )
    pictures = []
    titles = ("real", "simulated, before", "simulated, after")
    for title, text, cloud, own, link in zip(titles, words, clouds, is_own, ("", *links), strict=True):
        others = cloud.points[~own & inside(cloud.points, low, high)]
        box = _Box(low, high, {"others": others, "real" if cloud is real else "sim": cloud.points[own]}, framed)
        pictures.append(box.drawn(box.scale, title, text, link))
    return pictures


def draw_evidence(evidence: Evidence) -> dict[str, Any]:
    """Curves of the evidence of a cause in the frame of a drawing, with labels and the ends of the axis."""
    sides = {"real": evidence.real, "corrected": evidence.corrected, "sim": evidence.sim}
    known = {side: np.array(values) for side, values in sides.items() if values is not None}
    shown = np.flatnonzero(np.max([*known.values()], axis=0))
    own = slice(max(0, shown[0] - 1), shown[-1] + 2) if len(shown) else slice(None)
    x, highest = np.array(evidence.x)[own], max(values.max() for values in known.values()) or 1.0
    across = 24 + 268 * (x - x[0]) / (np.ptp(x) or 1.0)
    paths = {}
    for side, values in known.items():
        dots = zip(across, 180 - 150 * values[own] / highest, strict=True)
        paths[side] = "M" + "L".join(f"{a:.1f} {b:.1f}" for a, b in dots)
    ends = [f"{end:.4g}" for end in (x[0], x[-1])]
    return {"paths": paths, "ends": ends, "x_label": evidence.x_label, "y_label": evidence.y_label}


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


def _cloud(run: FinishedRun, pair_id: str, side: str) -> Cloud:
    """The object points of a side."""
    ground = run.read_table("ground", pair_id, side, GROUND_COLUMNS).to_pandas()
    return Cloud.of(ground, run.read_table("communities", pair_id, side, ["community_id"]).to_pandas())
