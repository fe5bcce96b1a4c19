"""Plots of the scores of all matched objects of a run."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from ....schemas.metric_catalogue import METRIC
from ...results.object_frame import CDC_LIMIT, QUADRANTS, R_LAMBDA_LIMIT
from ..look import GREY, QUADRANT_COLOURS
from ..run_frames import SCORES, axis_title
from . import style

_MOST_CLASSES = 8
_FEWEST_IN_BOX = 3
#: Colours of the boxes; no colour means a score.
_FILLS = {"r_lambda": GREY, "cdc": "white"}
_MOST_VECTORS = 2000  # dots of a figure that are not a picture


def plot_distributions(matched: pd.DataFrame) -> Figure:
    """Histograms of r_lambda and CDC, and one against the other with the four quadrants.

    Parameters
    ----------
    matched : the matched objects, as in `RunResults`
    """
    with style.new_figure(10, 3.3) as figure:
        *histograms, scatter = figure.subplots(1, 3, width_ratios=(1, 1, 1.35))
        for axis, score in zip(histograms, SCORES, strict=True):
            draw_histogram(matched, score, axis)
        draw_quadrants(matched, scatter)
    return figure


def draw_histogram(matched: pd.DataFrame, score: str, axis: Any) -> None:
    """Draw the distribution of a score with its median."""
    values = matched[score].dropna().to_numpy(dtype=float)
    high = METRIC[score].high
    title = f"{len(values):,} objects"
    if len(values):
        weights = np.full(len(values), 1 / len(values))
        look = {"histtype": "stepfilled", "alpha": 0.85, "color": GREY}
        axis.hist(values, bins=25, range=(0, high), weights=weights, **look)
        axis.axvline(np.median(values), color="black", linewidth=1, linestyle="--")
        title += f", median {np.median(values):.2f}"
    axis.set(xlim=(0, high), xlabel=axis_title(score), ylabel="share of matched objects")
    axis.set_title(title)


def draw_quadrants(matched: pd.DataFrame, axis: Any) -> None:
    """Draw r_lambda against CDC; each quadrant is named outside of the cloud, with its share."""
    for key, title in QUADRANTS.items():
        rows = matched[matched.quadrant == key]
        share = len(rows) / max(1, len(matched))
        look = {"s": 9, "linewidths": 0, "alpha": 0.75, "clip_on": False}
        axis.scatter(
            rows.cdc,
            rows.r_lambda,
            color=QUADRANT_COLOURS[key],
            label=f"{title}: {100 * share:.0f} %",
            rasterized=len(rows) > _MOST_VECTORS,
            **look,
        )
    axis.axhline(R_LAMBDA_LIMIT, color="black", linewidth=0.7)
    axis.axvline(CDC_LIMIT, color="black", linewidth=0.7)
    axis.set(xlim=(0, 2), xlabel=axis_title("cdc"))
    axis.set(ylim=(0, 1), ylabel=axis_title("r_lambda"))
    look = {"ncols": 2, "handletextpad": 0.2, "columnspacing": 0.8, "fontsize": 7}
    axis.legend(loc="lower center", bbox_to_anchor=(0.5, 1), **look)


def plot_boxes(matched: pd.DataFrame, class_is: str, scans: Sequence[str]) -> Figure:
    """Box plots of both scores for some scans, and for each class (or shape).

    Parameters
    ----------
    matched, class_is : the matched objects of the run and what their groups are, as in `RunResults`
    scans : names of pairs
    """
    classes = matched.group.value_counts().index[:_MOST_CLASSES].tolist()
    with style.new_figure(10, 3.6) as figure:
        axes = figure.subplots(1, 2, sharey=True)
        for axis, column, names, xlabel in (
            (axes[0], "pair_id", scans, "scan"),
            (axes[1], "group", classes, class_is),
        ):
            _draw_boxes(matched, column, names, axis)
            axis.set_xlabel(xlabel)
        axes[0].set_ylabel("score of an object (no unit)")
        handles = [Patch(facecolor=_FILLS[score], edgecolor="black") for score in SCORES]
        labels = [METRIC[score].label for score in SCORES]
        figure.legend(handles, labels, loc="outside upper center", ncols=2)
    return figure


def _draw_boxes(matched: pd.DataFrame, column: str, names: Sequence[str], axis: Any) -> None:
    """Draw two boxes per group of objects, one for each score; too small groups have none."""
    labels = []
    for i, name in enumerate(names):
        rows = matched[matched[column] == name]
        labels.append(f"{style.shown_name(name, most=16)} ({len(rows)})")
        for offset, score in zip((-0.2, 0.2), SCORES, strict=True):
            values = rows[score].dropna()
            look = {"facecolor": _FILLS[score], "linewidth": 0.6}
            if len(values) >= _FEWEST_IN_BOX:
                place = {"positions": [i + offset], "widths": 0.32, "manage_ticks": False}
                axis.boxplot(values, patch_artist=True, boxprops=look, **place)
    turned = {"rotation": 25, "ha": "right", "rotation_mode": "anchor"}
    axis.set_xticks(range(len(names)), labels, **turned)
    axis.set(xlim=(-0.6, len(names) - 0.4), ylim=(0, 2.02))
    axis.grid(axis="y")
