"""Plots of objects in space, the real side next to the simulated one."""

from __future__ import annotations

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from ....schemas.columns import SIDES
from ....schemas.metric_catalogue import METRIC, QUADRANT_SCORES
from ...results.finished import FinishedRun, ObjectFacts, object_facts
from ..look import SIDE_COLOURS
from ..pictures import box_around, surroundings
from ..run_frames import read_cloud
from ..view import number
from . import style

_CLASSES = ("car", "vegetation", "tree", "wall")


def plot_object(run: FinishedRun, pair_id: str, name: str) -> Figure:
    """An object on both sides in one box, with its scores; other points in the box are grey.

    Raises
    ------
    RunError
        The pair failed, it has no such object, or a table is damaged.
    """
    facts = object_facts(run, pair_id, name)
    members = {}
    others = {}
    for side, row in (("real", facts.real), ("sim", facts.sim)):
        cloud = read_cloud(run, pair_id, side)
        members[side], points = cloud.split(row["community_id"] if row else None)
        others[side] = [points, cloud.road]
    corners = box_around(np.concatenate(list(members.values())))
    box = style.box_of(np.stack(corners))
    with style.new_figure(7.5, 3.5, _object_title(facts, pair_id)) as figure:
        for place, side in enumerate(SIDES, start=1):
            axis = figure.add_subplot(1, 2, place, projection="3d", **style.VIEW)
            near = surroundings(members.values(), others[side])
            style.draw_object(axis, near, "#bbbbbb", box)
            style.draw_object(axis, members[side], SIDE_COLOURS[side], box)
            axis.set_title(f"{side}, {len(members[side]):,} points", y=1.0)
    return figure


def _object_title(facts: ObjectFacts, pair_id: str) -> str:
    """Pair, class and name of an object, its range, status and scores."""
    row = facts.row
    name = f"{row['side']} {row['community_id']}"
    if row["label"]:
        name = f"{style.shown_name(row['label'])} ({name})"
    place = f"pair {style.shown_name(pair_id)}, {name}, {row['range_m']:.0f} m away"
    words = [f"{place}: {facts.status}"]
    if facts.scores:
        for score in QUADRANT_SCORES:
            words.append(f"{METRIC[score].label} {number(facts.scores[score])}")
    return ", ".join(words)


def plot_objects(run: FinishedRun, matched: pd.DataFrame) -> Figure | None:
    """Up to four typical objects, real above simulated, with their scores.

    Returns None if no object has a spectral score.

    Parameters
    ----------
    matched : the matched objects of the run, as in `RunResults`
    """
    chosen = _choose_objects(matched)
    if chosen.empty:
        return None
    with style.new_figure(2.9 * max(2, len(chosen)), 5.8) as figure:
        # The layout does not see the label of z.
        figure.set_layout_engine("constrained", rect=(0, 0, 0.975, 1))
        grid = figure.add_gridspec(3, len(chosen), height_ratios=(1, 1, 0.3))
        for place, (_, row) in enumerate(chosen.iterrows()):
            members = {}
            for side, community in (("real", row.real_id), ("sim", row.sim_id)):
                members[side], _ = read_cloud(run, row.pair_id, side).split(community)
            box = style.box_of(np.concatenate(list(members.values())))
            for level, (side, points) in enumerate(members.items()):
                axis = figure.add_subplot(grid[level, place], projection="3d", **style.VIEW)
                style.draw_object(axis, points, SIDE_COLOURS[side], box)
                axis.set_title(f"{side}, {len(points):,} points", pad=-4, y=1.0, fontsize=8)
            words = (
                f"({'abcd'[place]}) {style.shown_name(row.group)}, {row.range_m:.0f} m away\n"
                f"CDC {row.cdc:.2f}   r_lambda {row.r_lambda:.2f}\n"
                f"r_gap {row.r_gap:.3f}   nodes {row.n_keep:,}\n"
                f"pair {style.shown_name(row.pair_id)}, object {row.real_id}"
            )
            axis = figure.add_subplot(grid[2, place])
            axis.set_axis_off()
            axis.text(0.5, 1, words, ha="center", va="top", fontsize=8.5)
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
