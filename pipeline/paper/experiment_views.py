"""What the terminal shows of the paper's experiments, `fidpipe perturb` and `fidpipe ablate`, at their end."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import pandas as pd

from ...schemas.metrics import METRIC, PaperMean, labels, metric_of, narrow_labels
from ...stages.generate.perturbations import Perturbation
from ...stages.paper.paper_values import CHOSEN, INFLUENCES, TABLE_I, TABLE_I_SCORES
from ...stages.paper.parameter_choice import RULE
from ...stages.paper.sweep_claims import check_sweep_claims
from ...stages.paper.sweep_means import OWN_METRICS, Mean, Means, react, strongest_levels
from ..report.view import Note, Part, Table, View, mean_and_spread, number
from .ablate import PARAMETERS, AblateOutcome, choose, influences
from .experiment import ExperimentOutcome
from .perturb import PerturbOutcome

_LEVELS = {
    "null": "null, {0.amount:g} point less",
    "noise": "noise {0.amount:g} m",
    "dropout": "dropout {0.amount:.0%}",
    "rigid": "rigid {0.shift_m:g} m, {0.amount:g}°",
    "hallucination": "hallucination +{0.amount:.0%}",
    "density": "density x {0.amount:g}",
}
_NARROW_LEVELS = {
    "null": "null\n-{:g}",
    "noise": "noise\n{:g} m",
    "dropout": "drop\n{:.0%}",
    "rigid": "rigid\n{:g}°",
    "hallucination": "added\n{:.0%}",
    "density": "dens.\nx {:g}",
}
_ROUNDING = 1e-12
#: What r_lambda is made of, and what else moves.
_DETAILS = ("max_eigenvalue_shift", "laplacian_change", "eigenspectrum_distance", "cdc", "alignment_rms_m")

_PARAMETERS = {
    "k": "graph.k: nearest neighbours of each point",
    "tau_m": "graph.tau_m: all points within so many metres are joined",
    "delta_m": "matching.delta_m: centroids nearer than this match, metres",
    "t": "selection.t: diffusion time of the heat kernel",
}
_OBJECT_SCORES = ("r_lambda", "max_eigenvalue_shift", "laplacian_change", "alignment_rms_m", "cdc")
#: Means over pairs; of the first two also the standard deviation.
_ABLATED_SCORES = ("match_rate", *(METRIC[name].mean_column for name in _OBJECT_SCORES))


def perturb_view(outcome: PerturbOutcome) -> View:
    """The paper's Table I beside ours, the objects, which metric reacts to what, and the claims."""
    means, levels = outcome.means, outcome.levels
    parts: list[Part] = []
    if outcome.scans:
        if any(means.get(None, level, "match_rate").n for level in levels):
            parts.append(_table_i(outcome, means))
        parts.append(_chosen_table(outcome))
        parts += [_object_table(outcome, means, metric) for metric in ("r_lambda", "r_gap")]
        parts.append(_detail_table(outcome, means))
        if len(react(means, levels)) > len(OWN_METRICS):
            parts.append(_reaction_table(outcome))
        claims = [(claim.claim, claim.paper, claim.here, claim.verdict) for claim in check_sweep_claims(means, levels)]
        if claims:
            headings = ("claim", "paper", "here", "verdict")
            parts.append(Table("What the paper says of them", headings, claims, words=range(4)))
    results = "perturb_summary.parquet (means), perturb_global/ and perturb_objects/ (one row per repeat), perturb.png"
    return [*parts, *_last_lines(outcome, results)]


def ablate_view(outcome: AblateOutcome) -> View:
    """A table for each setting, what moves the scores, and the choice."""
    parts: list[Part] = []
    if outcome.rows.num_rows:
        rows = outcome.rows.to_pandas()
        parts += [_parameter_table(outcome, rows, name) for name in PARAMETERS if len(outcome.values[name]) > 1]
        parts += _influence_tables(outcome)
        parts += [Note("The choice", "bold"), Note(f"Rule: {RULE}.")]
        parts += [Note(f"  {choice.name.removesuffix('_m')}: {choice.text}") for choice in choose(outcome)]
        note = "A small r_lambda can also come of a bad alignment (a large change): read it beside shift and change.\n"
        parts.append(Note(note))
    results = "ablate_summary.parquet (means over pairs), ablate/ (one row per pair and choice of settings), ablate.png"
    return [*parts, *_last_lines(outcome, results)]


def _last_lines(outcome: ExperimentOutcome, results: str) -> list[Note]:
    """How many failures were told of, jobs, and which files of the folder hold what."""
    n_failed = len(outcome.failures)
    return [
        *([Note(f"{n_failed} failed, as told above; see also failures in run.json", "red")] if n_failed else []),
        Note(f"{outcome.n_made} jobs done, {outcome.n_reused} reused, in {outcome.wall_s:.1f} s"),
        Note(f"results: {outcome.folder}/{results}"),
    ]


def _level_table(
    title: str, columns: Sequence[str], outcome: PerturbOutcome, cells: Callable[[Perturbation], Sequence[str]]
) -> Table:
    """One row per level, a line after each kind; only the names of the levels are not broken into lines."""
    levels = outcome.levels
    rows = [(_LEVELS[level.kind].format(level), *cells(level)) for level in levels]
    last = {level.kind: i for i, level in enumerate(levels)}
    return Table(title, ("altered by", *columns), rows, fixed=(0,), ruled=last.values())


