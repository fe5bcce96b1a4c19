"""What `fidpipe perturb` and `fidpipe ablate` show: tables of means, and a figure (the paper's Fig. 2 and 5)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import astuple
from itertools import cycle
from math import isnan
from typing import Any

import pandas as pd

from ...schemas.metric_catalogue import METRIC, narrow_labels
from ..report.figures.style import new_figure, shown_name
from ..report.look import BLUE, GREEN, ORANGE, PURPLE, SKY, VERMILION
from ..report.view import Note, Table, View, count
from .ablate import PARAMETERS, current, means_along
from .experiment import ExperimentOutcome

#: The scores of the paper's Table I.
_TABLE_I_SCORES = ("match_rate", "centroid_distance_m_mean", "eigenspectrum_distance_mean")
_ABLATED_SCORES = (
    "match_rate",
    "r_lambda_mean",
    "max_eigenvalue_shift_mean",
    "laplacian_change_mean",
)
#: Labels of the amounts of the kinds of perturbations that are drawn.
_AXES = {
    "noise": "noise, standard deviation (m)",
    "dropout": "dropout, share of points lost",
    "hallucination": "hallucination, share of points added",
    "density": "local density, factor",
}
_COLOURS = (GREEN, VERMILION, ORANGE, BLUE, PURPLE, SKY)


def show_perturbations(outcome: ExperimentOutcome) -> View:
    """Scores of the whole scan (the paper's Table I) and of objects; the figure is written."""
    levels = outcome.settings.perturb.levels  # type: ignore[attr-defined]
    names = {astuple(level): str(level) for level in levels}
    means = outcome.tables["perturb_summary"].to_pandas()
    means["level"] = list(zip(means["kind"], means["amount"], means["shift_m"], strict=True))
    whole = means[means["scope"] == "global"]
    single = means[means["scope"] == "object"].rename(columns={"object": "curve"})
    scans = ", ".join(outcome.pairs)
    parts: list[Note | Table] = []
    if len(whole):
        headings = dict(zip(_TABLE_I_SCORES, narrow_labels(_TABLE_I_SCORES), strict=True))
        title = f"Whole scan, {scans}: mean ± std"
        parts.append(_table(title, whole, ("level", names), ("metric", headings)))
    curves = single["curve"].unique()
    for metric in ("r_lambda", "r_gap"):
        of_metric = single[single["metric"] == metric]
        if len(of_metric):
            title = f"{metric} of single objects ({METRIC[metric].scale}): mean ± std"
            columns = ("curve", dict(zip(curves, curves, strict=True)))
            parts.append(_table(title, of_metric, ("level", names), columns))
    drawn = single.assign(axis=single["kind"].map(_AXES)).dropna(subset="axis")
    _draw(outcome, "perturb", f"{shown_name(scans)}, altered", drawn, ("r_lambda", "r_gap"))
    return [*parts, *_last_lines(outcome, "perturb")]


def show_ablation(outcome: ExperimentOutcome) -> View:
    """A table for each parameter, of means with current values of the others; the figure is written."""
    parts: list[Note | Table] = []
    drawn = []
    n_pairs = count(len(outcome.pairs), "pair")
    headings = dict(zip(_ABLATED_SCORES, narrow_labels(_ABLATED_SCORES), strict=True))
    for name, value in current(outcome.settings)._asdict().items():
        means = means_along(outcome, name)
        amounts = sorted(set(means[name]))
        if len(amounts) < 2:
            continue
        names = {amount: f"{'*' if amount == value else ''}{amount:g}" for amount in amounts}
        title = f"{PARAMETERS[name]}.{name}: mean ± std over {n_pairs}, * current"
        parts.append(_table(title, means, (name, names), ("metric", headings)))
        renamed = means.rename(columns={name: "amount"})
        drawn.append(renamed.assign(axis=name, curve="mean over pairs", current=value))
    if parts:
        title = f"{n_pairs}; dashed: current"
        _draw(outcome, "ablate", title, pd.concat(drawn), ("match_rate", "r_lambda_mean"))
    return [*parts, *_last_lines(outcome, "ablate")]


def _last_lines(outcome: ExperimentOutcome, name: str) -> list[Note]:
    """Number of failures and scans, and the files of the folder."""
    made = f"{count(outcome.n_made, 'scan')} evaluated, {outcome.n_reused} reused"
    failed = f"{len(outcome.failures)} failed"
    files = f"{name}_summary.parquet (means), a table of all values, {name}.png"
    return [Note(f"{made}, {failed}"), Note(f"results: {outcome.folder}/{files}")]


def _table(
    title: str,
    means: pd.DataFrame,
    rows: tuple[str, Mapping[Any, str]],
    columns: tuple[str, Mapping[Any, str]],
) -> Table:
    """Means with their standard deviations.

    Parameters
    ----------
    means : among its columns mean and std
    rows, columns : name of the column of `means` whose values have a row (column) each, and their
        names
    """
    row, row_names = rows
    column, column_names = columns
    cells = {}
    for values in means.to_dict("records"):
        cells[values[row], values[column]] = _spread(values["mean"], values["std"])
    lines = []
    for value, name in row_names.items():
        lines.append((name, *(cells.get((value, key), "-") for key in column_names)))
    return Table(title, (row, *column_names.values()), lines, whole=(0,))


def _spread(mean: float, std: float) -> str:
    if isnan(mean):
        return "-"
    return f"{mean:.3f}" if isnan(std) else f"{mean:.3f}±{std:.3f}"


def _draw(
    outcome: ExperimentOutcome,
    name: str,
    title: str,
    means: pd.DataFrame,
    metrics: Sequence[str],
) -> None:
    """Write `NAME.png` with a row of panels for each metric; nothing without means.

    Parameters
    ----------
    means : axis (a column of panels), curve, amount, metric, mean, std, and perhaps the current amount
    """
    if means.empty:
        return
    colours = dict(zip(sorted(set(means["curve"])), cycle(_COLOURS), strict=False))
    labels = means["axis"].unique()
    title = f"{title}; bars: one standard deviation"
    with new_figure(2.75 * max(len(labels), 2), 5.2, title) as figure:
        axes = figure.subplots(2, len(labels), sharey="row", squeeze=False)
        for metric, row in zip(metrics, axes, strict=True):
            known = means[means["metric"] == metric].dropna(subset="mean")
            for label, axis in zip(labels, row, strict=True):
                axis.set_xlabel(label.replace(", ", "\n"))
                if label in set(known["axis"]):
                    draw_panel(axis, known[known["axis"] == label], colours)
            row[0].set(ylabel=metric.removesuffix("_mean"), ylim=(0, None))
        handles = axes[0, 0].get_legend_handles_labels()
        figure.legend(*handles, loc="outside lower center", ncols=len(_COLOURS))
        figure.savefig(outcome.folder / f"{name}.png", dpi=120)


def draw_panel(axis: Any, means: pd.DataFrame, colours: Mapping[str, str]) -> None:
    """Mean and deviation by amount, each curve in its colour."""
    for name, curve in means.sort_values("amount").groupby("curve"):
        axis.errorbar(
            curve["amount"],
            curve["mean"],
            curve["std"].fillna(0),
            marker="o",
            markersize=4,
            label=shown_name(str(name)),
            color=colours[str(name)],
        )
    amounts = sorted(set(means["amount"]))
    if amounts[-1] > 10 * amounts[0] > 0:
        axis.set_xscale("log")
        axis.set_xticks(amounts, labels=[f"{amount:g}" for amount in amounts])
        axis.minorticks_off()
    if "current" in means:
        axis.axvline(means["current"].iloc[0], color="black", linewidth=0.8, linestyle="--")
