"""Plots of a pair: maps of its points without ground, seen from above, and its range images."""

from __future__ import annotations

from typing import Any

from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from ....schemas.columns import SIDES
from ....schemas.errors import RunError
from ....schemas.settings import PieceSettings
from ....stages.pieces import CutScan, find_pieces
from ...results.finished import FinishedRun
from ..look import FATE_COLOURS, OUTCOME_COLOURS, OUTCOME_WORDS
from ..run_frames import ray_image
from . import style

_GREY = "#bbbbbb"
_MOST_NUMBERS = 10  #: pieces of a side with a number


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
        look: dict[str, Any] = {"aspect": "auto", "interpolation": "nearest"}
        if value == "outcome":
            places = {name: place for place, name in enumerate(OUTCOME_COLOURS)}
            image = ray_image(rays, rays.outcome.map(places))
            look |= {"cmap": ListedColormap([*OUTCOME_COLOURS.values()]), "vmin": 0}
            look["vmax"] = len(OUTCOME_COLOURS) - 1
        else:
            image = ray_image(rays, rays[value])
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


def _title(pair_id: str) -> str:
    return f"pair {style.shown_name(pair_id)}"
