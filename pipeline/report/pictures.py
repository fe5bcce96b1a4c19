"""Pictures of one object: dots as seen by a camera, and the address at which a report shows it in 3D.

The camera looks from the sensor's side, where the points are; the drawings have the colours of the page.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from urllib.parse import quote, urlencode

import numpy as np
from scipy.spatial import KDTree

from ...schemas.columns import SIDES
from ...schemas.metric_catalogue import METRIC
from ...schemas.results import Piece
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
    """

    title: str
    words: str
    link: str
    layers: dict[str, str]
    bar: float
    bar_m: float


def draw_object(
    low: FloatArray, high: FloatArray, layers: dict[str, FloatArray], title: str, words: str, link: str = ""
) -> Picture:
    """A picture of a box from the sensor's side, from above, without perspective; true to scale.

    Parameters
    ----------
    low, high : corners of the box, (3,)
    layers : points by kind, (n, 3); evenly over their order where they are too many
    """
    centre = (low + high) / 2
    azimuth = np.arctan2(-centre[1], -centre[0]) + np.radians(_TURN_DEG)
    elevation = np.radians(VIEW["elev"])
    right = np.array([-np.sin(azimuth), np.cos(azimuth), 0.0])
    up = np.array([-np.sin(elevation) * np.cos(azimuth), -np.sin(elevation) * np.sin(azimuth), np.cos(elevation)])
    corners = np.stack(np.meshgrid(*np.stack([low, high], axis=1)), axis=-1).reshape(-1, 3)
    u, v = corners @ right, corners @ up
    scale = float(((np.array(FRAME) - 2 * _MARGIN) / np.array([np.ptp(u), np.ptp(v)])).min())
    middle = (u.min() + u.max()) / 2, (v.min() + v.max()) / 2
    paths = {}
    for kind, points in layers.items():
        chosen = points[np.unique(np.linspace(0, len(points) - 1, min(len(points), _MOST_DOTS)).round().astype(int))]
        x = FRAME[0] / 2 + (chosen @ right - middle[0]) * scale
        y = FRAME[1] / 2 - (chosen @ up - middle[1]) * scale
        paths[kind] = "".join(f"M{a:.1f} {b:.1f}h0" for a, b in zip(x, y, strict=True))
    bar_m = max((m for m in _BARS_M if m * scale <= FRAME[0] / 3), default=_BARS_M[0])
    return Picture(title, words, link, paths, bar_m * scale, bar_m)


def draw_piece(results: RunResults, piece: Piece) -> Picture:
    """The box around one of the largest pieces: in colour the points that the other side lacks, others in grey."""
    tables = PairFrames(results, piece.pair_id)
    clouds = tables.clouds
    everything = {side: np.concatenate([clouds[side].points, tables.road[side]]) for side in SIDES}
    reach_m = float(str(results.run.record.settings["pieces"]["reach_m"]))
    row = next(
        row
        for row in results.run.read_table("pieces", piece.pair_id).to_pylist()
        if (row["side"], row["piece_id"]) == (piece.side, piece.piece_id)
    )
    centre, extents = np.array([row["cx"], row["cy"], row["cz"]]), np.array(piece.extents_m)
    moved = np.array([row[f"moved_{axis}_m"] or 0.0 for axis in "xyz"])
    ends = np.stack([centre, centre + moved])
    low, high = ends.min(axis=0) - extents, ends.max(axis=0) + extents
    own, alone = clouds[piece.side], {}
    for side, other in (SIDES, SIDES[::-1]):
        points = clouds[side].points[inside(clouds[side].points, low, high)]
        alone[side] = points[KDTree(everything[other]).query(points)[0] > reach_m]
    low, high = box_around(np.concatenate([*alone.values()]))
    low, high = low - _AROUND_M, high + _AROUND_M
    around = np.concatenate([points[inside(points, low, high)] for points in everything.values()])
    communities = own.community[inside(own.points, *box_around(alone[piece.side]))]
    words = f"{piece.fate_words}; pair {piece.pair_id}, {piece.n_points:,} points"
    link = object_address(piece.pair_id, f"{piece.side} {np.bincount(communities).argmax()}")
    return draw_object(low, high, {"others": around, **alone}, piece.words, words, link)


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
        layers = {"others": others, "real" if cloud is real else "sim": cloud.points[own]}
        pictures.append(draw_object(low, high, layers, title, text, link))
    return pictures


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
