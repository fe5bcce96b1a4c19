"""The figure of `fidpipe perturb` (paper, Fig. 3): the chosen objects drawn, and how r_lambda and r_gap answer."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ....stages.arrays import FloatArray, IntArray
from ....stages.sensing.perturbations import Perturbation
from ...experiments.perturb.claims import Means
from ...experiments.perturb.perturb import PerturbOutcome, object_points
from ..colours import BLUE, GREEN, GREY, ORANGE, PURPLE, SKY, VERMILLION
from .style import new_figure, shown_name

FIGURE = "perturb.png"
_DPI = 115
_TOP_IN, _ROW_IN = 3.0, 2.3
_MOST_DRAWN = 4
_AXES = {
    "noise": "noise, standard deviation (m)",
    "dropout": "dropout, share of points lost",
    "hallucination": "hallucination, share of points added",
    "density": "local density, factor",
}
_LOGARITHMIC = ("noise", "density")
_COLOURS = {"vegetation": GREEN, "car": VERMILLION, "tree": ORANGE, "wall": BLUE}
_OTHER_COLOURS = (BLUE, ORANGE, GREEN, VERMILLION, PURPLE, SKY)
_MARKERS = "os^Dvp"


def draw_perturbations(outcome: PerturbOutcome) -> Path | None:
    """Writes `perturb.png` into the folder; None where nothing was done that can be drawn."""
    if not outcome.objects:
        return None
    curves = [kind for kind in _AXES if any(level.kind == kind for level in outcome.levels)]
    scan = outcome.objects[0].pair_id
    drawn = [of for of in outcome.objects if of.pair_id == scan][:_MOST_DRAWN]
    points, community = object_points(outcome.folder, scan)
    names = list(dict.fromkeys(of.name for of in outcome.objects))
    colours = {name: _COLOURS.get(name, _OTHER_COLOURS[i % len(_OTHER_COLOURS)]) for i, name in enumerate(names)}
    n_rows = (len(curves) + 1) // 2
    with new_figure(11, _TOP_IN + _ROW_IN * n_rows) as figure:
        top, bottom = figure.subfigures(2, 1, height_ratios=(_TOP_IN, max(_ROW_IN * n_rows, 0.1)))
        top.suptitle(f"scan {shown_name(scan)}, altered; bands: one standard deviation over the repeats", fontsize=10)
        grid = top.add_gridspec(1, 1 + len(drawn), width_ratios=(1.3, *[1] * len(drawn)))
        _draw_scene(top.add_subplot(grid[0]), points, community, {of.community_id: colours[of.name] for of in drawn})
        for place, of in enumerate(drawn, start=1):
            axis = top.add_subplot(grid[place], projection="3d", elev=20, azim=-60)
            _draw_object(axis, points[community == of.community_id], colours[of.name])
            axis.set_title(f"{shown_name(of.name)}: {of.n_points:,} points,\n{of.range_m:.0f} m away", fontsize=8.5)
        if curves:
            _draw_panels(bottom, outcome, curves, colours)
        path = outcome.folder / FIGURE
        figure.savefig(path, dpi=_DPI)
    return path


def _draw_panels(figure: Any, outcome: PerturbOutcome, curves: Sequence[str], colours: dict[str, str]) -> None:
    """Two panels for each kind of alteration; those of one metric have the same scale."""
    means = Means(outcome.summary)
    panels = [(kind, metric) for kind in curves for metric in ("r_lambda", "r_gap")]
    axes = figure.subplots((len(panels) + 3) // 4, 4, squeeze=False).ravel()
    for axis, letter, (kind, metric) in zip(axes, "bcdefghi", panels, strict=False):
        _draw_curves(axis, means, [of for of in outcome.levels if of.kind == kind], metric, colours)
        axis.set_title(f"({letter})", loc="left")
    for axis in axes[len(panels) :]:
        axis.set_axis_off()
    for first in (0, 1):
        highest = max(axis.get_ylim()[1] for axis in axes[first : len(panels) : 2])
        for axis in axes[first : len(panels) : 2]:
            axis.set_ylim(0, highest)
    handles, labels = axes[0].get_legend_handles_labels()
    figure.legend(handles, [shown_name(label) for label in labels], loc="outside lower center", ncols=len(colours))


def _draw_scene(axis: Any, points: FloatArray, community: IntArray, colour_of: dict[int, str]) -> None:
    """All objects from above, the chosen ones in their colours."""
    low, high = np.quantile(points[:, :2], [0.005, 0.995], axis=0)
    margin = 0.04 * (high - low).max()
    greys = 0.62 + 0.25 * (np.arange(int(community.max()) + 1) * 0.618 % 1)  # neighbours in number differ
    axis.scatter(*points[:, :2].T, s=0.8, c=np.repeat(greys[community, None], 3, axis=1), linewidths=0)
    for chosen, colour in colour_of.items():
        axis.scatter(*points[community == chosen, :2].T, s=1.6, color=colour, linewidths=0)
    axis.plot(0, 0, marker="+", color="black", markersize=8, markeredgewidth=1.2)
    axis.set(xlim=(low[0] - margin, high[0] + margin), ylim=(low[1] - margin, high[1] + margin))
    axis.set_aspect("equal")
    axis.set(xlabel="x, forward (m)", ylabel="y, left (m)")
    axis.set_title(f"(a) {int(community.max()) + 1} objects from above,\n{len(colour_of)} of them chosen", fontsize=8.5)


def _draw_object(axis: Any, points: FloatArray, colour: str) -> None:
    from matplotlib.ticker import MaxNLocator

    low, high = points.min(axis=0), points.max(axis=0)
    size = np.maximum(high - low, (high - low).max() / 3)
    start = (low + high - size) / 2
    axis.scatter(*(points - start).T, s=1.5, color=colour, linewidths=0)
    axis.set(xlim=(0, size[0]), ylim=(0, size[1]), zlim=(0, size[2]))
    axis.set_box_aspect(size, zoom=0.75)
    for name, of, length in zip("xyz", (axis.xaxis, axis.yaxis, axis.zaxis), size, strict=True):
        of.set_major_locator(MaxNLocator(4 if length > 0.6 * size.max() else 2))
        of.set_tick_params(labelsize=6, pad=-2)
        getattr(axis, f"set_{name}label")(f"{name} (m)", fontsize=7, labelpad=-7)
        of.pane.set(facecolor="none", edgecolor=GREY)


def _draw_curves(axis: Any, means: Means, levels: Sequence[Perturbation], metric: str, colours: dict[str, str]) -> None:
    for marker, (name, colour) in zip(_MARKERS * len(colours), colours.items(), strict=False):
        found = [(of.amount, means.get(name, of, metric)) for of in sorted(levels, key=lambda of: of.amount)]
        known = [(amount, of.mean, of.std or 0.0) for amount, of in found if of.mean is not None]
        if not known:
            continue
        amount, mean, std = np.array(known).T
        axis.plot(amount, mean, marker=marker, markersize=4, linewidth=1.2, color=colour, label=name)
        axis.fill_between(amount, np.maximum(mean - std, 0), mean + std, color=colour, alpha=0.2, linewidth=0)
    kind = levels[0].kind
    if kind in _LOGARITHMIC and min(of.amount for of in levels) > 0:
        axis.set_xscale("log", base=2 if kind == "density" else 10)
    amounts = sorted(of.amount for of in levels)
    axis.set_xticks(amounts, [f"{amount:g}" for amount in amounts])
    axis.minorticks_off()
    axis.set(xlabel=_AXES[kind], ylabel=metric)
    axis.grid(axis="y")
