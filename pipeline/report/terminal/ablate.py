"""What the terminal shows of `fidpipe ablate`: a table for each setting, what moves the scores, and the choice."""

from __future__ import annotations

from rich.box import SIMPLE_HEAD
from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from ....schemas.metrics import metric_of, narrow_labels
from ....schemas.paper import CHOSEN, INFLUENCES
from ....stages.arrays import FloatArray
from ....stages.statistics.parameter_choice import RULE, Influence
from ....stages.summary import mean_and_std
from ...experiments.ablate.ablate import PARAMETERS, AblateOutcome, choose, influences
from .experiments import sweep_lines

WORDS = {
    "k": "graph.k: nearest neighbours of each point",
    "tau_m": "graph.tau_m: all points within so many metres are joined",
    "delta_m": "matching.delta_m: centroids nearer than this match, metres",
    "t": "selection.t: diffusion time of the heat kernel",
}
_SCORES = (
    "match_rate",
    "r_lambda_mean",
    "max_eigenvalue_shift_mean",
    "laplacian_change_mean",
    "alignment_rms_m_mean",
    "cdc_mean",
)


def ablate_view(outcome: AblateOutcome) -> RenderableType:
    """The results of the experiment, as a newcomer should see them first."""
    parts: list[RenderableType] = []
    if outcome.rows.num_rows:
        parts += [_parameter_table(outcome, name) for name in PARAMETERS if len(outcome.values[name]) > 1]
        found = influences(outcome)
        if found:
            parts.append(_influence_table(found))
        parts.append(Text("The choice", style="bold"))
        parts.append(Text(f"Rule: {RULE}."))
        for verdict in choose(outcome):
            parts.append(Text(f"  {verdict.name.removesuffix('_m')}: {verdict.words}"))
        parts.append(
            Text(
                "A small r_lambda can also come of a bad alignment (a large change): read it beside shift and change.\n"
            )
        )
    parts += sweep_lines(
        outcome,
        "ablate_summary.parquet (means over pairs), ablate/ (one row per pair and choice of settings), ablate.png",
    )
    return Group(*parts)


def _parameter_table(outcome: AblateOutcome, name: str) -> Table:
    n_pairs = len(set(outcome.rows.column("pair_id").to_pylist()))
    paper = f"; the paper chose {CHOSEN[name]:g}" if name in CHOSEN else ""
    table = _table(f"{WORDS[name]}; mean ± std over {n_pairs} pairs, * in force{paper}")
    table.add_column(name.removesuffix("_m"), justify="right", no_wrap=True)
    table.add_column("objects\nreal", justify="right", min_width=7)
    table.add_column("\nsim", justify="right")
    for heading in narrow_labels(_SCORES):
        table.add_column(heading, justify="right", no_wrap=True)
    rows = outcome.rows.to_pandas()
    for point in outcome.along(name):
        own = rows[(rows.k == point.k) & (rows.tau_m == point.tau_m) & (rows.delta_m == point.delta_m)]
        own = own[own.t == point.t]
        cells = [_spread(own[column].to_numpy(dtype=float), i < 2) for i, column in enumerate(_SCORES)]
        table.add_row(
            f"{'*' if point == outcome.base else ''}{getattr(point, name):g}",
            f"{own.n_communities_real.mean():.0f}",
            f"{own.n_communities_sim.mean():.0f}",
            *cells,
            style="bold" if point == outcome.base else "",
        )
    return table


def _influence_table(found: list[Influence]) -> Table:
    table = _table("How far a setting moves a score, beside how far the pairs differ")
    table.add_column("setting")
    for heading in ("score", "moved by", "std over pairs", "verdict"):
        table.add_column(heading, justify="left" if heading in ("score", "verdict") else "right")
    table.add_column("the paper")
    for influence in found:
        verdict = "within the spread" if influence.is_within_spread else "beyond it"
        table.add_row(
            influence.name.removesuffix("_m"),
            metric_of(influence.metric).label,
            f"{influence.range_of_means:.3f}",
            f"{influence.std_over_pairs:.3f}",
            verdict if influence.range_of_means else "does not move",
            INFLUENCES.get((influence.name, influence.metric), ""),
        )
    return table


def _spread(values: FloatArray, with_std: bool) -> str:
    mean, std = mean_and_std(values)
    if mean is None:
        return "-"
    return f"{mean:.3f} ± {std:.3f}" if with_std and std is not None else f"{mean:.3f}"


def _table(title: str) -> Table:
    return Table(title=title, title_justify="left", title_style="bold", box=SIMPLE_HEAD, padding=(0, 1, 0, 0))
