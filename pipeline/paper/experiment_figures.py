"""The figures of the paper's experiments, `fidpipe perturb` (Fig. 2) and `fidpipe ablate` (Fig. 5).

A row of panels for each score, a column for each kind of perturbation or parameter.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pandas as pd

from ...stages.generate.perturbations import KINDS
from ..report.figures.style import draw_band, mark_amounts, new_figure, shown_name
from ..report.look import BLUE, GREEN, ORANGE, PURPLE, SKY, VERMILION
from ..report.view import count
from .ablate import PARAMETERS, base_of, means_along
from .experiment import ExperimentOutcome

_COLOURS = (GREEN, VERMILION, ORANGE, BLUE, PURPLE, SKY)
_MARKERS = "os^Dvp"


@dataclass(frozen=True)
class Sweep:
    """A column of panels.

    axis : label of the horizontal axis
    means : one row per curve, level and metric: curve, level, metric, mean, std
    current : level to mark; None for no mark
    """

    axis: str
    means: pd.DataFrame
    current: float | None = None


def draw_perturbations(outcome: ExperimentOutcome) -> None:
    """Write `perturb.png` into the folder, unless there is nothing to draw."""
    summary = outcome.tables["perturb_summary"].to_pandas()
    means = summary[summary["scope"] == "object"].rename(
        columns={"object": "curve", "amount": "level"}
    )
    sweeps = []
    for name, kind in KINDS.items():
        of_kind = means[means["kind"] == name]
        if kind.axis and len(of_kind):
            sweeps.append(Sweep(kind.axis, of_kind))
    title = f"{shown_name(', '.join(outcome.metadata))}, altered; bands: one standard deviation"
    _draw(outcome.folder / "perturb.png", title, sweeps, ("r_lambda", "r_gap"))


def draw_ablation(outcome: ExperimentOutcome) -> None:
    """Write `ablate.png` into the folder, unless there is nothing to draw."""
    sweeps = []
    for name, parameter in PARAMETERS.items():
        means = means_along(outcome, name).rename(columns={name: "level"})
        if len(means["level"].unique()) > 1:
            means["curve"] = "mean over pairs"
            current = getattr(base_of(outcome.request), name)
            sweeps.append(Sweep(parameter.label, means, current))
    n_pairs = count(len(outcome.metadata), "pair")
    title = f"{n_pairs}; bands: one standard deviation; dashed: current"
    _draw(outcome.folder / "ablate.png", title, sweeps, ("match_rate", "r_lambda_mean"))


def _draw(path: Path, title: str, sweeps: Sequence[Sweep], metrics: Sequence[str]) -> None:
    if not sweeps:
        return
    size_in = 2.75 * max(len(sweeps), 2), 2.3 * len(metrics) + 0.6
    with new_figure(*size_in, title) as figure:
        axes = figure.subplots(len(metrics), len(sweeps), sharey="row", squeeze=False)
        for metric, row in zip(metrics, axes, strict=True):
            for sweep, axis in zip(sweeps, row, strict=True):
                _draw_panel(axis, sweep, metric)
            row[0].set(ylabel=metric.removesuffix("_mean"), ylim=(0, None))
        handles = axes[0, 0].get_legend_handles_labels()
        figure.legend(*handles, loc="outside lower center", ncols=len(_COLOURS))
        figure.savefig(path, dpi=120)


def _draw_panel(axis: Any, sweep: Sweep, metric: str) -> None:
    """Mean and deviation of one score along one sweep."""
    known = sweep.means[sweep.means["metric"] == metric].dropna(subset="mean")
    for place, (name, curve) in enumerate(known.groupby("curve", sort=False)):
        points = curve.sort_values("level")[["level", "mean", "std"]].fillna(0)
        marker = _MARKERS[place % len(_MARKERS)]
        colour = _COLOURS[place % len(_COLOURS)]
        label = shown_name(str(name))
        draw_band(axis, *points.to_numpy().T, marker=marker, color=colour, label=label)
    levels = sorted(known["level"].unique())
    if levels and levels[-1] > 10 * levels[0] > 0:
        axis.set_xscale("log")
    if sweep.current is not None:
        axis.axvline(sweep.current, color="black", linewidth=0.8, linestyle="--", zorder=0)
    mark_amounts(axis, levels)
    axis.set_xlabel(sweep.axis)
