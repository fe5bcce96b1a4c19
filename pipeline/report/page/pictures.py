"""Pictures of objects that have changed: real points, simulated before and after, in one box and from one side.

They stand in the page as drawings of its own colours. The camera looks from the sensor's side, where the points are.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import quote, urlencode

import numpy as np

from ....schemas.metrics import METRIC
from ....stages.arrays import BoolArray, FloatArray
from ...results.finished import FinishedRun
from ...results.followed import SHARED_SCORES, ObjectChange
from ...storage.tables import file_stem
from ..figures.style import VIEW
from ..results import Cloud
from ..terminal.layout import number
from .page import PAGE, PAGES

#: Width and height of a panel, in the units of its paths.
FRAME = (300, 210)
_MARGIN = 8.0
_MOST_DOTS = 1000
_TURN_DEG = 25.0
_TITLES = ("real", "simulated, before", "simulated, after")
_PAD_M = 0.3
_BARS_M = (0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0)


@dataclass(frozen=True)
class Panel:
    """One of the three views of an object.

    own, others : SVG paths of its points, and of those of other objects in the box
    link : to the object in the run's report; "" where there is none
    """

    title: str
    words: str
    own: str
    others: str
    link: str = ""


@dataclass(frozen=True)
class Picture:
    """What has become of an object, a sentence that names it, three panels, and a bar of some metres as their scale."""

    kind: str
    sentence: str
    panels: tuple[Panel, ...]
    bar: float
    bar_m: float


def draw_change(change: ObjectChange, base: FinishedRun, other: FinishedRun, start: Path) -> Picture:
    """The picture of one object.

    Parameters
    ----------
    start : folder of the page, which links begin at

    Raises
    ------
    RunError
        A table is damaged or gone.
    """
    real = _cloud(base, change.pair_id, "real")
    sims = [_cloud(run, change.pair_id, "sim") for run in (base, other)]
    is_real = real.community == change.real_id
    is_own = [
        np.zeros(len(cloud.points), dtype=np.bool_) if own is None else cloud.community == own
        for cloud, own in zip(sims, (change.sim_before, change.sim_after), strict=True)
    ]
    shown = [real.points[is_real], *(cloud.points[own] for cloud, own in zip(sims, is_own, strict=True))]
    box = np.concatenate(shown)
    low, high = box.min(axis=0) - _PAD_M, box.max(axis=0) + _PAD_M
    camera = _Camera(low, high)
    words, links = [f"{change.n_points:,} points"], [""]
    for run, cloud, own, when in zip((base, other), sims, is_own, ("before", "after"), strict=True):
        scores = [f"{METRIC[score].label} {number(getattr(change, f'{score}_{when}'))}" for score in SHARED_SCORES]
        n_others = np.count_nonzero(_inside(cloud.points, low, high))
        words.append(
            f"{own.sum():,} points, {', '.join(scores)}"
            if own.any()
            else f"not matched; {n_others:,} points of other objects here"
        )
        links.append(report_link(run.folder, change, start))
    panels = [
        Panel(
            title=title,
            words=text,
            own=camera.path(cloud.points[own]),
            others=camera.path(cloud.points[~own & _inside(cloud.points, low, high)]),
            link=link,
        )
        for title, cloud, own, text, link in zip(_TITLES, (real, *sims), (is_real, *is_own), words, links, strict=True)
    ]
    what = change.label or f"{change.shape} object"
    return Picture(
        kind=change.kind,
        sentence=f"{what}, {change.range_m:.1f} m away; pair {change.pair_id}, real {change.real_id}",
        panels=tuple(panels),
        bar=camera.bar_m * camera.scale,
        bar_m=camera.bar_m,
    )


def report_link(run: Path, change: ObjectChange, start: Path) -> str:
    """The address of an object in its run's report, relative to a folder; "" where the run has no report."""
    pages = (run / PAGE, run / PAGES / f"pair-{file_stem(change.pair_id)}.html")
    page = next((page for page in pages if page.exists()), None)
    if page is None:
        return ""
    words = urlencode({"pair": change.pair_id, "object": f"real {change.real_id}"}, quote_via=quote)
    try:
        return f"{quote(os.path.relpath(page.resolve(), start.resolve()))}#{words}"
    except ValueError:  # another drive
        return f"{page.resolve().as_uri()}#{words}"


class _Camera:
    """Looks at a box from the sensor's side, from above, without perspective; true to scale."""

    def __init__(self, low: FloatArray, high: FloatArray) -> None:
        centre = (low + high) / 2
        azimuth = np.arctan2(-centre[1], -centre[0]) + np.radians(_TURN_DEG)
        elevation = np.radians(VIEW["elev"])
        self._right = np.array([-np.sin(azimuth), np.cos(azimuth), 0.0])
        self._up = np.array(
            [
                -np.sin(elevation) * np.cos(azimuth),
                -np.sin(elevation) * np.sin(azimuth),
                np.cos(elevation),
            ]
        )
        corners = np.stack(np.meshgrid(*np.stack([low, high], axis=1)), axis=-1).reshape(-1, 3)
        u, v = corners @ self._right, corners @ self._up
        size = np.array([np.ptp(u), np.ptp(v)])
        self.scale = float(((np.array(FRAME) - 2 * _MARGIN) / size).min())
        self._middle = np.array([(u.min() + u.max()) / 2, (v.min() + v.max()) / 2])
        self.bar_m = max((m for m in _BARS_M if m * self.scale <= FRAME[0] / 3), default=_BARS_M[0])

    def path(self, points: FloatArray) -> str:
        """Points as an SVG path of dots; evenly over their order where they are too many."""
        chosen = points[np.unique(np.linspace(0, len(points) - 1, min(len(points), _MOST_DOTS)).round().astype(int))]
        x = FRAME[0] / 2 + (chosen @ self._right - self._middle[0]) * self.scale
        y = FRAME[1] / 2 - (chosen @ self._up - self._middle[1]) * self.scale
        return "".join(f"M{a:.1f} {b:.1f}h0" for a, b in zip(x, y, strict=True))


def _cloud(run: FinishedRun, pair_id: str, side: str) -> Cloud:
    """The object points of a side."""
    rows = run.read_table("ground", pair_id, side, ["point_id", "x", "y", "z", "is_ground"]).to_pandas()
    objects = rows[~rows.is_ground]
    community = run.read_table("communities", pair_id, side, ["community_id"]).to_pandas().community_id
    return Cloud(objects.point_id.to_numpy(), objects[["x", "y", "z"]].to_numpy(), community.to_numpy())


def _inside(points: FloatArray, low: FloatArray, high: FloatArray) -> BoolArray:
    """(n,) which points lie in a box."""
    is_outside = (points < low) | (points > high)
    return ~is_outside[:, 0] & ~is_outside[:, 1] & ~is_outside[:, 2]
