"""Plots of one pair or object of a run, as matplotlib figures that notebooks show; see `open_run.Run`."""

from __future__ import annotations

from io import BytesIO

import numpy as np
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from ....schemas.columns import SIDES
from ....schemas.errors import RunError
from ....schemas.metric_catalogue import METRIC
from ....schemas.settings import PieceSettings
from ....stages.pieces import CutScan, find_pieces
from ...results.finished import FinishedRun, object_facts
from ..look import FATE_COLOURS, OUTCOME_COLOURS, OUTCOME_WORDS, SIDE_COLOURS
from ..pictures import box_around, inside
from ..run_frames import outcome_places, ray_image
from ..view import number
from . import style

_MOST_NUMBERS = 10  #: pieces of a side with a number
_PIECES = (
    ("{} missing pieces, {:.0f} % of the real points", FATE_COLOURS["missing"]),
    ("{} invented pieces, {:.0f} % of the simulated points", FATE_COLOURS["hallucinated"]),
)


class _ShownFigure(Figure):
    """A figure that notebooks show without pyplot, which would keep it."""

    def _repr_png_(self) -> bytes:
        content = BytesIO()
        self.savefig(content, format="png", bbox_inches="tight", dpi=110)
        return content.getvalue()


def plot_object(run: FinishedRun, pair_id: str, name: str) -> Figure:
    """An object on both sides in one box, with its scores; other points in the box are grey.

    Raises
    ------
    RunError
        The pair failed, it has no such object, or a table is damaged.
    """
    facts = object_facts(run, pair_id, name)
    points = {side: run.points(pair_id, side) for side in SIDES}
    clouds = {side: own[["x", "y", "z"]].to_numpy() for side, own in points.items()}
    is_own = {
        side: np.isin(points[side].community_id.fillna(-1), [own["community_id"]] if own else [])
        for side, own in zip(SIDES, (facts.real, facts.sim), strict=True)
    }
    low, high = box_around(np.concatenate([clouds[side][is_own[side]] for side in SIDES]))
    row, own_name = facts.row, f"{facts.row['side']} {facts.row['community_id']}"
    words = f"{style.shown_name(row['label'])} ({own_name})" if row["label"] else own_name
    scores = "".join(
        f", {METRIC[score].label} {number(facts.scores[score])}" for score in ("cdc", "r_lambda") if facts.scores
    )
    title = f"pair {style.shown_name(pair_id)}, {words}, {row['range_m']:.0f} m away: {facts.status}{scores}"
    figure: Figure
    with style.new_figure(7.5, 3.5, title, _ShownFigure) as figure:
        corner, size = style.box_of(np.stack([low, high]))
        for place, (side, cloud) in enumerate(clouds.items(), start=1):
            axis = figure.add_subplot(1, 2, place, projection="3d", **style.VIEW)
            own, others = cloud[is_own[side]], cloud[~is_own[side] & inside(cloud, low, high)]
            style.dots(axis, others - corner, 2, "#bbbbbb")
            style.dots(axis, own - corner, 4, SIDE_COLOURS[side])
            style.metres(axis, size, zoom=0.87)
            axis.set_title(f"{side}, {len(own):,} points", y=1.0)
        return figure


def plot_pieces(run: FinishedRun, pair_id: str) -> Figure:
    """A pair from above: the points of missing and invented pieces in colour, all others in grey.

    The largest pieces have their number in the table `pieces`.
    """
    scans = []
    for side in SIDES:
        rows = run.points(pair_id, side)
        scans.append(CutScan(rows[["x", "y", "z"]].to_numpy(), rows.is_ground.to_numpy(), rows.height_m.to_numpy()))
    found = find_pieces(scans[0], scans[1], PieceSettings.model_validate(run.record.settings["pieces"]))
    frame = style.frame_of(*(scan.points[~scan.is_ground] for scan in scans))
    panels: dict[str, list[style.Layer]] = {
        title.format(len(own.partner), 100 * own.share): [
            (scan.points[~scan.is_ground & (own.labels < 0)], 1.2, "#bbbbbb", {}),
            (scan.points[own.labels >= 0], 2, colour, {}),
        ]
        for scan, own, (title, colour) in zip(scans, found, _PIECES, strict=True)
    }
    figure: Figure
    with style.new_maps(frame, panels, f"pair {style.shown_name(pair_id)}", kind=_ShownFigure) as (figure, axes):
        for axis, own in zip(axes, found, strict=True):
            for piece_id, place in enumerate(own.objects.centroid[:_MOST_NUMBERS, :2]):
                axis.annotate(str(piece_id), place, xytext=(4, 4), textcoords="offset points", clip_on=True)
        return figure


def plot_range_image(run: FinishedRun, pair_id: str) -> Figure:
    """Range images of a pair: real ranges, simulated ranges on the same rays, and the outcome of each ray.

    Raises
    ------
    RunError
        The pair failed, or has no rays because the beams of the real scan could not be determined.
    """
    rays = run.table("rays", [pair_id]).to_pandas()
    if not len(rays):
        raise RunError(f"run {run.folder}, pair {pair_id}: no rays: {run.row(pair_id)['rays_reason']}")
    titles = {"real_range_m": "real range", "sim_range_m": "simulated range on the same rays"}
    furthest = float(np.nanquantile(rays[[*titles]].to_numpy(dtype=float), 0.99))
    figure: Figure
    with style.new_figure(11, 5, f"pair {style.shown_name(pair_id)}", _ShownFigure) as figure:
        axes = figure.subplots(3, 1, sharex=True)
        look = {"aspect": "auto", "interpolation": "nearest", "extent": (180, -180, 0, rays.beam.max() + 1)}
        for axis, (name, title) in zip(axes, titles.items(), strict=False):
            image = ray_image(rays, rays[name].to_numpy(dtype=float), np.nan)
            drawn = axis.imshow(image, cmap="viridis", vmin=0, vmax=furthest, **look)
            axis.set(title=title, ylabel="beam")
        figure.colorbar(drawn, ax=axes[:2], label="m", extend="max")
        image = np.ma.masked_equal(ray_image(rays, outcome_places(rays), 255), 255)
        axes[2].imshow(image, cmap=ListedColormap([*OUTCOME_COLOURS.values()]), vmin=-0.5, vmax=5.5, **look)
        axes[2].set(title="outcome of each ray", xlabel="azimuth (degrees, left positive)", ylabel="beam")
        handles = [Patch(color=colour, label=OUTCOME_WORDS[name]) for name, colour in OUTCOME_COLOURS.items()]
        figure.legend(handles=handles, loc="outside lower center", ncols=6)
        return figure
