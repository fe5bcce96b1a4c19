"""Plots of an object in space, and of a pair: its pieces from above, and its range image."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from ....schemas.columns import Row
from ....schemas.errors import RunError
from ...results.finished import FinishedRun
from ..look import FATE_WORDS, OUTCOME_COLOURS, OUTCOME_WORDS, SIDE_COLOURS
from ..run_frames import coordinates, inside, points_of
from ..view import count, number, percent
from . import style

_OTHERS = "#bbbbbb"
_PAD_M = 0.3  #: around an object
_MOST_NUMBERS = 10  #: pieces of a side with a number
_PIECE_WORDS = {"real": "missing", "sim": "invented"}


def plot_object(run: FinishedRun, pair_id: str, name: str, ax: Any = None) -> Figure:
    """An object on both sides in one box, with its scores; other points in the box are grey.

    Parameters
    ----------
    ax : matplotlib axes in 3D to draw into; by default those of a new figure

    Raises
    ------
    RunError
        The pair failed, it has no such object, or a table is damaged.
    """
    rows = run.object(pair_id, name)
    members = {}
    others = []
    for side, row in rows.items():
        points = run.points(pair_id, side)
        is_member = points["community_id"].isin([row["community_id"]] if row else [])
        members[side] = coordinates(points[is_member])
        others.append(coordinates(points[~is_member]))
    places = np.concatenate(list(members.values()))
    low = places.min(axis=0) - _PAD_M
    high = places.max(axis=0) + _PAD_M
    size = np.maximum(high - low, (high - low).max() / 3)  # labels have room along a thin pole
    low = (low + high - size) / 2
    x, y, z = np.column_stack([low, low + size])
    near = np.concatenate(others)
    with style.axes_for(ax, 8, 7, projection="3d", **style.VIEW) as axis:
        style.dots(axis, near[inside(near, low, low + size)], 2, _OTHERS)
        for side, places in members.items():
            label = f"{side}, {len(places):,} points"
            style.dots(axis, places, 2, SIDE_COLOURS[side], label=label)
        axis.set(xlim=x, ylim=y, zlim=z, xlabel="x (m)", ylabel="y (m)", zlabel="z (m)")
        axis.set_box_aspect(tuple(size))
        axis.locator_params(nbins=5)
        axis.set_title(_object_title(rows["real"] or rows["sim"]))
        axis.legend(loc="upper right", markerscale=3)
    return axis.figure


def _object_title(row: Row) -> str:
    """Pair, class and name of an object, its range, fate and scores."""
    name = f"{row['side']} {row['community_id']}"
    if row["label"]:
        name = f"{style.shown_name(row['label'])} ({name})"
    fate = FATE_WORDS[row["fate"]]
    title = f"{_title(row['pair_id'])}, {name}\n{row['range_m']:.0f} m away, {fate}"
    if row["fate"] == "matched":
        title += f", CDC {number(row['cdc'])}, r_lambda {number(row['r_lambda'])}"
    return title


def plot_pieces(run: FinishedRun, pair_id: str, ax: Axes | None = None) -> Figure:
    """A map of a pair: missing and invented pieces in colour, all other points in grey.

    The largest pieces have their number in the table `pieces`.

    Parameters
    ----------
    ax : matplotlib axes to draw into; by default those of a new figure
    """
    sides = {}
    for side, points in points_of(run, pair_id).items():
        sides[side] = points[~points["is_ground"]]
    with style.axes_for(ax, 8, 6) as axis:
        for side, points in sides.items():
            pieces = points[points["piece_id"] >= 0].groupby("piece_id")[["x", "y", "z"]]
            is_piece = points["piece_id"] >= 0
            style.dots(axis, coordinates(points[~is_piece]), 1.2, _OTHERS)
            n_pieces = count(pieces.ngroups, f"{_PIECE_WORDS[side]} piece")
            look = {
                "label": f"{n_pieces}, {percent(is_piece.mean())} of the points",
                "zorder": 2,
            }
            style.dots(axis, coordinates(points[is_piece]), 2, SIDE_COLOURS[side], **look)
            for piece_id, x, y, _ in pieces.mean().head(_MOST_NUMBERS).itertuples():
                look = {"xytext": (4, 4), "textcoords": "offset points", "clip_on": True}
                axis.annotate(str(piece_id), (x, y), color=SIDE_COLOURS[side], **look)
        axis.set_title(_title(pair_id))
        style.from_above(axis, style.frame_of(*map(coordinates, sides.values())))
    return axis.figure


def plot_range_image(run: FinishedRun, pair_id: str, ax: Axes | None = None) -> Figure:
    """The outcomes of the rays of a pair over azimuth and beam.

    Left is on the left, the highest beam on top. Beams with more returns than firings in a turn
    have more columns than most; these columns are left out.

    Parameters
    ----------
    ax : matplotlib axes to draw into; by default those of a new figure

    Raises
    ------
    RunError
        The pair failed, or has no rays because the beams of the real scan could not be determined.
    """
    rays = run.table("rays", [pair_id]).to_pandas()
    if not len(rays):
        reason = run.row(pair_id)["rays_reason"]
        raise RunError(f"run {run.folder}, pair {pair_id}: no rays: {reason}")
    n_columns = int(rays.groupby("beam")["column"].max().median()) + 1
    outcomes = rays["outcome"].map({name: i for i, name in enumerate(OUTCOME_COLOURS)})
    by_ray = outcomes.set_axis([rays["beam"], rays["column"]])
    image = by_ray.unstack().reindex(columns=range(n_columns)).to_numpy()[::-1, ::-1]
    look = {"cmap": ListedColormap([*OUTCOME_COLOURS.values()]), "interpolation": "nearest"}
    look |= {"vmin": 0, "vmax": len(OUTCOME_COLOURS) - 1}
    with style.axes_for(ax, 11, 3) as axis:
        axis.set(
            xlabel="azimuth (degrees, left positive)", ylabel="beam", title=_title(pair_id)
        )
        axis.imshow(image, extent=(180, -180, 0, len(image)), aspect="auto", **look)
        handles = []
        for name, colour in OUTCOME_COLOURS.items():
            handles.append(Patch(color=colour, label=OUTCOME_WORDS[name]))
        below = {"loc": "upper center", "bbox_to_anchor": (0.5, -0.25)}
        axis.legend(handles=handles, ncols=len(handles), **below)
    return axis.figure


def _title(pair_id: str) -> str:
    return f"pair {style.shown_name(pair_id)}"
