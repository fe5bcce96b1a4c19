"""The figure of `fidpipe perturb` (paper, Fig. 3): the chosen objects drawn, and how r_lambda and r_gap answer."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ....stages.arrays import FloatArray, IntArray
from ....stages.sensing.perturbations import Perturbation
from ....stages.statistics.sweeps import Means
from ...experiments.perturb.perturb import PerturbOutcome, object_points
from ..colours import BLUE, GREEN, ORANGE, PURPLE, SKY, VERMILLION
from .style import VIEW, box_of, draw_band, frame_of, from_above, mark_amounts, metres, new_figure, shown_name

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
    drawn = [chosen for chosen in outcome.objects if chosen.pair_id == scan][:_MOST_DRAWN]
    points, community = object_points(outcome.folder, scan)
    names = list(dict.fromkeys(chosen.name for chosen in outcome.objects))
    colours = {name: _COLOURS.get(name, _OTHER_COLOURS[i % len(_OTHER_COLOURS)]) for i, name in enumerate(names)}
    n_rows = (len(curves) + 1) // 2
    with new_figure(11, _TOP_IN + _ROW_IN * n_rows) as figure:
        top, bottom = figure.subfigures(2, 1, height_ratios=(_TOP_IN, max(_ROW_IN * n_rows, 0.1)))
        top.suptitle(f"scan {shown_name(scan)}, altered; bands: one standard deviation over the repeats", fontsize=10)
        grid = top.add_gridspec(1, 1 + len(drawn), width_ratios=(1.3, *[1] * len(drawn)))
        chosen_colours = {chosen.community_id: colours[chosen.name] for chosen in drawn}
        _draw_scene(top.add_subplot(grid[0]), points, community, chosen_colours)
        for place, chosen in enumerate(drawn, start=1):
            axis = top.add_subplot(grid[place], projection="3d", **VIEW)
            _draw_object(axis, points[community == chosen.community_id], colours[chosen.name])
            title = f"{shown_name(chosen.name)}: {chosen.n_points:,} points,\n{chosen.range_m:.0f} m away"
            axis.set_title(title, fontsize=8.5)
        if curves:
            _draw_panels(bottom, outcome, curves, colours)
        path = outcome.folder / FIGURE
        figure.savefig(path, dpi=_DPI)
    return path


def _draw_panels(figure: Any, outcome: PerturbOutcome, curves: Sequence[str], colours: dict[str, str]) -> None:
    """Two panels for each kind of alteration; those of one metric have the same scale."""
    means = outcome.means
    panels = [(kind, metric) for kind in curves for metric in ("r_lambda", "r_gap")]
    axes = figure.subplots((len(panels) + 3) // 4, 4, squeeze=False).ravel()
    for axis, letter, (kind, metric) in zip(axes, "bcdefghi", panels, strict=False):
        _draw_curves(axis, means, [level for level in outcome.levels if level.kind == kind], metric, colours)
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
    greys = 0.62 + 0.25 * (np.arange(int(community.max()) + 1) * 0.618 % 1)  # neighbours in number differ
    axis.scatter(*points[:, :2].T, s=0.8, c=np.repeat(greys[community, None], 3, axis=1), linewidths=0)
    for chosen, colour in colour_of.items():
        axis.scatter(*points[community == chosen, :2].T, s=1.6, color=colour, linewidths=0)
    from_above(axis, frame_of(points))
    axis.set_title(f"(a) {int(community.max()) + 1} objects from above,\n{len(colour_of)} of them chosen", fontsize=8.5)


def _draw_object(axis: Any, points: FloatArray, colour: str) -> None:
    corner, size = box_of(points)
    axis.scatter(*(points - corner).T, s=1.5, color=colour, linewidths=0)
    metres(axis, size, zoom=0.75)


def _draw_curves(axis: Any, means: Means, levels: Sequence[Perturbation], metric: str, colours: dict[str, str]) -> None:
    levels = sorted(levels, key=lambda level: level.amount)
    for marker, (name, colour) in zip(_MARKERS * len(colours), colours.items(), strict=False):
        answers = [(level.amount, means.get(name, level, metric)) for level in levels]
        known = [(amount, answer.mean, answer.std or 0.0) for amount, answer in answers if answer.mean is not None]
        if known:
            draw_band(axis, *np.array(known).T, marker=marker, color=colour, label=name)
    kind = levels[0].kind
    if kind in _LOGARITHMIC and levels[0].amount > 0:
        axis.set_xscale("log", base=2 if kind == "density" else 10)
    mark_amounts(axis, [level.amount for level in levels])
    axis.set(xlabel=_AXES[kind], ylabel=metric)
