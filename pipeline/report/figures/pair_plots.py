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
from ....stages.arrays import FloatArray
from ....stages.coverage import COVERAGE_DISTANCES_M, nearest_distances
from ....stages.pieces import CutScan, Pieces, find_pieces
from ...results.finished import FinishedRun
from ..look import FATE_COLOURS, OUTCOME_COLOURS, OUTCOME_WORDS, SIDE_COLOURS
from ..run_frames import axis_title, outcome_places, ray_image
from . import style

XYZ = ["x", "y", "z"]
_LIGHT = "#dddddd"
_GREY = "#bbbbbb"
_UNCOVERED_M = 0.3
_MOST_NUMBERS = 10  #: pieces of a side with a number


def object_points(run: FinishedRun, pair_id: str) -> dict[str, pd.DataFrame]:
    """By side the points of a pair without ground; see `FinishedRun.points`."""
    points = {}
    for side in SIDES:
        rows = run.points(pair_id, side)
        points[side] = rows[~rows.is_ground]
    return points


def plot_overview(run: FinishedRun, matched: pd.DataFrame, pair_id: str) -> Figure:
    """Three maps: the real objects, both sides with matched centroids joined, and r_lambda.

    Parameters
    ----------
    matched : the matched objects, as in `RunResults`; those of other pairs are ignored
    """
    points = object_points(run, pair_id)
    matched = matched[matched.pair_id == pair_id]
    n_objects = points["real"].community_id.max() + 1
    with style.new_maps(_frame(points), 3, _title(pair_id)) as (figure, axes):
        draw_objects(points["real"], axes[0])
        axes[0].set_title(f"(A) {n_objects} objects of the real scan")
        draw_both_sides(points, axes[1])
        draw_centroids(points, matched, axes[1])
        axes[1].set_title(f"(B) real and simulated, {len(matched)} matched centroids joined")
        coloured = draw_fidelity(points["real"], matched, axes[2])
        axes[2].set_title("(C) structural fidelity of the real objects")
        style.colour_bar(axes[2], coloured, axis_title("r_lambda"))
    return figure


def plot_coverage(run: FinishedRun, pair_id: str) -> Figure:
    """A map of each side: its points by their distance to the other side, far ones on top."""
    points = object_points(run, pair_id)
    distances_m = nearest_distances(_xyz(points["real"]), _xyz(points["sim"]))
    missing, invented = (100 * np.mean(distance_m > _UNCOVERED_M) for distance_m in distances_m)
    with style.new_maps(_frame(points), 2, _title(pair_id)) as (figure, axes):
        for axis, side, distance_m in zip(axes, SIDES, distances_m, strict=True):
            coloured = draw_distances(points[side].assign(distance_m=distance_m), axis)
        axes[0].set_title(
            f"(A) missing surface: {missing:.0f} % of the real points\n"
            f"have no simulated one within {_UNCOVERED_M:.1f} m"
        )
        axes[1].set_title(
            f"(B) invented surface: {invented:.0f} % of the simulated points\n"
            f"have no real one within {_UNCOVERED_M:.1f} m"
        )
        style.colour_bar(axes[1], coloured, "distance to the other side (m)", extend="max")
    return figure


def plot_unmatched(run: FinishedRun, unmatched: pd.DataFrame, pair_id: str) -> Figure:
    """Two maps: both sides, and the objects that only one side has.

    Parameters
    ----------
    unmatched : the unmatched objects, as in `RunResults`; those of other pairs are ignored
    """
    points = object_points(run, pair_id)
    unmatched = unmatched[unmatched.pair_id == pair_id]
    title = "unmatched objects"
    if len(unmatched):
        title += f", median range {unmatched.range_m.median():.0f} m"
    with style.new_maps(_frame(points), 2, _title(pair_id)) as (figure, axes):
        draw_both_sides(points, axes[0])
        axes[0].set_title("all objects")
        draw_unmatched(points, unmatched, axes[1])
        axes[1].set_title(title)
    return figure


def plot_pieces(run: FinishedRun, pair_id: str) -> Figure:
    """A map of each side: missing and invented pieces in colour, all other points in grey.

    The largest pieces have their number in the table `pieces`.
    """
    points = {side: run.points(pair_id, side) for side in SIDES}
    scans = [CutScan(_xyz(rows), rows.is_ground.to_numpy(), rows.height_m.to_numpy()) for rows in points.values()]
    settings = PieceSettings.model_validate(run.record.settings["pieces"])
    missing, invented = find_pieces(scans[0], scans[1], settings)
    frame = style.frame_of(*(scan.points[~scan.is_ground] for scan in scans))
    with style.new_maps(frame, 2, _title(pair_id)) as (figure, axes):
        draw_pieces(points["real"], missing, FATE_COLOURS["missing"], axes[0])
        axes[0].set_title(f"{len(missing.partner)} missing pieces, {100 * missing.share:.0f} % of the real points")
        draw_pieces(points["sim"], invented, FATE_COLOURS["hallucinated"], axes[1])
        axes[1].set_title(
            f"{len(invented.partner)} invented pieces, {100 * invented.share:.0f} % of the simulated points"
        )
    return figure


