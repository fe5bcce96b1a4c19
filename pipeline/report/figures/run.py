"""The paper's figures of a run, each as PNG and SVG: scores over all objects here, points of one scan in `scan`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from ...storage.files import remove_stale
from ..aggregates import SCORES, boxes, groups_by_size, histograms, quadrants
from ..colours import QUADRANT_COLOURS, SCORE_COLOURS
from ..quadrants import CDC_LIMIT, R_LAMBDA_LIMIT, UNKNOWN
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
        axes = figure.subplots(1, 3, width_ratios=(1, 1, 1.35))
        for axis, (score, counted) in zip(axes, histograms(results).items(), strict=False):
            axis.stairs(counted["shares"], counted["edges"], fill=True, color=SCORE_COLOURS[score], alpha=0.85)
            median = counted["median"]
            if median is not None:
                axis.axvline(median, color="black", linewidth=1, linestyle="--")
                axis.annotate(
                    f"median {median:.2f}",
                    (median, 1),
                    xycoords=("data", "axes fraction"),
                    xytext=(4, -2),
                    textcoords="offset points",
                    va="top",
                    fontsize=8,
                )
            axis.set(xlim=(0, counted["bound"]), ylim=(0, max(0.01, *counted["shares"]) * 1.15))
            axis.set(xlabel=f"{counted['name']} (no unit)", ylabel="share of matched objects")
            axis.set_title(f"{counted['n']:,} objects")
        _quadrants(axes[2], results)
        return save(figure, folder, "distributions")


def _quadrants(axis: Any, results: RunResults) -> None:
    """The scatter; each quadrant is named outside of the cloud, with its share."""
    for key, counted in quadrants(results).items():
        if key == UNKNOWN:
            continue
        rows = results.matched[results.matched.quadrant == key]
        axis.scatter(
            rows.cdc,
            rows.r_lambda,
            s=9,
            color=QUADRANT_COLOURS[key],
            linewidths=0,
            alpha=0.75,
            label=f"{counted['title']}: {100 * counted['share']:.0f} %",
            clip_on=False,
            rasterized=len(rows) > 2000,
        )
    axis.axhline(R_LAMBDA_LIMIT, color="black", linewidth=0.7)
    axis.axvline(CDC_LIMIT, color="black", linewidth=0.7)
    axis.set(xlim=(0, 2), ylim=(0, 1), xlabel="geometry: CDC (no unit)", ylabel="structure: r_lambda (no unit)")
    axis.legend(loc="lower center", bbox_to_anchor=(0.5, 1), ncols=2, handletextpad=0.2, columnspacing=0.8, fontsize=7)


def draw_boxes(results: RunResults, folder: Any) -> Any:
    """Box plots of both scores for the four scans of the run's findings, and for each class (or shape)."""
    findings = results.run.record.findings
    scans = [scan.pair for scan in findings.scans.scans] if findings else []
    classes = groups_by_size(results)[:_MOST_CLASSES]
    parts = {"scan": boxes(results, "pair_id", scans), results.class_is: boxes(results, "group", classes)}
    if results.class_is == "label":
        parts["class"] = parts.pop("label")
    width = [1 + len(groups) for groups in parts.values()]
    with new_figure(10, 3.3) as figure:
        axes = figure.subplots(1, 2, width_ratios=width, sharey=True)
        for axis, (kind, groups) in zip(axes, parts.items(), strict=True):
            _draw_groups(axis, groups)
            axis.set_xlabel(kind)
        axes[0].set_ylabel("score of an object (no unit)")
        handles = [_patch(SCORE_COLOURS[score], name) for score, (name, _) in SCORES.items()]
        figure.legend(handles=handles, loc="outside upper center", ncols=2)
        return save(figure, folder, "box_plots")


def _draw_groups(axis: Any, groups: list[dict[str, Any]]) -> None:
    keys = {"med": "median", "q1": "q1", "q3": "q3", "whislo": "low", "whishi": "high", "fliers": "outside"}
    for offset, score in zip((-0.2, 0.2), SCORES, strict=True):
        known = [(i, group[score]) for i, group in enumerate(groups) if group[score]]
        stats = [{key: box[ours] for key, ours in keys.items()} for _, box in known]
        axis.bxp(
            stats,
            positions=[i + offset for i, _ in known],
            widths=0.32,
            patch_artist=True,
            boxprops={"facecolor": SCORE_COLOURS[score], "linewidth": 0.6},
            medianprops={"color": "black"},
            flierprops={
                "markersize": 2.5,
                "marker": "o",
                "markerfacecolor": SCORE_COLOURS[score],
                "markeredgewidth": 0,
            },
            manage_ticks=False,
        )
    names = [shown_name(group["name"], most=16) for group in groups]
    if len(names) * max(map(len, names), default=0) > _MOST_LETTERS:
        labels = [f"{name} ({group['n']})" for name, group in zip(names, groups, strict=True)]
        axis.set_xticks(range(len(groups)), labels, rotation=25, ha="right", rotation_mode="anchor")
    else:
        axis.set_xticks(
            range(len(groups)), [f"{name}\n({group['n']})" for name, group in zip(names, groups, strict=True)]
        )
    axis.set_xlim(-0.6, len(groups) - 0.4)
    axis.set_ylim(0, 2.02)
    axis.grid(axis="y")


def _patch(colour: str, label: str) -> Any:
    from matplotlib.patches import Patch

    return Patch(facecolor=colour, edgecolor="black", linewidth=0.6, label=label)
