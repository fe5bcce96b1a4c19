"""Pictures of objects that have changed: real points, simulated before and after, in one box and from one side.

They stand in the page as drawings of its own colours. The camera looks from the sensor's side, where the points are.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import quote

import numpy as np

from ....schemas.metrics import METRIC
from ...results.finished import FinishedRun
from ...results.followed import SHARED_SCORES, ObjectChange
from ...storage.tables import file_stem
from ..camera import Camera, box_around, inside, object_address
from ..results import Cloud
from ..terminal.layout import number
from .page import PAGE, PAGES

_TITLES = ("real", "simulated, before", "simulated, after")


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
    low, high = box_around(np.concatenate(shown))
    camera = Camera(low, high)
    words, links = [f"{change.n_points:,} points"], [""]
    for run, cloud, own, when in zip((base, other), sims, is_own, ("before", "after"), strict=True):
        scores = [f"{METRIC[score].label} {number(getattr(change, f'{score}_{when}'))}" for score in SHARED_SCORES]
        n_others = np.count_nonzero(inside(cloud.points, low, high))
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
            others=camera.path(cloud.points[~own & inside(cloud.points, low, high)]),
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
    address = object_address(change.pair_id, f"real {change.real_id}")
    try:
        return f"{quote(os.path.relpath(page.resolve(), start.resolve()))}{address}"
    except ValueError:  # another drive
        return f"{page.resolve().as_uri()}{address}"


def _cloud(run: FinishedRun, pair_id: str, side: str) -> Cloud:
    """The object points of a side."""
    rows = run.read_table("ground", pair_id, side, ["point_id", "x", "y", "z", "is_ground"]).to_pandas()
    objects = rows[~rows.is_ground]
    community = run.read_table("communities", pair_id, side, ["community_id"]).to_pandas().community_id
    return Cloud(objects.point_id.to_numpy(), objects[["x", "y", "z"]].to_numpy(), community.to_numpy())