def draw_objects(points: pd.DataFrame, axis: Any) -> None:
    """Draw points, each object in a colour."""
    community = points.community_id.to_numpy(dtype=int)
    style.dots(axis, _xyz(points), 1.2, style.community_colours(community.max() + 1)[community])


def draw_both_sides(points: dict[str, pd.DataFrame], axis: Any) -> None:
    """Draw the points of both sides in their colours."""
    for side, rows in points.items():
        style.dots(axis, _xyz(rows), 0.8, SIDE_COLOURS[side], alpha=0.5, label=side)


def draw_centroids(points: dict[str, pd.DataFrame], matched: pd.DataFrame, axis: Any) -> None:
    """Draw the centroids of matched objects, those of the two sides joined by a line."""
    centroids = {}
    for side, rows in points.items():
        of_objects = rows.groupby("community_id")[["x", "y"]].mean()
        centroids[side] = of_objects.loc[matched[f"{side}_id"]].to_numpy()
    ends_x = np.stack([centroids["real"][:, 0], centroids["sim"][:, 0]])
    ends_y = np.stack([centroids["real"][:, 1], centroids["sim"][:, 1]])
    axis.plot(ends_x, ends_y, color="black", linewidth=0.8)
    look = {"edgecolors": "black", "linewidths": 0.6, "zorder": 3}
    for side, places in centroids.items():
        axis.scatter(places[:, 0], places[:, 1], s=13, c=SIDE_COLOURS[side], **look)


def draw_fidelity(points: pd.DataFrame, matched: pd.DataFrame, axis: Any) -> Any:
    """Draw the real points by the r_lambda of their object, grey without; returns the dots."""
    score = points.community_id.map(matched.set_index("real_id").r_lambda).astype(float)
    is_known = score.notna()
    unknown = _xyz(points[~is_known])
    style.dots(axis, unknown, 1.2, "#cccccc", label="no counterpart, no score")
    ramp = {"cmap": style.fidelity_colours(), "vmin": 0, "vmax": 1}
    return style.dots(axis, _xyz(points[is_known]), 1.2, score[is_known], **ramp)


def draw_distances(points: pd.DataFrame, axis: Any) -> Any:
    """Draw points by their column `distance_m`, far ones on top; returns the dots."""
    farthest_last = points.sort_values("distance_m", kind="stable")
    ramp = {"cmap": style.fidelity_colours(), "vmin": 0, "vmax": COVERAGE_DISTANCES_M[-1]}
    return style.dots(axis, _xyz(farthest_last), 1.2, farthest_last.distance_m, **ramp)


def draw_unmatched(points: dict[str, pd.DataFrame], unmatched: pd.DataFrame, axis: Any) -> None:
    """Draw the objects that only one side has in its colour, and everything else in grey."""
    for rows in points.values():
        style.dots(axis, _xyz(rows), 0.4, _LIGHT)
    for side, fate in zip(SIDES, ("missing", "hallucinated"), strict=True):
        ids = unmatched[unmatched.status == fate].community_id
        rows = points[side][points[side].community_id.isin(ids)]
        label = f"{len(ids)} {fate} ({side} only)"
        style.dots(axis, _xyz(rows), 1.5, FATE_COLOURS[fate], label=label)


def draw_pieces(points: pd.DataFrame, pieces: Pieces, colour: str, axis: Any) -> None:
    """Draw the points of pieces in a colour, other object points in grey, and some numbers."""
    is_piece = pieces.labels >= 0
    style.dots(axis, _xyz(points[~points.is_ground & ~is_piece]), 1.2, _GREY)
    style.dots(axis, _xyz(points[is_piece]), 2, colour)
    look = {"xytext": (4, 4), "textcoords": "offset points", "clip_on": True}
    for piece_id, place in enumerate(pieces.objects.centroid[:_MOST_NUMBERS, :2]):
        axis.annotate(str(piece_id), place, **look)


def plot_range_image(run: FinishedRun, pair_id: str) -> Figure:
    """Range images: real ranges, simulated ranges on the same rays, and the outcome of each ray.

    Raises
    ------
    RunError
        The pair failed, or has no rays because the beams of the real scan could not be determined.
    """
    rays = run.table("rays", [pair_id]).to_pandas()
    if not len(rays):
        raise RunError(f"run {run.folder}, pair {pair_id}: no rays: {run.row(pair_id)['rays_reason']}")
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
        handles = [Patch(color=colour, label=OUTCOME_WORDS[name]) for name, colour in OUTCOME_COLOURS.items()]
        figure.legend(handles=handles, loc="outside lower center", ncols=6)
    return figure


def _draw_rays(axis: Any, image: Any, **colours: Any) -> Any:
    """Draw a value for each ray over azimuth and beam."""
    axis.set_ylabel("beam")
    extent = (180, -180, 0, len(image))
    return axis.imshow(image, aspect="auto", interpolation="nearest", extent=extent, **colours)


def _xyz(points: pd.DataFrame) -> FloatArray:
    return points[XYZ].to_numpy()


def _frame(points: dict[str, pd.DataFrame]) -> FloatArray:
    return style.frame_of(*(_xyz(rows) for rows in points.values()))


def _title(pair_id: str) -> str:
    return f"pair {style.shown_name(pair_id)}"
