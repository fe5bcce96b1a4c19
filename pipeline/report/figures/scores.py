"""The figures of scores: distributions of r_lambda and CDC with their scatter, and box plots per scan and per class.

Leaves to others: figures of points (`figures_scan`), what is counted (`aggregates`).
"""

from __future__ import annotations

from typing import Any

from ..aggregates import SCORES, boxes, groups_by_size, histograms
from ..quadrants import CDC_LIMIT, QUADRANTS, R_LAMBDA_LIMIT
from ..results import RunResults
from .style import BLUE, ORANGE, QUADRANT_COLOURS, new_figure, save, shown_name

_COLOURS = {"r_lambda": BLUE, "cdc": ORANGE}
_MOST_CLASSES = 8
_MOST_LETTERS = 70  # that fit side by side under the boxes


def draw_distributions(results: RunResults, folder: Any) -> Any:
    """Histograms of r_lambda and CDC over all matched objects, and one against the other with the four quadrants."""
    with new_figure(10, 3.3) as figure:
        axes = figure.subplots(1, 3, width_ratios=(1, 1, 1.35))
        for axis, (column, of) in zip(axes, histograms(results).items(), strict=False):
            edges, share = of["edges"], [n / max(1, of["n"]) for n in of["counts"]]
            axis.stairs(share, edges, fill=True, color=_COLOURS[column], alpha=0.85)
            if of["median"] is not None:
                axis.axvline(of["median"], color="black", linewidth=1, linestyle="--")
                axis.annotate(
                    f"median {of['median']:.2f}",
                    (of["median"], 1),
                    xycoords=("data", "axes fraction"),
                    xytext=(4, -2),
                    textcoords="offset points",
                    va="top",
                    fontsize=8,
                )
            axis.set(xlim=(0, of["bound"]), xlabel=f"{of['name']} (no unit)", ylabel="share of matched objects")
            axis.set_title(f"{of['n']:,} objects")
            axis.set_ylim(0, max(0.01, *share) * 1.15)
        _quadrants(axes[2], results)
        return save(figure, folder, "distributions")


def _quadrants(axis: Any, results: RunResults) -> None:
    """The scatter; each quadrant is named outside of the cloud, with its share."""
    shares = results.matched.quadrant.value_counts(normalize=True)
    for key, title in QUADRANTS.items():
        rows = results.matched[results.matched.quadrant == key]
        axis.scatter(
            rows.cdc,
            rows.r_lambda,
            s=9,
            color=QUADRANT_COLOURS[key],
            linewidths=0,
            alpha=0.75,
            label=f"{title}: {100 * shares.get(key, 0):.0f} %",
            clip_on=False,
            rasterized=len(rows) > 2000,
        )
    axis.axhline(R_LAMBDA_LIMIT, color="black", linewidth=0.7)
    axis.axvline(CDC_LIMIT, color="black", linewidth=0.7)
    axis.set(xlim=(0, 2), ylim=(0, 1), xlabel="geometry: CDC (no unit)", ylabel="structure: r_lambda (no unit)")
    axis.legend(loc="lower center", bbox_to_anchor=(0.5, 1), ncols=2, handletextpad=0.2, columnspacing=0.8, fontsize=7)


def draw_boxes(results: RunResults, folder: Any) -> Any:
    """Box plots of both scores for the four scans of the run's findings, and for each class (or shape)."""
    scans = [scan["pair"] for scan in results.run.record["findings"]["scans"]["scans"]]
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
        handles = [_patch(_COLOURS[column], name) for column, (name, _) in SCORES.items()]
        figure.legend(handles=handles, loc="outside upper center", ncols=2)
        return save(figure, folder, "box_plots")


def _draw_groups(axis: Any, groups: list[dict[str, Any]]) -> None:
    for offset, column in ((-0.2, "r_lambda"), (0.2, "cdc")):
        known = [(i, group[column]) for i, group in enumerate(groups) if group[column]]
        stats = [
            {"med": of["median"], "q1": of["q1"], "q3": of["q3"], "whislo": of["low"], "whishi": of["high"]}
            | {"fliers": of["outside"]}
            for _, of in known
        ]
        axis.bxp(
            stats,
            positions=[i + offset for i, _ in known],
            widths=0.32,
            patch_artist=True,
            boxprops={"facecolor": _COLOURS[column], "linewidth": 0.6},
            medianprops={"color": "black"},
            flierprops={"markersize": 2.5, "marker": "o", "markerfacecolor": _COLOURS[column], "markeredgewidth": 0},
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
