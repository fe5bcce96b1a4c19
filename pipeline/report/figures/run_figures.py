"""The paper's figures of a run, as PNG, SVG and PDF."""

from __future__ import annotations

from pathlib import Path

import pandas as pd
from matplotlib.figure import Figure

from ....schemas.metric_catalogue import METRIC, QUADRANT_SCORES
from ..look import QUADRANT_COLOURS
from ..run_frames import RunResults, coordinates
from . import style
from .plots import plot_object, plot_pieces, plot_range_image

_KINDS = ("png", "svg", "pdf")
_MOST_OBJECTS = 4


def draw_figures(results: RunResults, pair_id: str, folder: Path) -> list[Path]:
    """Write each figure in three formats.

    Parameters
    ----------
    pair_id : the pair of the maps and of the range image
    folder : where the files go; created if missing

    Raises
    ------
    RunError
        A table is damaged, or a file cannot be written.
    """
    scored = results.matched[results.matched.r_lambda.notna()]
    figures = {
        "r_lambda": _plot_r_lambda(results, pair_id),
        "pieces": plot_pieces(results.run, pair_id),
        "scores": _plot_scores(results.pairs.pair_id, scored),
        "objects": _plot_objects(results, scored),
    }
    if results.run.table("rays", [pair_id]).num_rows:
        figures["range_image"] = plot_range_image(results.run, pair_id)
    paths = []
    for name, figure in figures.items():
        for kind in _KINDS:
            paths.append(folder / f"{name}.{kind}")
            style.save(figure, paths[-1])
    return paths


def _plot_r_lambda(results: RunResults, pair_id: str) -> Figure:
    """A map of the real objects by r_lambda, Fig. 1; those without it are grey."""
    points = results.run.points(pair_id, "real").query("not is_ground")
    places = coordinates(points)
    matched = results.matched[results.matched.pair_id == pair_id].set_index("real_id")
    r_lambda = points["community_id"].map(matched["r_lambda"]).astype(float)
    with style.axes_for(None, 8, 6) as axis:
        style.dots(axis, places, 1, "#cccccc", label="no counterpart, or no score")
        ramp = {"cmap": style.FIDELITY_COLOURS, "vmin": 0, "vmax": 1}
        coloured = style.dots(axis, places, 1.2, r_lambda, **ramp)
        style.colour_bar(axis, coloured, _axis_title("r_lambda"))
        axis.set_title(f"pair {style.shown_name(pair_id)}")
        style.from_above(axis, style.frame_of(places))
    return axis.figure


def _plot_scores(pair_ids: pd.Series, scored: pd.DataFrame) -> Figure:
    """CDC against r_lambda, and the spread of both within each pair, Fig. 3."""
    with style.new_figure(12, 3.5) as figure:
        scatter, *spreads = figure.subplots(1, 3)
        scatter.scatter(
            scored.cdc, scored.r_lambda, s=9, c=scored.quadrant.map(QUADRANT_COLOURS)
        )
        scatter.set(xlabel=_axis_title("cdc"), ylabel=_axis_title("r_lambda"))
        for axis, score in zip(spreads, QUADRANT_SCORES, strict=True):
            of_pairs = [
                scored[score][scored.pair_id == name].astype(float) for name in pair_ids
            ]
            axis.boxplot(of_pairs, manage_ticks=False)
            axis.set(xlabel="pairs, worst first", ylabel=_axis_title(score))
    return figure


def _plot_objects(results: RunResults, scored: pd.DataFrame) -> Figure:
    """The largest objects of different classes or shapes, Fig. 4."""
    largest = scored.sort_values("n_keep", ascending=False).drop_duplicates("group")
    with style.new_figure(10, 9) as figure:
        for i, row in enumerate(largest.head(_MOST_OBJECTS).itertuples(), 1):
            axis = figure.add_subplot(2, 2, i, projection="3d", **style.VIEW)
            plot_object(results.run, str(row.pair_id), f"real:{row.real_id}", axis)
    return figure


def _axis_title(score: str) -> str:
    """Label of the axis of a score: its heading and its best end."""
    return f"{METRIC[score].label} ({METRIC[score].scale})"
