"""What the terminal shows of `fidpipe perturb`: the paper's Table I beside ours, the objects, and the claims."""

from __future__ import annotations

from rich.box import SIMPLE_HEAD
from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from ....schemas.metrics import METRIC, PaperMean, labels
from ....schemas.paper import TABLE_I, TABLE_I_SCORES
from ....stages.sensing.perturbations import Perturbation
from ....stages.statistics.sweeps import (
    OWN_METRICS,
    Claim,
    Mean,
    Means,
    Reaction,
    judge_claims,
    react,
    strongest_levels,
)
from ...experiments.perturb.perturb import PerturbOutcome
from .experiments import sweep_lines

_SHORT = {
    "noise": "noise\n{:g} m",
    "dropout": "drop\n{:.0%}",
    "rigid": "rigid\n{:g}°",
    "hallucination": "added\n{:.0%}",
    "density": "dens.\nx {:g}",
}
_VERDICTS = {
    True: Text("yes", style="green"),
    False: Text("NO", style="red"),
    None: Text("not checkable", style="yellow"),
}
_ROUNDING = 1e-12
#: What r_lambda is made of, and what else moves.
_DETAILS = ("max_eigenvalue_shift", "laplacian_change", "eigenspectrum_distance", "cdc", "alignment_rms_m")


def perturb_view(outcome: PerturbOutcome) -> RenderableType:
    """The results of the experiment, as a newcomer should see them first."""
    means = outcome.means
    scans = ", ".join(outcome.scans)
    parts: list[RenderableType] = []
    if outcome.scans:
        if any(means.get(None, level, "match_rate").n for level in outcome.levels):
            parts.append(_table_i(outcome, means, scans))
        parts.append(_chosen_table(outcome))
        parts += [_object_table(outcome, means, metric) for metric in ("r_lambda", "r_gap")]
        parts.append(_detail_table(outcome, means))
        reactions = react(means, outcome.levels)
        if len(reactions) > len(OWN_METRICS):
            parts.append(_reaction_table(reactions, outcome))
        claims = judge_claims(means, outcome.levels)
        if claims:
            parts.append(_claims_table(claims))
    parts += sweep_lines(
        outcome,
        "perturb_summary.parquet (means), perturb_global/ and perturb_objects/ (one row per repeat), perturb.png",
    )
    return Group(*parts)


def level_words(level: Perturbation) -> str:
    """A level as a table's row names it."""
    words = {
        "noise": f"noise {level.amount:g} m",
        "dropout": f"dropout {level.amount:.0%}",
        "rigid": f"rigid {level.shift_m:g} m, {level.amount:g}°",
        "hallucination": f"hallucination +{level.amount:.0%}",
        "density": f"density x {level.amount:g}",
    }
    return words[level.kind]


def _table_i(outcome: PerturbOutcome, means: Means, scans: str) -> Table:
    n = max((means.get(None, level, "match_rate").n for level in outcome.levels), default=0)
    table = _table(f"Whole scan, {scans}: mean ± std over {n} repeats; in grey the paper's Table I")
    table.add_column("altered by", no_wrap=True)
    for heading in labels(TABLE_I_SCORES):
        table.add_column(heading, justify="right", min_width=len(heading.split()[-1]))
        table.add_column("paper", justify="right", style="bright_black")
    for level in outcome.levels:
        cells = []
        paper = TABLE_I.get((level.kind, level.amount, level.shift_m))
        for i, metric in enumerate(TABLE_I_SCORES):
            cells += [_spread(means.get(None, level, metric)), _spread(paper[i]) if paper else ""]
        table.add_row(level_words(level), *cells, end_section=_is_last(level, outcome))
    return table


def _chosen_table(outcome: PerturbOutcome) -> Table:
    table = _table("The chosen objects")
    for heading in ("object", "scan", "id", "points", "range (m)", "chosen as"):
        table.add_column(heading, justify="right" if heading in ("id", "points", "range (m)") else "left")
    for chosen in outcome.objects:
        numbers = (f"{chosen.community_id}", f"{chosen.n_points}", f"{chosen.range_m:.1f}")
        table.add_row(chosen.name, Text(chosen.pair_id), *numbers, chosen.why)
    return table


def _object_table(outcome: PerturbOutcome, means: Means, metric: str) -> Table:
    names = list(dict.fromkeys(chosen.name for chosen in outcome.objects))
    n = max((means.get(name, level, metric).n for name in names for level in outcome.levels), default=0)
    table = _table(f"{METRIC[metric].label} of single objects ({METRIC[metric].scale}), mean ± std over {n} repeats")
    table.add_column("altered by", no_wrap=True)
    for name in names:
        table.add_column(name, justify="right")
    for level in outcome.levels:
        cells = [_spread(means.get(name, level, metric)).replace(" ", "") for name in names]
        table.add_row(level_words(level), *cells, end_section=_is_last(level, outcome))
    return table


def _detail_table(outcome: PerturbOutcome, means: Means) -> Table:
    table = _table("What r_lambda is made of (shift / change) and what else moves: means over these objects")
    table.add_column("altered by", no_wrap=True)
    for heading in labels(_DETAILS):
        table.add_column(heading, justify="right")
    for level in outcome.levels:
        cells = []
        for metric in _DETAILS:
            values = [value for name in means.objects for value in means.series(name, [level], metric)]
            cells.append(_number(sum(values) / len(values)) if values else "-")
        table.add_row(level_words(level), *cells, end_section=_is_last(level, outcome))
    return table


def _claims_table(claims: list[Claim]) -> Table:
    table = _table("What the paper says of them")
    for heading in ("claim", "paper", "here", "holds"):
        table.add_column(heading)
    for claim in claims:
        table.add_row(claim.claim, claim.paper, claim.here, _VERDICTS[claim.holds])
    return table


def _reaction_table(reactions: list[Reaction], outcome: PerturbOutcome) -> Table:
    strongest = strongest_levels(outcome.levels)
    table = _table("Which metric reacts to what: means over the objects at the strongest level of each kind")
    table.add_column("metric", no_wrap=True)
    for level in strongest:
        table.add_column(_SHORT[level.kind].format(level.amount), justify="right", no_wrap=True)
    table.add_column("most to", no_wrap=True)
    for reaction in reactions:
        cells = ["-" if value is None else _number(value) for value in reaction.values]
        most = "" if reaction.most is None else _SHORT[reaction.most.kind].partition("\n")[0]
        table.add_row(reaction.metric, *cells, most, end_section=reaction.metric == OWN_METRICS[-1])
    return table


def _is_last(level: Perturbation, outcome: PerturbOutcome) -> bool:
    return level == [each for each in outcome.levels if each.kind == level.kind][-1]


def _spread(score: Mean | PaperMean) -> str:
    if score.mean is None:
        return "-"
    if score.std is None:
        return _number(score.mean)
    return f"{_number(score.mean)} ± {_number(score.std if score.std > _ROUNDING else 0.0)}"


def _number(value: float) -> str:
    if abs(value) >= 10:
        return f"{value:.0f}"
    return f"{value:.3f}" if abs(value) >= 5e-4 or value == 0 else f"{value:.0e}"


def _table(title: str) -> Table:
    return Table(title=title, title_justify="left", title_style="bold", box=SIMPLE_HEAD, padding=(0, 1, 0, 0))
