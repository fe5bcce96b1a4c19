"""Plots of a pair: maps of its points without ground, seen from above, and its range images."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from ....schemas.columns import SIDES
from ....schemas.errors import RunError
from ....schemas.settings import PieceSettings
from ....stages.arrays import FloatArray, IntArray
from ....stages.coverage import COVERAGE_DISTANCES_M
from ....stages.pieces import CutScan, find_pieces
from ...results.finished import FinishedRun
from ..look import FATE_COLOURS, FATE_WORDS, OUTCOME_COLOURS, OUTCOME_WORDS, SIDE_COLOURS
from ..run_frames import Cloud, axis_title, outcome_places, ray_image, read_clouds
from . import style

_LIGHT = "#dddddd"
_GREY = "#bbbbbb"
_NO_SCORE = "#cccccc"
_MOST_NUMBERS = 10  #: pieces of a side with a number


def plot_overview(
    run: FinishedRun, matched: pd.DataFrame, unmatched: pd.DataFrame, pair_id: str
) -> Figure:
    """Four maps: real objects, both sides with matched centroids joined, r_lambda, unmatched.

    Parameters
    ----------
    matched, unmatched : the objects, as in `RunResults`; those of other pairs are ignored
    """
    clouds = read_clouds(run, pair_id)
    real = clouds["real"]
    matched = matched[matched.pair_id == pair_id]
    unmatched = unmatched[unmatched.pair_id == pair_id]
    frame = style.frame_of(*(cloud.points for cloud in clouds.values()))
    with style.new_maps(frame, 4, _title(pair_id)) as (figure, axes):
        draw_objects(real.points, real.community, axes[0])
        axes[0].set_title(f"(A) {real.community.max() + 1} objects of the real scan")
        _draw_matches(clouds, matched, axes[1])
        axes[1].set_title(f"(B) real and simulated, {len(matched)} matched centroids joined")
        coloured = _draw_fidelity(real, matched, axes[2])
        axes[2].set_title("(C) structural fidelity of the real objects")
        style.colour_bar(axes[2], coloured, axis_title("r_lambda"))
        _draw_unmatched(clouds, unmatched, axes[3])
        axes[3].set_title("(D) objects that only one side has")
    return figure


def plot_pieces(run: FinishedRun, pair_id: str, ax: Axes | None = None) -> Figure:
    """A map of a pair: missing and invented pieces in colour, all other points in grey.

    The largest pieces have their number in the table `pieces`.

    Parameters
    ----------
    ax : matplotlib axes to draw into; by default those of a new figure
    """
    scans = []
    for side in SIDES:
        rows = run.points(pair_id, side)
        points = rows[["x", "y", "z"]].to_numpy()
        scans.append(CutScan(points, rows.is_ground.to_numpy(), rows.height_m.to_numpy()))
    settings = PieceSettings.model_validate(run.record.settings["pieces"])
    frame = style.frame_of(*(scan.points[~scan.is_ground] for scan in scans))
    with style.axes_for(ax, 8, 6) as axis:
        for scan, pieces, name, colour in zip(
            scans,
            find_pieces(scans[0], scans[1], settings),
            ("missing", "invented"),
            FATE_COLOURS.values(),
            strict=True,
        ):
            is_piece = pieces.labels >= 0
            style.dots(axis, scan.points[~scan.is_ground & ~is_piece], 1.2, _GREY)
            share = f"{100 * pieces.share:.0f} % of the points"
            label = f"{len(pieces.partner)} {name} pieces, {share}"
            style.dots(axis, scan.points[is_piece], 2, colour, label=label, zorder=2)
            for piece_id, place in enumerate(pieces.objects.centroid[:_MOST_NUMBERS, :2]):
                look = {"xytext": (4, 4), "textcoords": "offset points", "clip_on": True}
                axis.annotate(str(piece_id), place, color=colour, **look)
        axis.set_title(_title(pair_id))
        style.from_above(axis, frame)
    return style.figure_of(axis)


def plot_range_image(
    run: FinishedRun, pair_id: str, value: str = "outcome", ax: Axes | None = None
) -> Figure:
    """The rays of a pair over azimuth and beam.

    Parameters
    ----------
    value : "outcome" of each ray, "real_range_m", or "sim_range_m" on the same rays
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
    with style.axes_for(ax, 11, 3) as axis:
        look = {"aspect": "auto", "interpolation": "nearest"}
        if value == "outcome":
            image = np.ma.masked_equal(ray_image(rays, outcome_places(rays), 255), 255)
            look |= {"cmap": ListedColormap([*OUTCOME_COLOURS.values()]), "vmin": 0}
            look["vmax"] = len(OUTCOME_COLOURS) - 1
        else:
            image = ray_image(rays, rays[value].to_numpy(dtype=float), np.nan)
        drawn = axis.imshow(image, extent=(180, -180, 0, len(image)), **look)
        if value == "outcome":
            handles = []
            for name, colour in OUTCOME_COLOURS.items():
                handles.append(Patch(color=colour, label=OUTCOME_WORDS[name]))
            below = {"loc": "upper center", "bbox_to_anchor": (0.5, -0.25)}
            axis.legend(handles=handles, ncols=len(handles), **below)
        else:
            axis.figure.colorbar(drawn, ax=axis, label=f"{value.replace('_range_m', '')} range (m)")
        axis.set(xlabel="azimuth (degrees, left positive)", ylabel="beam", title=_title(pair_id))
    return style.figure_of(axis)


