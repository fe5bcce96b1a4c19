"""Terminal output of the paper's experiments, `fidpipe perturb` and `fidpipe ablate`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import astuple
from math import isnan, nan

import numpy as np
import pandas as pd

from ...schemas.metric_catalogue import METRIC, OBJECT_METRICS, labels, narrow_labels
from ...stages.generate.perturbations import KINDS, Perturbation
from ..report.view import Note, Part, Table, View, columns_of, count, mean_and_spread, number
from .ablate import PARAMETERS, base_of, means_along
from .experiment import ExperimentOutcome
from .perturb import chosen_objects, levels_of

#: The scores of the paper's Table I.
_TABLE_I_SCORES = ("match_rate", "centroid_distance_m_mean", "eigenspectrum_distance_mean")
_REACTING = (
    "r_lambda",
    "r_gap",
    "max_eigenvalue_shift",
    "laplacian_change",
    "eigenspectrum_distance",
    "alignment_rms_m",
    "cdc",
)
_OBJECT_SCORES = ("r_lambda", "max_eigenvalue_shift", "laplacian_change", "alignment_rms_m", "cdc")
#: Means over pairs; the first two are shown with a standard deviation.
_ABLATED_SCORES = ("match_rate", *(METRIC[name].mean_column for name in _OBJECT_SCORES))
_N_WITH_STD = 2


def perturb_view(outcome: ExperimentOutcome) -> View:
    """Scores of the whole scan (the paper's Table I) and of objects; reactions of the metrics."""
    levels = levels_of(outcome.request)
    summary = outcome.tables["perturb_summary"].to_pandas()
    parts: list[Part] = []
    whole = summary[(summary["scope"] == "global") & summary["metric"].isin(_TABLE_I_SCORES)]
    if len(whole):
        title = f"Whole scan, {', '.join(outcome.metadata)}"
        headings = dict(zip(_TABLE_I_SCORES, labels(_TABLE_I_SCORES), strict=True))
        parts.append(_level_table(title, levels, whole, "metric", headings))
    chosen = [vars(chosen) for chosen in chosen_objects(outcome)]
    if chosen:
        columns = ("object", "scan", "id", "points", "range (m)", "chosen as")
        fields = ("name", "pair_id", "community_id", "n_points", "range_m", "why")
        rows = columns_of(chosen, fields)
        parts.append(Table("The chosen objects", columns, rows, words=(0, 1, 5), digits={4: 1}))
    single = summary[summary["scope"] == "object"]
    if len(single):
        names = {values["name"]: values["name"] for values in chosen}
        for metric in ("r_lambda", "r_gap"):
            title = f"{METRIC[metric].label} of single objects ({METRIC[metric].scale})"
            of_metric = single[single["metric"] == metric]
            parts.append(_level_table(title, levels, of_metric, "object", names))
        parts.append(_reaction_table(single, levels))
    results = "perturb_summary.parquet (means), perturb_global and perturb_objects (one row per repeat), perturb.png"
    return [*parts, *_last_lines(outcome, results)]


def ablate_view(outcome: ExperimentOutcome) -> View:
    """A table for each parameter."""
    parts: list[Part] = []
    if outcome.metadata:
        for name, values in outcome.request["values"].items():
            if len(values) > 1:
                parts.append(_parameter_table(outcome, name))
        note = "A small r_lambda can also result from a poor alignment (a large change): compare shift and change."
        parts.append(Note(f"{note}\n"))
    results = "ablate_summary.parquet (means over pairs), ablate.parquet (a row per pair and parameter set), ablate.png"
    return [*parts, *_last_lines(outcome, results)]


def _last_lines(outcome: ExperimentOutcome, results: str) -> list[Note]:
    """Number of failures and scans, and the files of the folder."""
    notes = []
    if outcome.failures:
        text = f"{len(outcome.failures)} failed, see the messages above and failures in run.json"
        notes.append(Note(text, "red"))
    made = f"{count(outcome.n_made, 'scan')} evaluated, {outcome.n_reused} reused, in {outcome.wall_s:.1f} s"
    return [*notes, Note(made), Note(f"results: {outcome.folder}/{results}")]


def _level_table(
    title: str,
    levels: Sequence[Perturbation],
    means: pd.DataFrame,
    column: str,
    headings: dict[str, str],
) -> Table:
    """One row per level and a line after each kind.

    Parameters
    ----------
    means : rows of `perturb_summary`
    column : its column whose values have a column each
    headings : heading by value of that column
    """
    cells = {}
    for row in means.to_dict("records"):
        level = Perturbation(row["kind"], row["amount"], row["shift_m"])
        cells[level, row[column]] = _spread(row["mean"], row["std"])
    rows = []
    last = {}
    for i, level in enumerate(levels):
        shown = [cells.get((level, name), "-") for name in headings]
        rows.append((KINDS[level.kind].text.format(level), *shown))
        last[level.kind] = i
    title = f"{title}: mean ± std over {count(means['n'].max(), 'repeat')}"
    return Table(title, ("altered by", *headings.values()), rows, fixed=(0,), ruled=last.values())


def _reaction_table(means: pd.DataFrame, levels: Sequence[Perturbation]) -> Table:
    """Means over the objects of our metrics and of baselines at the strongest level of each kind.

    The last column is the kind at which a metric is farthest from its value for equal objects.
    """
    over_objects = means.groupby(["metric", "kind", "amount", "shift_m"])["mean"].mean()
    strongest = strongest_levels(levels)
    others = sorted(set(means["metric"]) - {*OBJECT_METRICS})
    rows = []
    for metric in (*_REACTING, *others):
        values = [over_objects.get((metric, *astuple(level)), nan) for level in strongest]
        equal = METRIC[metric].equal or 0.0
        moved = np.nan_to_num(np.abs(np.array(values) - equal))
        most = ""
        if moved.any():
            kind = strongest[moved.argmax()].kind
            most = KINDS[kind].heading.partition("\n")[0]
        rows.append((metric, *map(_number, values), most))
    headings = [KINDS[level.kind].heading.format(level.amount) for level in strongest]
    title = "Reaction of each metric: means over the objects at the strongest level of each kind"
    words = (0, len(strongest) + 1)
    columns = ("metric", *headings, "most to")
    return Table(title, columns, rows, words, ruled=(len(_REACTING) - 1,))


def strongest_levels(levels: Sequence[Perturbation]) -> list[Perturbation]:
    """The level of each kind with the largest amount; of density also the one with the smallest."""
    strongest = []
    for kind in dict.fromkeys(level.kind for level in levels):
        of_kind = [level for level in levels if level.kind == kind]
        of_kind.sort(key=lambda level: (level.amount, level.shift_m))
        if kind == "density" and of_kind[0].amount < 1 < of_kind[-1].amount:
            strongest.append(of_kind[0])
        strongest.append(of_kind[-1])
    return strongest


def _parameter_table(outcome: ExperimentOutcome, name: str) -> Table:
    """Means over pairs at each value of a parameter, with current values of the others."""
    means = means_along(outcome, name).pivot(index=name, columns="metric", values=["mean", "std"])
    current = getattr(base_of(outcome.request), name)
    rows = []
    for value, row in means.iterrows():
        cells = []
        for place, score in enumerate(_ABLATED_SCORES):
            cell = number(row["mean", score])
            if place < _N_WITH_STD and len(outcome.metadata) > 1:
                cell = mean_and_spread(row["mean", score], row["std", score])
            cells.append(cell)
        mark = "*" if value == current else ""
        rows.append((f"{mark}{value:g}", *cells))
    n_pairs = count(len(outcome.metadata), "pair")
    return Table(
        f"{PARAMETERS[name].group}.{name}: mean ± std over {n_pairs}, * current",
        (name.removesuffix("_m"), *narrow_labels(_ABLATED_SCORES)),
        rows,
        words=(),
        fixed=range(len(_ABLATED_SCORES) + 1),
        bold=(list(means.index).index(current),),
    )


def _spread(mean: float, std: float) -> str:
    return _number(mean) if isnan(std) else f"{_number(mean)}±{_number(std)}"


def _number(value: float) -> str:
    """Three digits; a power of ten if they would all be 0, no decimals for large numbers."""
    if isnan(value) or value == 0 or 5e-4 <= abs(value) < 10:
        return number(value)
    return f"{value:.0f}" if abs(value) >= 10 else f"{value:.0e}"
