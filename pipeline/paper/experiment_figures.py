"""The figures of the paper's experiments, `fidpipe perturb` (Fig. 2) and `fidpipe ablate` (Fig. 5)."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ...schemas.metric_catalogue import metric_of
from ...stages.arrays import FloatArray, IntArray
from ...stages.generate.perturbations import KINDS, Perturbation
from ...stages.paper.sweep_means import Means
from ..report.figures.style import (
    VIEW,
    box_of,
    dots,
    draw_band,
    draw_object,
    frame_of,
    from_above,
    mark_amounts,
    new_figure,
    shown_name,
)
from ..report.look import BLUE, GREEN, ORANGE, PURPLE, SKY, VERMILION
from ..report.view import count
from .ablate import PARAMETERS, AblateOutcome
from .perturb import PerturbOutcome, object_points

_TOP_IN, _ROW_IN = 3.0, 2.3
_MAX_OBJECTS = 4
_OBJECT_COLOURS = {"vegetation": GREEN, "car": VERMILION, "tree": ORANGE, "wall": BLUE}
_OTHER_COLOURS = (BLUE, ORANGE, GREEN, VERMILION, PURPLE, SKY)
_MARKERS = "os^Dvp"
_SCORES = {"r_lambda_mean": (BLUE, "o"), "match_rate": (GREEN, "s")}


def draw_perturbations(outcome: PerturbOutcome) -> Path | None:
    """Write `perturb.png` into the folder; returns None if there is nothing to draw."""
    if not outcome.objects:
        return None
    swept = {level.kind for level in outcome.levels}
    curves = [name for name, kind in KINDS.items() if kind.axis and name in swept]
    scan = outcome.objects[0].pair_id
    shown = [chosen for chosen in outcome.objects if chosen.pair_id == scan][:_MAX_OBJECTS]
    points, community = object_points(outcome.folder, scan)
    colours: dict[str, str] = {}
    for name in dict.fromkeys(chosen.name for chosen in outcome.objects):
        other = _OTHER_COLOURS[len(colours) % len(_OTHER_COLOURS)]
        colours[name] = _OBJECT_COLOURS.get(name, other)
    n_rows = (len(curves) + 1) // 2
    with new_figure(11, _TOP_IN + _ROW_IN * n_rows) as figure:
        heights = (_TOP_IN, max(_ROW_IN * n_rows, 0.1))
        whole: Any = figure
        top, bottom = whole.subfigures(2, 1, height_ratios=heights)
        top.suptitle(
            f"scan {shown_name(scan)}, altered; bands: one standard deviation over the repeats",
        )
        grid = top.add_gridspec(1, 1 + len(shown), width_ratios=[1.3] + [1.0] * len(shown))
        chosen_colours = {chosen.community_id: colours[chosen.name] for chosen in shown}
        _draw_scene(top.add_subplot(grid[0]), points, community, chosen_colours)
        for place, chosen in enumerate(shown, start=1):
            axis = top.add_subplot(grid[place], projection="3d", **VIEW)
            members = points[community == chosen.community_id]
            draw_object(axis, members, colours[chosen.name], box_of(members), zoom=0.75)
            title = f"{shown_name(chosen.name)}: {chosen.n_points:,} points,\n{chosen.range_m:.0f} m away"
            axis.set_title(title, fontsize=8.5)
        if curves:
            _draw_panels(bottom, outcome, curves, colours)
        path = outcome.folder / "perturb.png"
        figure.savefig(path, dpi=115)
    return path


def draw_ablation(outcome: AblateOutcome) -> Path | None:
    """Write `ablate.png` into the folder; returns None if there is nothing to draw."""
    names = [name for name in PARAMETERS if len(outcome.values[name]) > 1]
    if not names or not outcome.rows.num_rows:
        return None
    has_maps = outcome.grid and len(outcome.values["k"]) > 1 and len(outcome.values["tau_m"]) > 1
    title = f"mean over {count(outcome.n_pairs, 'pair')}, bands: one standard deviation; dashed: current"
    with new_figure(2.75 * max(len(names), 2), 5.5 if has_maps else 2.7, title) as figure:
        top: Any = figure
        if has_maps:
            top, bottom = top.subfigures(2, 1)
            _draw_maps(bottom, outcome)
        for axis, name in zip(
            top.subplots(1, len(names), sharey=True, squeeze=False)[0],
            names,
            strict=True,
        ):
            _draw_scores(axis, outcome, name)
        top.legend(*axis.get_legend_handles_labels(), loc="outside lower center", ncols=2)
        path = outcome.folder / "ablate.png"
        figure.savefig(path, dpi=120)
    return path


def _draw_panels(
    figure: Any,
    outcome: PerturbOutcome,
    curves: Sequence[str],
    colours: dict[str, str],
) -> None:
    """Two panels for each kind of perturbation; those of one metric share a scale."""
    panels = [(kind, metric) for kind in curves for metric in ("r_lambda", "r_gap")]
    axes = figure.subplots((len(panels) + 3) // 4, 4, squeeze=False).ravel()
    for i, (kind, metric) in enumerate(panels):
        if i > 1:
            axes[i].sharey(axes[i % 2])
        levels = [level for level in outcome.levels if level.kind == kind]
        _draw_curves(axes[i], outcome.means, levels, metric, colours)
        axes[i].set_title(f"({'bcdefghi'[i]})", loc="left")
    for axis in axes[:2]:
        axis.set_ylim(bottom=0)
    for axis in axes[len(panels) :]:
        axis.set_axis_off()
    figure.legend(
        *axes[0].get_legend_handles_labels(),
        loc="outside lower center",
        ncols=len(colours),
    )


def _draw_scene(
    axis: Any,
    points: FloatArray,
    community: IntArray,
    colour_of: dict[int, str],
) -> None:
    """All objects from above, the chosen ones in colour."""
    greys = 0.62 + 0.25 * (
        np.arange(
            int(community.max()) + 1,
        )
        * 0.618
        % 1
    )  # consecutive numbers differ
    dots(axis, points, 0.8, np.repeat(greys[community, None], 3, axis=1))
    for chosen, colour in colour_of.items():
        dots(axis, points[community == chosen], 1.6, colour)
    from_above(axis, frame_of(points))
    axis.set_title(
        f"(a) {int(community.max()) + 1} objects from above,\n{len(colour_of)} of them chosen",
        fontsize=8.5,
    )


def _draw_curves(
    axis: Any,
    means: Means,
    levels: Sequence[Perturbation],
    metric: str,
    colours: dict[str, str],
) -> None:
    levels = sorted(levels, key=lambda level: level.amount)
    for marker, (name, colour) in zip(_MARKERS * len(colours), colours.items(), strict=False):
        curve = []
        for level in levels:
            score = means.get(name, level, metric)
            if score.mean is not None:
                curve.append((level.amount, score.mean, score.std or 0.0))
        if curve:
            draw_band(axis, *np.array(curve).T, marker=marker, color=colour, label=shown_name(name))
    kind = KINDS[levels[0].kind]
    if kind.base and levels[0].amount > 0:
        axis.set_xscale("log", base=kind.base)
    mark_amounts(axis, [level.amount for level in levels])
    axis.set(xlabel=kind.axis, ylabel=metric)


def _draw_scores(axis: Any, outcome: AblateOutcome, name: str) -> None:
    """Mean and deviation over pairs of both scores at each value of a parameter."""
    values = np.array(outcome.values[name], dtype=float)
    spreads = outcome.spreads([*_SCORES], outcome.along(name))
    for score, (colour, marker) in _SCORES.items():
        mean = spreads[score, "mean"].to_numpy()
        std = spreads[score, "std"].fillna(0).to_numpy()
        draw_band(
            axis,
            values,
            mean,
            std,
            marker=marker,
            color=colour,
            label=metric_of(score).label,
        )
    axis.axvline(
        getattr(outcome.base, name),
        color="black",
        linewidth=0.8,
        linestyle="--",
        zorder=0,
    )
    if values.max() > 10 * values.min() > 0:
        axis.set_xscale("log")
    mark_amounts(axis, values)
    axis.set(ylim=(0, 1), xlabel=PARAMETERS[name].label)


def _draw_maps(figure: Any, outcome: AblateOutcome) -> None:
    """Both scores over k and tau at the current delta and t."""
    current = (outcome.base.delta_m, outcome.base.t)
    spreads = outcome.spreads([*_SCORES]).xs(current, level=("delta_m", "t"))
    for axis, score in zip(figure.subplots(1, 2), _SCORES, strict=True):
        table = spreads[score, "mean"].unstack("k")
        picture = axis.imshow(table, origin="lower", aspect="auto", cmap="viridis")
        middle = np.mean(picture.get_clim())
        for (row, column), value in np.ndenumerate(table.to_numpy()):
            colour = "white" if value < middle else "black"
            axis.text(
                column,
                row,
                f"{value:.3f}",
                ha="center",
                va="center",
                fontsize=7.5,
                color=colour,
            )
        axis.set_xticks(range(table.shape[1]), [f"{k:g}" for k in table.columns])
        axis.set_yticks(range(table.shape[0]), [f"{tau_m:g}" for tau_m in table.index])
        axis.set(
            xlabel=PARAMETERS["k"].label,
            ylabel=PARAMETERS["tau_m"].label,
            title=metric_of(score).label,
        )
        figure.colorbar(picture, ax=axis)
