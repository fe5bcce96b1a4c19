"""The paper's figures of a run, each as PNG and SVG: scores over all objects here, points of one scan in `scan`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from ....schemas.metrics import METRIC
from ...storage.files import remove_stale
from ..aggregates import SCORES, axis_title, boxes, histograms, quadrants
from ..colours import QUADRANT_COLOURS, SCORE_COLOURS
from ..quadrants import CDC_LIMIT, QUADRANTS, R_LAMBDA_LIMIT
from ..results import RunResults
from .scan import draw_objects, draw_overview, draw_unmatched
from .style import KINDS, new_figure, save, shown_name

NAMES = ("overview", "unmatched", "distributions", "box_plots", "objects")
_MOST_CLASSES = 8
_MOST_LETTERS = 70  # that fit side by side under the boxes


def draw_figures(results: RunResults, chosen: list[str], folder: Path) -> list[Path]:
    """Draws all figures; those of one scan show the pair in the middle of the order from worst to best.

    A figure that is not drawn this time does not stay from an earlier report.

    Parameters
    ----------
    chosen : names of the pairs to choose that pair from, worst first
    folder : where the files go; made if it is not there
    """
    pair_id = chosen[len(chosen) // 2]
    drawn = [
        *draw_overview(results, pair_id, folder),
        *draw_unmatched(results, pair_id, folder),
        *draw_distributions(results, folder),
        *draw_boxes(results, folder),
        *draw_objects(results, folder),
    ]
    for path in (folder / f"{name}.{kind}" for name in NAMES for kind in KINDS):
        if path not in drawn:
            remove_stale(path)
    return drawn


def draw_distributions(results: RunResults, folder: Any) -> Any:
    """Histograms of r_lambda and CDC over all matched objects, and one against the other with the four quadrants."""
    with new_figure(10, 3.3) as figure:
        *axes, cross = figure.subplots(1, 3, width_ratios=(1, 1, 1.35))
        for axis, (score, counted) in zip(axes, histograms(results).items(), strict=True):
            shares = counted["counts"] / max(1, counted["n"])
            axis.stairs(shares, counted["edges"], fill=True, color=SCORE_COLOURS[score], alpha=0.85)
            if counted["median"] is not None:
                axis.axvline(counted["median"], color="black", linewidth=1, linestyle="--")
                place = {"xycoords": ("data", "axes fraction"), "xytext": (4, -2), "textcoords": "offset points"}
                words = f"median {counted['median']:.2f}"
                axis.annotate(words, (counted["median"], 1), va="top", fontsize=8, **place)
            axis.set(xlim=(0, METRIC[score].high), ylim=(0, max(0.01, *shares) * 1.15))
            axis.set(xlabel=axis_title(score), ylabel="share of matched objects", title=f"{counted['n']:,} objects")
        _draw_quadrants(cross, results)
        return save(figure, folder, "distributions")


def _draw_quadrants(axis: Any, results: RunResults) -> None:
    """The scatter; each quadrant is named outside of the cloud, with its share."""
    counted = quadrants(results)
    for key, title in QUADRANTS.items():
        rows = results.matched[results.matched.quadrant == key]
        label = f"{title}: {100 * counted[key]['share']:.0f} %"
        look = {"s": 9, "linewidths": 0, "alpha": 0.75, "clip_on": False, "rasterized": len(rows) > 2000}
        axis.scatter(rows.cdc, rows.r_lambda, color=QUADRANT_COLOURS[key], label=label, **look)
    axis.axhline(R_LAMBDA_LIMIT, color="black", linewidth=0.7)
    axis.axvline(CDC_LIMIT, color="black", linewidth=0.7)
    axis.set(xlim=(0, 2), ylim=(0, 1), xlabel=axis_title("cdc"), ylabel=axis_title("r_lambda"))
    axis.legend(loc="lower center", bbox_to_anchor=(0.5, 1), ncols=2, handletextpad=0.2, columnspacing=0.8, fontsize=7)


def draw_boxes(results: RunResults, folder: Any) -> Any:
    """Box plots of both scores for the four scans of the run's findings, and for each class (or shape)."""
    findings = results.run.record.findings
    scans = [scan.pair for scan in findings.scans.scans] if findings else []
    classes = results.matched.group.value_counts().index[:_MOST_CLASSES]
    parts = {"scan": boxes(results, "pair_id", scans), results.class_is: boxes(results, "group", classes)}
    width = [1 + len(groups) for groups in parts.values()]
    with new_figure(10, 3.3) as figure:
        axes = figure.subplots(1, 2, width_ratios=width, sharey=True)
        for axis, (kind, groups) in zip(axes, parts.items(), strict=True):
            drawn = _draw_groups(axis, groups)
            axis.set_xlabel(kind)
        axes[0].set_ylabel("score of an object (no unit)")
        figure.legend(handles=drawn, loc="outside upper center", ncols=2)
        return save(figure, folder, "box_plots")


def _draw_groups(axis: Any, groups: list[dict[str, Any]]) -> list[Any]:
    """Two boxes per group; gives what a legend shows of each score."""
    handles = []
    for offset, score in zip((-0.2, 0.2), SCORES, strict=True):
        known = [(i + offset, group[score]) for i, group in enumerate(groups) if group[score]]
        box = {"facecolor": SCORE_COLOURS[score], "linewidth": 0.6}
        flier = {"marker": "o", "markersize": 2.5, "markerfacecolor": box["facecolor"], "markeredgewidth": 0}
        axis.bxp(
            [stats for _, stats in known],
            positions=[place for place, _ in known],
            widths=0.32,
            patch_artist=True,
            boxprops=box,
            medianprops={"color": "black"},
            flierprops=flier,
            manage_ticks=False,
        )
        handles.append(axis.bar(0, 0, edgecolor="black", label=METRIC[score].label, **box))
    names = [shown_name(group["name"], most=16) for group in groups]
    is_narrow = len(names) * max(map(len, names), default=0) > _MOST_LETTERS
    tilted = {"rotation": 25, "ha": "right", "rotation_mode": "anchor"} if is_narrow else {}
    ticks = [f"{name}{' ' if is_narrow else chr(10)}({group['n']})" for name, group in zip(names, groups, strict=True)]
    axis.set_xticks(range(len(groups)), ticks, **tilted)
    axis.set(xlim=(-0.6, len(groups) - 0.4), ylim=(0, 2.02))
    axis.grid(axis="y")
    return handles