def draw_objects(points: FloatArray, community: IntArray, axis: Any) -> None:
    """Draw points, each object in a colour."""
    colours = style.community_colours(int(community.max()) + 1)
    style.dots(axis, points, 1.2, colours[community])


def draw_distances(points: FloatArray, distance_m: FloatArray, axis: Any) -> Any:
    """Draw points by their distance to the other side, far ones on top; returns the dots."""
    order = np.argsort(distance_m, kind="stable")
    ramp = {"cmap": style.fidelity_colours(), "vmin": 0, "vmax": COVERAGE_DISTANCES_M[-1]}
    return style.dots(axis, points[order], 1.2, distance_m[order], **ramp)


def _draw_matches(clouds: dict[str, Cloud], matched: pd.DataFrame, axis: Any) -> None:
    """Draw both sides, and the centroids of matched objects connected by lines."""
    centroids = []
    for side, cloud in clouds.items():
        style.dots(axis, cloud.points, 0.8, SIDE_COLOURS[side], alpha=0.5, label=side)
        of_objects = pd.DataFrame(cloud.points[:, :2]).groupby(cloud.community).mean()
        centroids.append(of_objects.loc[matched[f"{side}_id"]].to_numpy())
        look = {"edgecolors": "black", "linewidths": 0.6, "zorder": 3}
        axis.scatter(*centroids[-1].T, s=13, c=SIDE_COLOURS[side], **look)
    ends = np.stack(centroids)
    axis.plot(ends[:, :, 0], ends[:, :, 1], color="black", linewidth=0.8)


def _draw_fidelity(real: Cloud, matched: pd.DataFrame, axis: Any) -> Any:
    """Draw the real points by the r_lambda of their object, grey without; returns the dots."""
    of_object = matched.set_index("real_id").r_lambda.astype(float)
    score = of_object.reindex(real.community).to_numpy()
    is_known = ~np.isnan(score)
    label = "no counterpart, no score"
    style.dots(axis, real.points[~is_known], 1.2, _NO_SCORE, label=label)
    ramp = {"cmap": style.fidelity_colours(), "vmin": 0, "vmax": 1}
    return style.dots(axis, real.points[is_known], 1.2, score[is_known], **ramp)


def _draw_unmatched(clouds: dict[str, Cloud], unmatched: pd.DataFrame, axis: Any) -> None:
    """Draw the objects that only one side has in its colour, all other points in grey."""
    for cloud in clouds.values():
        style.dots(axis, cloud.points, 0.4, _LIGHT)
    for (fate, colour), cloud in zip(FATE_COLOURS.items(), clouds.values(), strict=True):
        ids = unmatched[unmatched.status == fate].community_id
        points = cloud.points[np.isin(cloud.community, ids)]
        style.dots(axis, points, 1.5, colour, label=f"{len(ids)} {FATE_WORDS[fate]}")


def _title(pair_id: str) -> str:
    return f"pair {style.shown_name(pair_id)}"
