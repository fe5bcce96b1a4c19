"""The figure of `fidpipe ablate` (paper, Fig. "ablation"): r_lambda and match rate against each setting."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from ....schemas.metrics import metric_of
from ...experiments.ablate.ablate import PARAMETERS, AblateOutcome
from ...experiments.ablate.choice import along
from ..colours import BLUE, GREEN
from .style import draw_band, mark_amounts, new_figure

FIGURE = "ablate.png"
_DPI = 120
_AXES = {"k": "k, neighbours", "tau_m": "tau (m)", "delta_m": "delta (m)", "t": "t, diffusion time"}
_SCORES = {"r_lambda_mean": (BLUE, "o"), "match_rate": (GREEN, "s")}


def draw_ablation(outcome: AblateOutcome) -> Path | None:
    """Writes `ablate.png` into the folder; None where there is nothing to draw."""
    names = [name for name in PARAMETERS if len(outcome.values[name]) > 1]
    if not names or not outcome.rows.num_rows:
        return None
    rows = outcome.rows.to_pandas()
    n_pairs = rows.pair_id.nunique()
    spreads = rows.groupby(list(PARAMETERS))[list(_SCORES)].agg(["mean", "std"])
    has_maps = outcome.grid and len(outcome.values["k"]) > 1 and len(outcome.values["tau_m"]) > 1
    title = f"mean over {n_pairs} pair{'s' * (n_pairs > 1)}, bands: one standard deviation; dashed: in force"
    with new_figure(2.75 * max(len(names), 2), 2.7 + 2.8 * has_maps, title) as figure:
        top, *below = figure.subfigures(2, 1) if has_maps else [figure]
        for axis, name in zip(top.subplots(1, len(names), sharey=True, squeeze=False)[0], names, strict=True):
            _draw_curves(axis, spreads, outcome, name)
        top.legend(*axis.get_legend_handles_labels(), loc="outside lower center", ncols=2)
        for maps in below:
            _draw_maps(maps, spreads, outcome)
        path = outcome.folder / FIGURE
        figure.savefig(path, dpi=_DPI)
    return path


def _draw_curves(axis: Any, spreads: pd.DataFrame, outcome: AblateOutcome, name: str) -> None:
    """Mean and deviation over pairs of both scores while one setting moves."""
    values = np.array(outcome.values[name], dtype=float)
    own = spreads.reindex(pd.MultiIndex.from_tuples([tuple(vars(point).values()) for point in along(outcome, name)]))
    for score, (colour, marker) in _SCORES.items():
        mean, std = own[score, "mean"].to_numpy(), own[score, "std"].fillna(0).to_numpy()
        draw_band(axis, values, mean, std, marker=marker, color=colour, label=metric_of(score).label)
    axis.axvline(getattr(outcome.base, name), color="black", linewidth=0.8, linestyle="--", zorder=0)
    if values.max() > 10 * values.min() > 0:
        axis.set_xscale("log")
    mark_amounts(axis, values)
    axis.set(ylim=(0, 1), xlabel=_AXES[name])


def _draw_maps(figure: Any, spreads: pd.DataFrame, outcome: AblateOutcome) -> None:
    """Both scores over k and tau, delta and t as in force."""
    own = spreads.xs((outcome.base.delta_m, outcome.base.t), level=("delta_m", "t"))
    for axis, score in zip(figure.subplots(1, 2), _SCORES, strict=True):
        table = own[score, "mean"].unstack("k")
        picture = axis.imshow(table, origin="lower", aspect="auto", cmap="viridis")
        middle = np.mean(picture.get_clim())
        for (row, column), value in np.ndenumerate(table.to_numpy()):
            look = {"ha": "center", "va": "center", "fontsize": 7.5, "color": "white" if value < middle else "black"}
            axis.text(column, row, f"{value:.3f}", **look)
        axis.set_xticks(range(table.shape[1]), [f"{k:g}" for k in table.columns])
        axis.set_yticks(range(table.shape[0]), [f"{tau_m:g}" for tau_m in table.index])
        axis.set(xlabel=_AXES["k"], ylabel=_AXES["tau_m"], title=metric_of(score).label)
        figure.colorbar(picture, ax=axis)
