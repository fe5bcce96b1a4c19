"""Plots of the scores of all matched objects of a run."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from ....schemas.metric_catalogue import METRIC
from ...results.object_frame import CDC_LIMIT, QUADRANTS, R_LAMBDA_LIMIT
from ..look import QUADRANT_COLOURS, SCORE_COLOURS
from ..run_frames import FEWEST_IN_BOX, SCORES, axis_title
from . import style

_MOST_CLASSES = 8
_MOST_LETTERS = 70  # that fit side by side under the boxes
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
        look = {"histtype": "stepfilled", "alpha": 0.85, "color": SCORE_COLOURS[score]}
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
    classes = [*matched.group.value_counts().index[:_MOST_CLASSES]]
    of_scans = _groups(matched, "pair_id", scans)
    of_classes = _groups(matched, "group", classes)
    widths = (1 + len(of_scans), 1 + len(of_classes))
    with style.new_figure(10, 3.3) as figure:
        left, right = figure.subplots(1, 2, width_ratios=widths, sharey=True)
        draw_boxes(of_scans, left)
        left.set(xlabel="scan", ylabel="score of an object (no unit)")
        draw_boxes(of_classes, right)
        right.set_xlabel(class_is)
        handles, labels = right.get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside upper center", ncols=2)
    return figure


def _groups(rows: pd.DataFrame, column: str, names: Sequence[str]) -> dict[str, pd.DataFrame]:
    """By name the rows that have it in a column; names without rows are left out."""
    groups = {name: rows[rows[column] == name] for name in names}
    return {name: group for name, group in groups.items() if len(group)}


def draw_boxes(groups: dict[str, pd.DataFrame], axis: Any) -> None:
    """Draw two boxes per group, one for each score; groups that are too small have none."""
    for offset, score in zip((-0.2, 0.2), SCORES, strict=True):
        look = {"facecolor": SCORE_COLOURS[score], "linewidth": 0.6}
        for i, rows in enumerate(groups.values()):
            values = rows[score].dropna()
            if len(values) >= FEWEST_IN_BOX:
                axis.boxplot(
                    values,
                    positions=[i + offset],
                    widths=0.32,
                    manage_ticks=False,
                    patch_artist=True,
                    boxprops=look,
                    flierprops={"markerfacecolor": SCORE_COLOURS[score]},
                )
        axis.bar(0, 0, edgecolor="black", label=METRIC[score].label, **look)  # for the legend
    names = [style.shown_name(name, most=16) for name in groups]
    longest = max(map(len, names), default=0)
    turned = {}
    blank = "\n"
    if len(names) * longest > _MOST_LETTERS:
        turned = {"rotation": 25, "ha": "right", "rotation_mode": "anchor"}
        blank = " "
    labels = []
    for name, rows in zip(names, groups.values(), strict=True):
        labels.append(f"{name}{blank}({len(rows)})")
    axis.set_xticks(range(len(names)), labels, **turned)
    axis.set(xlim=(-0.6, len(groups) - 0.4), ylim=(0, 2.02))
    axis.grid(axis="y")
