"""Terminal output of the paper's experiments, `fidpipe perturb` and `fidpipe ablate`."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from ...schemas.metric_catalogue import METRIC, labels, narrow_labels
from ...stages.generate.perturbations import KINDS, Perturbation
from ...stages.paper.parameter_choice import RULE
from ...stages.paper.sweep_means import OWN_METRICS, Mean, Means, react, strongest_levels
from ..report.view import Note, Part, Table, View, count, mean_and_spread, number
from .ablate import PARAMETERS, AblateOutcome, choose
from .experiment import ExperimentOutcome
from .perturb import PerturbOutcome

#: The scores of the paper's Table I.
_TABLE_I_SCORES = ("match_rate", "centroid_distance_m_mean", "eigenspectrum_distance_mean")
_ROUNDING = 1e-12
#: The parts of r_lambda, and other scores.
_DETAILS = (
    "max_eigenvalue_shift",
    "laplacian_change",
    "eigenspectrum_distance",
    "cdc",
    "alignment_rms_m",
)

_OBJECT_SCORES = ("r_lambda", "max_eigenvalue_shift", "laplacian_change", "alignment_rms_m", "cdc")
#: Means over pairs; the first two also have a standard deviation.
_ABLATED_SCORES = ("match_rate", *(METRIC[name].mean_column for name in _OBJECT_SCORES))


def perturb_view(outcome: PerturbOutcome) -> View:
    """Scores of the whole scan (the paper's Table I) and of objects; reactions of the metrics."""
    means = outcome.means
    levels = outcome.levels
    parts: list[Part] = []
    if outcome.scans:
        if any(means.get(None, level, "match_rate").n for level in levels):
            parts.append(_table_i(outcome, means))
        parts.append(_chosen_table(outcome))
        parts += [_object_table(outcome, means, metric) for metric in ("r_lambda", "r_gap")]
        parts.append(_detail_table(outcome, means))
        if len(react(means, levels)) > len(OWN_METRICS):
            parts.append(_reaction_table(outcome))
    results = "perturb_summary.parquet (means), perturb_global and perturb_objects (one row per repeat), perturb.png"
    return [*parts, *_last_lines(outcome, results)]


def ablate_view(outcome: AblateOutcome) -> View:
    """A table for each parameter, and the choice."""
    parts: list[Part] = []
    if outcome.rows.num_rows:
        parts += [
            _parameter_table(outcome, name)
            for name in PARAMETERS
            if len(
                outcome.values[name],
            )
            > 1
        ]
        parts += [Note("The choice", "bold"), Note(f"Rule: {RULE}.")]
        parts += [
            Note(
                f"  {choice.name.removesuffix('_m')}: {choice.text}",
            )
            for choice in choose(outcome)
        ]
        note = "A small r_lambda can also result from a poor alignment (a large change): compare shift and change."
        parts.append(Note(f"{note}\n"))
    results = "ablate_summary.parquet (means over pairs), ablate.parquet (a row per pair and parameter set), ablate.png"
    return [*parts, *_last_lines(outcome, results)]


def _last_lines(outcome: ExperimentOutcome, results: str) -> list[Note]:
    """Number of failures and scans, and the files of the folder."""
    notes = []
    if outcome.failures:
        n_failed = len(outcome.failures)
        notes.append(
            Note(f"{n_failed} failed, see the messages above and failures in run.json", "red"),
        )
    made = f"{count(outcome.n_made, 'scan')} evaluated, {outcome.n_reused} reused, in {outcome.wall_s:.1f} s"
    return [*notes, Note(made), Note(f"results: {outcome.folder}/{results}")]


def _level_table(
    title: str,
    columns: Sequence[str],
    outcome: PerturbOutcome,
    cells: Callable[[Perturbation], Sequence[str]],
) -> Table:
    """One row per level and a line after each kind; only the names of the levels never break into lines."""
    levels = outcome.levels
    rows = [(KINDS[level.kind].text.format(level), *cells(level)) for level in levels]
    last = {level.kind: i for i, level in enumerate(levels)}
    return Table(title, ("altered by", *columns), rows, fixed=(0,), ruled=last.values())


def _table_i(outcome: PerturbOutcome, means: Means) -> Table:
    def cells(level: Perturbation) -> list[str]:
        return [_spread(means.get(None, level, metric)) for metric in _TABLE_I_SCORES]

    n = max((means.get(None, level, "match_rate").n for level in outcome.levels), default=0)
    title = f"Whole scan, {', '.join(outcome.scans)}: mean ± std over {n} repeats"
    return _level_table(title, labels(_TABLE_I_SCORES), outcome, cells)


def _chosen_table(outcome: PerturbOutcome) -> Table:
    rows = [
        (
            chosen.name,
            chosen.pair_id,
            chosen.community_id,
            chosen.n_points,
            chosen.range_m,
            chosen.why,
        )
        for chosen in outcome.objects
    ]
    columns = ("object", "scan", "id", "points", "range (m)", "chosen as")
    return Table("The chosen objects", columns, rows, words=(0, 1, 5), digits={4: 1})


def _object_table(outcome: PerturbOutcome, means: Means, column: str) -> Table:
    names = list(dict.fromkeys(chosen.name for chosen in outcome.objects))
    n = max(
        (means.get(name, level, column).n for name in names for level in outcome.levels),
        default=0,
    )
    metric = METRIC[column]
    title = f"{metric.label} of single objects ({metric.scale}), mean ± std over {n} repeats"

    def cells(level: Perturbation) -> list[str]:
        return [_spread(means.get(name, level, column)).replace(" ", "") for name in names]

    return _level_table(title, names, outcome, cells)


def _detail_table(outcome: PerturbOutcome, means: Means) -> Table:
    def cells(level: Perturbation) -> list[str]:
        return [_number(means.over_objects(level, metric)) for metric in _DETAILS]

    title = "The parts of r_lambda (shift / change) and other scores: means over these objects"
    return _level_table(title, labels(_DETAILS), outcome, cells)


def _reaction_table(outcome: PerturbOutcome) -> Table:
    levels = [KINDS[level.kind].heading.format(level.amount) for level in strongest_levels(outcome.levels)]
    rows = []
    for reaction in react(outcome.means, outcome.levels):
        most = KINDS[reaction.most.kind].heading.partition("\n")[0] if reaction.most else ""
        rows.append((reaction.metric, *map(_number, reaction.values), most))
    title = "Reaction of each metric: means over the objects at the strongest level of each kind"
    words = (0, len(levels) + 1)
    return Table(title, ("metric", *levels, "most to"), rows, words, ruled=(len(OWN_METRICS) - 1,))


def _parameter_table(outcome: AblateOutcome, name: str) -> Table:
    """Means over pairs at each value of a parameter, with current values of the others."""
    tried = outcome.along(name)
    columns = ("n_communities_real", "n_communities_sim", *_ABLATED_SCORES)
    spreads = outcome.spreads(columns, tried)
    rows = []
    for parameters, spread in zip(tried, spreads.to_dict("records"), strict=True):
        cells: list[object] = [spread[column, "mean"] for column in columns]
        if outcome.n_pairs > 1:
            for i in (2, 3):
                cells[i] = mean_and_spread(spread[columns[i], "mean"], spread[columns[i], "std"])
        mark = "*" if parameters == outcome.base else ""
        rows.append((f"{mark}{getattr(parameters, name):g}", *cells))
    parameter = PARAMETERS[name]
    return Table(
        f"{parameter.group}.{name}: {parameter.text}; mean ± std over {outcome.n_pairs} pairs, * current",
        (name.removesuffix("_m"), "objects\nreal", "\nsim", *narrow_labels(_ABLATED_SCORES)),
        rows,
        words=(),
        digits={1: 0, 2: 0},
        fixed=(0, *range(3, len(columns) + 1)),
        bold=(tried.index(outcome.base),),
    )


def _spread(score: Mean) -> str:
    if score.mean is None or score.std is None:
        return _number(score.mean)
    return f"{_number(score.mean)} ± {_number(score.std if score.std > _ROUNDING else 0.0)}"


def _number(value: float | None) -> str:
    """Three digits; a power of ten if they would all be 0, no decimals for large numbers."""
    if value is None or value == 0 or 5e-4 <= abs(value) < 10:
        return number(value)
    return f"{value:.0f}" if abs(value) >= 10 else f"{value:.0e}"