def _table_i(outcome: PerturbOutcome, means: Means) -> Table:
    def cells(level: Perturbation) -> list[str]:
        paper = TABLE_I.get((level.kind, level.amount, level.shift_m), [None] * len(TABLE_I_SCORES))
        both = zip((means.get(None, level, metric) for metric in TABLE_I_SCORES), paper, strict=True)
        return [_spread(score) if score else "" for pair in both for score in pair]

    n = max((means.get(None, level, "match_rate").n for level in outcome.levels), default=0)
    title = f"Whole scan, {', '.join(outcome.scans)}: mean ± std over {n} repeats; in grey the paper's Table I"
    headings = labels(TABLE_I_SCORES)
    table = _level_table(title, [name for heading in headings for name in (heading, "paper")], outcome, cells)
    return replace(table, faint=range(2, len(table.headings), 2))


def _chosen_table(outcome: PerturbOutcome) -> Table:
    rows = [
        (chosen.name, chosen.pair_id, chosen.community_id, chosen.n_points, chosen.range_m, chosen.why)
        for chosen in outcome.objects
    ]
    columns = ("object", "scan", "id", "points", "range (m)", "chosen as")
    return Table("The chosen objects", columns, rows, words=(0, 1, 5), digits={4: 1})


def _object_table(outcome: PerturbOutcome, means: Means, column: str) -> Table:
    names = list(dict.fromkeys(chosen.name for chosen in outcome.objects))
    n = max((means.get(name, level, column).n for name in names for level in outcome.levels), default=0)
    metric = METRIC[column]
    title = f"{metric.label} of single objects ({metric.scale}), mean ± std over {n} repeats"

    def cells(level: Perturbation) -> list[str]:
        return [_spread(means.get(name, level, column)).replace(" ", "") for name in names]

    return _level_table(title, names, outcome, cells)


def _detail_table(outcome: PerturbOutcome, means: Means) -> Table:
    def cells(level: Perturbation) -> list[str]:
        values = ([v for name in means.objects for v in means.series(name, [level], metric)] for metric in _DETAILS)
        return [_number(sum(own) / len(own) if own else None) for own in values]

    title = "What r_lambda is made of (shift / change) and what else moves: means over these objects"
    return _level_table(title, labels(_DETAILS), outcome, cells)


def _reaction_table(outcome: PerturbOutcome) -> Table:
    levels = [_NARROW_LEVELS[level.kind].format(level.amount) for level in strongest_levels(outcome.levels)]
    rows = []
    for reaction in react(outcome.means, outcome.levels):
        most = _NARROW_LEVELS[reaction.most.kind].partition("\n")[0] if reaction.most else ""
        rows.append((reaction.metric, *map(_number, reaction.values), most))
    title = "Which metric reacts to what: means over the objects at the strongest level of each kind"
    words = (0, len(levels) + 1)
    return Table(title, ("metric", *levels, "most to"), rows, words, ruled=(len(OWN_METRICS) - 1,))


def _parameter_table(outcome: AblateOutcome, rows: pd.DataFrame, name: str) -> Table:
    """Means over pairs at each value of a setting, the others in force."""
    points, counts = outcome.along(name), ["n_communities_real", "n_communities_sim"]
    spreads = rows.groupby(list(PARAMETERS))[[*counts, *_ABLATED_SCORES]].agg(["mean", "std"])
    spreads = spreads.reindex(pd.MultiIndex.from_tuples([tuple(vars(point).values()) for point in points]))
    n_pairs, cells = rows.pair_id.nunique(), []
    for point, own in zip(points, spreads.to_dict("records"), strict=True):
        values: list[object] = [own[column, "mean"] for column in (*counts, *_ABLATED_SCORES)]
        if n_pairs > 1:
            values[2:4] = [mean_and_spread(own[score, "mean"], own[score, "std"]) for score in _ABLATED_SCORES[:2]]
        cells.append((f"{'*' if point == outcome.base else ''}{getattr(point, name):g}", *values))
    paper = f"; the paper chose {CHOSEN[name]:g}" if name in CHOSEN else ""
    title = f"{_PARAMETERS[name]}; mean ± std over {n_pairs} pairs, * in force{paper}"
    columns = (name.removesuffix("_m"), "objects\nreal", "\nsim", *narrow_labels(_ABLATED_SCORES))
    fixed = (0, *range(3, len(columns)))
    base = points.index(outcome.base)
    return Table(title, columns, cells, words=(), digits={1: 0, 2: 0}, fixed=fixed, bold=(base,))


def _influence_tables(outcome: AblateOutcome) -> list[Table]:
    """How far a setting moves a score; no table where too few pairs tell."""
    rows = []
    for influence in influences(outcome):
        setting, score = influence.name.removesuffix("_m"), metric_of(influence.metric).label
        verdict = "within the spread" if influence.is_within_spread else "beyond it"
        verdict = verdict if influence.range_of_means else "does not move"
        paper = INFLUENCES.get((influence.name, influence.metric), "")
        rows.append((setting, score, influence.range_of_means, influence.std_over_pairs, verdict, paper))
    title = "How far a setting moves a score, beside how far the pairs differ"
    columns = ("setting", "score", "moved by", "std over pairs", "verdict", "the paper")
    return [Table(title, columns, rows, words=(0, 1, 4, 5))] if rows else []


def _spread(score: Mean | PaperMean) -> str:
    if score.mean is None or score.std is None:
        return _number(score.mean)
    return f"{_number(score.mean)} ± {_number(score.std if score.std > _ROUNDING else 0.0)}"


def _number(value: float | None) -> str:
    """Three digits; a power of ten where they would all be 0, none where the number is large."""
    if value is None or value == 0 or 5e-4 <= abs(value) < 10:
        return number(value)
    return f"{value:.0f}" if abs(value) >= 10 else f"{value:.0e}"
