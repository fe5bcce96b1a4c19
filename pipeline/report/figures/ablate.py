"""The figure of `fidpipe ablate` (paper, Fig. "ablation"): r_lambda and match rate against each setting."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from ....stages.summary import mean_and_std
from ...experiments.ablate.ablate import PARAMETERS, AblateOutcome
from ..colours import BLUE, GREEN
from .style import draw_band, mark_amounts, new_figure

FIGURE = "ablate.png"
_DPI = 120
_AXES = {"k": "k, neighbours", "tau_m": "tau (m)", "delta_m": "delta (m)", "t": "t, diffusion time"}
_SCORES = (("r_lambda_mean", "r_lambda", BLUE, "o"), ("match_rate", "match rate", GREEN, "s"))


def draw_ablation(outcome: AblateOutcome) -> Path | None:
    """Writes `ablate.png` into the folder; None where there is nothing to draw."""
    names = [name for name in PARAMETERS if len(outcome.values[name]) > 1]
    if not names or not outcome.rows.num_rows:
        return None
    rows = outcome.rows.to_pandas()
    has_maps = outcome.grid and len(outcome.values["k"]) > 1 and len(outcome.values["tau_m"]) > 1
    with new_figure(2.75 * max(len(names), 2), 2.7 + 2.8 * has_maps) as figure:
        n_pairs = rows.pair_id.nunique()
        top, *below = figure.subfigures(2, 1) if has_maps else [figure]
        figure.suptitle(
            f"mean over {n_pairs} pair{'s' * (n_pairs > 1)}, bands: one standard deviation; dashed: in force",
            fontsize=10,
        )
        for axis, name in zip(top.subplots(1, len(names), sharey=True, squeeze=False)[0], names, strict=True):
            _draw_curves(axis, rows, outcome, name)
        handles, labels = axis.get_legend_handles_labels()
        top.legend(handles, labels, loc="outside lower center", ncols=2)
        for maps in below:
            _draw_maps(maps, rows, outcome)
        path = outcome.folder / FIGURE
        figure.savefig(path, dpi=_DPI)
    return path


def _draw_curves(axis: Any, rows: pd.DataFrame, outcome: AblateOutcome, name: str) -> None:
    values = np.array(outcome.values[name], dtype=float)
    by_point = dict(list(rows.groupby(["k", "tau_m", "delta_m", "t"])))
    for column, label, colour, marker in _SCORES:
        spread = [
            mean_and_std(by_point[point.k, point.tau_m, point.delta_m, point.t][column].to_numpy(dtype=float))
            for point in outcome.along(name)
        ]
        mean, std = np.array(spread, dtype=float).T
        draw_band(axis, values, mean, np.nan_to_num(std), marker=marker, color=colour, label=label)
    axis.axvline(getattr(outcome.base, name), color="black", linewidth=0.8, linestyle="--", zorder=0)
    if values.max() > 10 * values.min() > 0:
        axis.set_xscale("log")
    mark_amounts(axis, values)
    axis.set_ylim(0, 1)
    axis.set_xlabel(_AXES[name])


def _draw_maps(figure: Any, rows: pd.DataFrame, outcome: AblateOutcome) -> None:
    """Both scores over k and tau, delta and t as in force."""
    own = rows[(rows.delta_m == outcome.base.delta_m) & (rows.t == outcome.base.t)]
    for axis, (column, label, _, _) in zip(figure.subplots(1, 2), _SCORES, strict=True):
        table = own.pivot_table(index="tau_m", columns="k", values=column, aggfunc="mean", dropna=False)
        picture = axis.imshow(table, origin="lower", aspect="auto", cmap="viridis")
        middle = (np.nanmin(table.to_numpy()) + np.nanmax(table.to_numpy())) / 2
        for (row, of_k), value in np.ndenumerate(table.to_numpy()):
            colour = "white" if value < middle else "black"
            axis.text(of_k, row, f"{value:.3f}", ha="center", va="center", fontsize=7.5, color=colour)
        axis.set_xticks(range(table.shape[1]), [f"{k:g}" for k in table.columns])
        axis.set_yticks(range(table.shape[0]), [f"{tau_m:g}" for tau_m in table.index])
        axis.set(xlabel=_AXES["k"], ylabel=_AXES["tau_m"], title=label)
        figure.colorbar(picture, ax=axis)
