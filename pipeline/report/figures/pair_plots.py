"""Plots of a pair: maps of its points without ground, seen from above, and its range images."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from ....schemas.columns import SIDES
from ....schemas.errors import RunError
from ....schemas.settings import PieceSettings
from ....stages.arrays import FloatArray, IntArray
from ....stages.coverage import COVERAGE_DISTANCES_M, nearest_distances
from ....stages.pieces import CutScan, find_pieces
from ...results.finished import FinishedRun
from ..look import FATE_COLOURS, OUTCOME_COLOURS, OUTCOME_WORDS, SIDE_COLOURS
from ..run_frames import Cloud, axis_title, outcome_places, ray_image, read_clouds
from . import style

_LIGHT = "#dddddd"
_GREY = "#bbbbbb"
_NO_SCORE = "#cccccc"
_UNCOVERED_M = 0.3
_MOST_NUMBERS = 10  #: pieces of a side with a number


def plot_overview(run: FinishedRun, matched: pd.DataFrame, pair_id: str) -> Figure:
    """Three maps: the real objects, both sides with matched centroids connected, and r_lambda.

    Parameters
    ----------
    matched : the matched objects, as in `RunResults`; those of other pairs are ignored
    """
    clouds = read_clouds(run, pair_id)
    real = clouds["real"]
    matched = matched[matched.pair_id == pair_id]
    with style.new_maps(_frame(clouds), 3, _title(pair_id)) as (figure, axes):
        draw_objects(real.points, real.community, axes[0])
        axes[0].set_title(f"(A) {real.community.max() + 1} objects of the real scan")
        _draw_both_sides(clouds, axes[1])
        _draw_centroids(clouds, matched, axes[1])
        axes[1].set_title(f"(B) real and simulated, {len(matched)} matched centroids joined")
        coloured = _draw_fidelity(real, matched, axes[2])
        axes[2].set_title("(C) structural fidelity of the real objects")
        style.colour_bar(axes[2], coloured, axis_title("r_lambda"))
    return figure


def plot_coverage(run: FinishedRun, pair_id: str) -> Figure:
    """A map of each side: its points by their distance to the other side, far ones on top."""
    clouds = read_clouds(run, pair_id)
    distances_m = nearest_distances(clouds["real"].points, clouds["sim"].points)
    with style.new_maps(_frame(clouds), 2, _title(pair_id)) as (figure, axes):
        for axis, cloud, distance_m, (letter, what, side, other) in zip(
            axes,
            clouds.values(),
            distances_m,
            (("A", "missing", "real", "simulated"), ("B", "invented", "simulated", "real")),
            strict=True,
        ):
            coloured = draw_distances(cloud.points, distance_m, axis)
            share = 100 * np.mean(distance_m > _UNCOVERED_M)
            axis.set_title(
                f"({letter}) {what} surface: {share:.0f} % of the {side} points\n"
                f"have no {other} one within {_UNCOVERED_M:.1f} m"
            )
        label = "distance to the other side (m)"
        style.colour_bar(axes[1], coloured, label, extend="max")
    return figure


def plot_unmatched(run: FinishedRun, unmatched: pd.DataFrame, pair_id: str) -> Figure:
    """Two maps: both sides, and the objects that only one side has.

    Parameters
    ----------
    unmatched : the unmatched objects, as in `RunResults`; those of other pairs are ignored
    """
    clouds = read_clouds(run, pair_id)
    unmatched = unmatched[unmatched.pair_id == pair_id]
    title = "unmatched objects"
    if len(unmatched):
        title += f", median range {unmatched.range_m.median():.0f} m"
    with style.new_maps(_frame(clouds), 2, _title(pair_id)) as (figure, axes):
        _draw_both_sides(clouds, axes[0])
        axes[0].set_title("all objects")
        for cloud in clouds.values():
            style.dots(axes[1], cloud.points, 0.4, _LIGHT)
        for side, fate in zip(SIDES, ("missing", "hallucinated"), strict=True):
            ids = unmatched[unmatched.status == fate].community_id
            points = clouds[side].points[np.isin(clouds[side].community, ids)]
            label = f"{len(ids)} {fate} ({side} only)"
            style.dots(axes[1], points, 1.5, FATE_COLOURS[fate], label=label)
        axes[1].set_title(title)
    return figure


def plot_pieces(run: FinishedRun, pair_id: str) -> Figure:
    """A map of each side: missing and invented pieces in colour, all other points in grey.

    The largest pieces have their number in the table `pieces`.
    """
    scans = []
    for side in SIDES:
        rows = run.points(pair_id, side)
        points = rows[["x", "y", "z"]].to_numpy()
        scans.append(CutScan(points, rows.is_ground.to_numpy(), rows.height_m.to_numpy()))
    settings = PieceSettings.model_validate(run.record.settings["pieces"])
    pieces_of_sides = find_pieces(scans[0], scans[1], settings)
    frame = style.frame_of(*(scan.points[~scan.is_ground] for scan in scans))
    with style.new_maps(frame, 2, _title(pair_id)) as (figure, axes):
        for axis, scan, pieces, (what, fate, side) in zip(
            axes,
            scans,
            pieces_of_sides,
            (("missing", "missing", "real"), ("invented", "hallucinated", "simulated")),
            strict=True,
        ):
            is_piece = pieces.labels >= 0
            style.dots(axis, scan.points[~scan.is_ground & ~is_piece], 1.2, _GREY)
            style.dots(axis, scan.points[is_piece], 2, FATE_COLOURS[fate])
            for piece_id, place in enumerate(pieces.objects.centroid[:_MOST_NUMBERS, :2]):
                look = {"xytext": (4, 4), "textcoords": "offset points", "clip_on": True}
                axis.annotate(str(piece_id), place, **look)
            n = len(pieces.partner)
            share = f"{100 * pieces.share:.0f} % of the {side} points"
            axis.set_title(f"{n} {what} pieces, {share}")
    return figure


def draw_objects(points: FloatArray, community: IntArray, axis: Any) -> None:
    """Draw points, each object in a colour."""
    colours = style.community_colours(int(community.max()) + 1)
    style.dots(axis, points, 1.2, colours[community])


def draw_distances(points: FloatArray, distance_m: FloatArray, axis: Any) -> Any:
    """Draw points by their distance to the other side, far ones on top; returns the dots."""
    order = np.argsort(distance_m, kind="stable")
    ramp = {"cmap": style.fidelity_colours(), "vmin": 0, "vmax": COVERAGE_DISTANCES_M[-1]}
    return style.dots(axis, points[order], 1.2, distance_m[order], **ramp)


def _draw_both_sides(clouds: dict[str, Cloud], axis: Any) -> None:
    """Draw the points of both sides in their colours."""
    for side, cloud in clouds.items():
        style.dots(axis, cloud.points, 0.8, SIDE_COLOURS[side], alpha=0.5, label=side)


def _draw_centroids(clouds: dict[str, Cloud], matched: pd.DataFrame, axis: Any) -> None:
    """Draw the centroids of matched objects, those of the two sides connected by a line."""
    centroids = {}
    for side, cloud in clouds.items():
        of_objects = pd.DataFrame(cloud.points[:, :2]).groupby(cloud.community).mean()
        centroids[side] = of_objects.loc[matched[f"{side}_id"]].to_numpy()
    ends = np.stack([centroids["real"], centroids["sim"]])
    axis.plot(ends[:, :, 0], ends[:, :, 1], color="black", linewidth=0.8)
    look = {"edgecolors": "black", "linewidths": 0.6, "zorder": 3}
    for side, places in centroids.items():
        axis.scatter(*places.T, s=13, c=SIDE_COLOURS[side], **look)


def _draw_fidelity(real: Cloud, matched: pd.DataFrame, axis: Any) -> Any:
    """Draw the real points by the r_lambda of their object, grey without; returns the dots."""
    of_object = matched.set_index("real_id").r_lambda.astype(float)
    score = of_object.reindex(real.community).to_numpy()
    is_known = ~np.isnan(score)
    label = "no counterpart, no score"
    style.dots(axis, real.points[~is_known], 1.2, _NO_SCORE, label=label)
    ramp = {"cmap": style.fidelity_colours(), "vmin": 0, "vmax": 1}
    return style.dots(axis, real.points[is_known], 1.2, score[is_known], **ramp)


def plot_range_image(run: FinishedRun, pair_id: str) -> Figure:
    """Range images: real ranges, simulated ranges on the same rays, and the outcome of each ray.

    Raises
    ------
    RunError
        The pair failed, or has no rays because the beams of the real scan could not be determined.
    """
    rays = run.table("rays", [pair_id]).to_pandas()
    if not len(rays):
        reason = run.row(pair_id)["rays_reason"]
        raise RunError(f"run {run.folder}, pair {pair_id}: no rays: {reason}")
    titles = {
        "real_range_m": "real range",
        "sim_range_m": "simulated range on the same rays",
    }
    farthest_m = float(np.nanquantile(rays[[*titles]].to_numpy(dtype=float), 0.99))
    with style.new_figure(11, 5, _title(pair_id)) as figure:
        axes = figure.subplots(3, 1, sharex=True)
        for axis, (name, title) in zip(axes, titles.items(), strict=False):
            image = ray_image(rays, rays[name].to_numpy(dtype=float), np.nan)
            drawn = _draw_rays(axis, image, cmap="viridis", vmin=0, vmax=farthest_m)
            axis.set_title(title)
        figure.colorbar(drawn, ax=axes[:2], label="m", extend="max")
        image = np.ma.masked_equal(ray_image(rays, outcome_places(rays), 255), 255)
        colours = ListedColormap([*OUTCOME_COLOURS.values()])
        _draw_rays(axes[2], image, cmap=colours, vmin=-0.5, vmax=len(OUTCOME_COLOURS) - 0.5)
        axes[2].set(title="outcome of each ray", xlabel="azimuth (degrees, left positive)")
        handles = []
        for name, colour in OUTCOME_COLOURS.items():
            handles.append(Patch(color=colour, label=OUTCOME_WORDS[name]))
        figure.legend(handles=handles, loc="outside lower center", ncols=6)
    return figure


def _draw_rays(axis: Any, image: Any, **colours: Any) -> Any:
    """Draw a value for each ray over azimuth and beam."""
    axis.set_ylabel("beam")
    extent = (180, -180, 0, len(image))
    return axis.imshow(image, aspect="auto", interpolation="nearest", extent=extent, **colours)


def _frame(clouds: dict[str, Cloud]) -> FloatArray:
    return style.frame_of(*(cloud.points for cloud in clouds.values()))


def _title(pair_id: str) -> str:
    return f"pair {style.shown_name(pair_id)}"
