"""Plots of objects in space, both sides in one box."""

from __future__ import annotations

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ....schemas.metric_catalogue import METRIC, QUADRANT_SCORES
from ...results.finished import FinishedRun, ObjectFacts, object_facts
from ..look import SIDE_COLOURS
from ..pictures import box_around, surroundings
from ..run_frames import read_cloud
from ..view import number
from . import style

_CLASSES = ("car", "vegetation", "tree", "wall")


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
        style.draw_object(axis, surroundings(members.values(), others), "#cccccc", box)
        for side, points in members.items():
            label = f"{side}, {len(points):,} points"
            style.draw_object(axis, points, SIDE_COLOURS[side], box, label=label)
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
    words.append(facts.status)
    if facts.scores:
        for score in QUADRANT_SCORES:
            words.append(f"{METRIC[score].label} {number(facts.scores[score])}")
    return ", ".join(words)


def plot_objects(run: FinishedRun, matched: pd.DataFrame) -> Figure | None:
    """Up to four typical objects with their scores; None if no object has a spectral score.

    Parameters
    ----------
    matched : the matched objects of the run, as in `RunResults`
    """
    chosen = _choose_objects(matched)
    if chosen.empty:
        return None
    with style.new_figure(10, 9) as figure:
        axes = figure.subplots(2, 2, subplot_kw={"projection": "3d", **style.VIEW})
        for axis in axes.ravel()[len(chosen) :]:
            axis.remove()
        for axis, row in zip(axes.ravel(), chosen.itertuples(), strict=False):
            plot_object(run, str(row.pair_id), f"real:{row.real_id}", axis)
    return figure


def _choose_objects(matched: pd.DataFrame) -> pd.DataFrame:
    """Up to four objects to look at: of each class that of median r_lambda in the larger half.

    Car, vegetation, tree and wall come first, as in the paper, then the most frequent other classes
    (or shapes), then the largest objects.
    """
    scored = matched[matched.r_lambda.notna()]
    frequent = [*scored.group.value_counts().index]
    names = sorted(frequent, key=lambda name: name not in _CLASSES)
    chosen = []
    for name in names[:4]:
        rows = scored[scored.group == name]
        large = rows[rows.n_keep >= rows.n_keep.median()].sort_values("r_lambda", kind="stable")
        chosen.append(large.index[len(large) // 2])
    largest = scored.drop(chosen).sort_values("n_keep", ascending=False, kind="stable")
    return scored.loc[[*chosen, *largest.index][:4]]
