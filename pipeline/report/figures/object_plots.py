"""Plots of objects in space, both sides in one box."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ....schemas.metric_catalogue import METRIC, QUADRANT_SCORES
from ...results.finished import FinishedRun, ObjectFacts, object_facts
from ..look import FATE_WORDS, SIDE_COLOURS
from ..pictures import box_around, surroundings
from ..run_frames import read_cloud
from ..view import number
from . import style

_ZOOM = 1.15


def plot_object(run: FinishedRun, pair_id: str, name: str, ax: Axes | None = None) -> Figure:
    """An object on both sides in one box, with its scores; other points in the box are grey.

    Parameters
    ----------
    ax : matplotlib axes in 3D to draw into; by default those of a new figure

    Raises
    ------
    RunError
        The pair failed, it has no such object, or a table is damaged.
    """
    facts = object_facts(run, pair_id, name)
    members = {}
    others = []
    for side, row in (("real", facts.real), ("sim", facts.sim)):
        cloud = read_cloud(run, pair_id, side)
        members[side], points = cloud.split(row["community_id"] if row else None)
        others += [points, cloud.road]
    box = style.box_of(np.stack(box_around(np.concatenate(list(members.values())))))
    with style.axes_for(ax, 8, 7, projection="3d", **style.VIEW) as axis:
        near = surroundings(members.values(), others)
        style.draw_object(axis, near, "#cccccc", box, zoom=_ZOOM)
        for side, points in members.items():
            label = f"{side}, {len(points):,} points"
            style.draw_object(axis, points, SIDE_COLOURS[side], box, zoom=_ZOOM, label=label)
        axis.set_title(_object_title(facts, pair_id))
        axis.legend(loc="upper right", markerscale=3)
    return style.figure_of(axis)


def _object_title(facts: ObjectFacts, pair_id: str) -> str:
    """Pair, class and name of an object, its range, status and scores."""
    row = facts.row
    name = f"{row['side']} {row['community_id']}"
    if row["label"]:
        name = f"{style.shown_name(row['label'])} ({name})"
    words = [f"pair {style.shown_name(pair_id)}, {name}\n{row['range_m']:.0f} m away"]
    words.append(FATE_WORDS[facts.status])
    if facts.scores:
        for score in QUADRANT_SCORES:
            words.append(f"{METRIC[score].label} {number(facts.scores[score])}")
    return ", ".join(words)
