"""A run: its first answer, pairs, scores, findings, baselines and stability of the scores."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from ....schemas.columns import SIDES, Row
from ....schemas.metric_catalogue import (
    COVERAGE_REACHES,
    DISTRIBUTED,
    METRIC,
    labels,
    metric_of,
    narrow_labels,
    pair_columns_in,
    unit_words,
)
from ....schemas.record import BaselineSummary, RunRecord, SeedSummary, TaskSummary
from ....schemas.results import Findings, JsonObject
from ...results.best_case import RunExcess
from ...results.finished import FinishedRun, run_values
from ...storage.run_record import unmatched_worst
from ..view import (
    Note,
    Part,
    Table,
    View,
    columns_of,
    first_of,
    mean_and_spread,
    number,
    percent,
    shortened,
)
from .answer_view import answer_view, frame_warnings
from .best_case_view import HEADLINES, excess_view

if TYPE_CHECKING:
    from ...run import RunOutcome

_MOST_PAIRS = 20
_MOST_CLASSES = 8
_PAIR_WIDTH = 16
_SCORES = pair_columns_in("run")
#: All scores of the summary, displacement and roughness of the surface last.
_DATASET = (
    *pair_columns_in("numbers"),
    *(f"covered_{side}_{reach}" for side in SIDES for reach in COVERAGE_REACHES),
    *("shift_x_m", "shift_y_m", "shift_z_m", "roughness_real_m", "roughness_sim_m"),
)


def outcome_view(outcome: RunOutcome) -> View:
    """The end of a run: failures, baselines and spread over seeds if computed, and the answer."""
    seconds = outcome.record.wall_s["total"]
    took = f" in {seconds:.3g} s" if seconds < 1000 else f" in {seconds / 60:.0f} min"
    if outcome.n_reused:
        took += f", {outcome.n_made} jobs done, {outcome.n_reused} reused"
    return summary_view(FinishedRun(outcome.folder), took=took)


def outcome_values(outcome: RunOutcome) -> JsonObject:
    """Those of `fidpipe show --json`, with the number of jobs and the failures."""
    jobs = {"made": outcome.n_made, "reused": outcome.n_reused}
    values = run_values(FinishedRun(outcome.folder))
    return values | {"jobs": jobs, "failures": outcome.failures}


def summary_view(
    run: FinishedRun,
    excess: RunExcess | None = None,
    *,
    with_all: bool = False,
    took: str = "",
) -> View:
    """Failures and warnings, then the first answer; with `with_all` all tables of the run first.

    Parameters
    ----------
    excess : the run over a best case
    took : time and reused jobs of a run that just ended
    """
    record = run.record
    parts: list[Part] = []
    if with_all and record.findings:
        parts += [_pairs_table(run.scored), *details_view(record)]
        parts += _findings_parts(record.findings)
    if record.baselines:
        parts += baselines_view(record.baselines)
    if record.seeds:
        parts += seeds_view(record.seeds)
    if excess:
        parts += [*excess_view(excess, HEADLINES), Note("")]
    parts += [*failures_view(run), *frame_warnings(run)]
    return [*parts, *answer_view(run, excess, with_all=with_all, took=took)]


def details_view(record: RunRecord) -> View:
    """Tasks, all scores, and surface and objects by range and class."""
    parts: list[Part] = [*tasks_view(record.tasks), dataset_table(record)]
    if record.findings:
        parts += [surface_table(record.findings), _objects_table(record.findings)]
    return parts


def surface_table(findings: Findings) -> Table:
    """Missing and invented surface by range and by class."""
    rows = []
    for group in findings.groups:
        missing = percent(group.missing_share)
        invented = percent(group.invented_share)
        rows.append((group.name, group.n_real_points, missing, group.n_sim_points, invented))
    title = "Surface by range and class (object points without a counterpart within 0.3 m)"
    return Table(title, ("", "real points", "missing", "simulated points", "invented"), rows)


def failures_view(run: FinishedRun) -> View:
    """Failed pairs with their reasons."""
    failures = [row for row in run.rows if row["status"] == "failed"]
    if not failures:
        return []
    text = f"{len(failures)} of {len(run.rows)} pairs failed:"
    reasons = [f"  {row['pair_id']}: {row['reason']}" for row in failures]
    lines = first_of(reasons, _MOST_PAIRS, "  and {} more, see pairs.parquet")
    return [Note(text, "red"), *map(Note, lines)]


def baselines_view(summaries: Sequence[BaselineSummary]) -> View:
    """Mean and deviation over pairs of each baseline, of matched objects and of whole scans."""
    rows = []
    notes = []
    for summary in summaries:
        metric = METRIC[summary.baseline]
        mean = mean_and_spread(summary.mean, summary.std, 4)
        rows.append((metric.heading, summary.level, unit_words(metric.unit), mean))
        if summary.n_null:
            n = summary.n + summary.n_null
            notes.append(f"{summary.baseline} is null for {summary.n_null} of {n} {summary.level}")
    headings = ("baseline", "of", "unit", "mean")
    title = "Baselines (mean and standard deviation over pairs)"
    lines = (
        "A pair counts with the mean over its matched objects, or with all object points of its "
        "two scans (nvs: ground as well).",
        *notes,
    )
    return [Table(title, headings, rows, words=(0, 1, 2)), *map(Note, lines)]


def seeds_view(seeds: SeedSummary) -> View:
    """Spread of each score over seeds next to its spread over pairs."""
    rows = []
    for column in _SCORES:
        rows.append((metric_of(column).label, *vars(seeds.dataset[column]).values()))
    headings = (
        *("score", "mean", "std over\npairs", "std over\nseeds"),
        *("repeatability\n(one pair)", "repeatability\n(all pairs)"),
    )
    title = f"How stable the scores are ({seeds.n_seeds} seeds, {seeds.n_pairs} pairs)"
    text = (
        "repeatability limit (ISO 5725): two results with different seeds, of one pair or the "
        "means of all pairs, that differ by less may do so by chance alone (95 %); a simulator is "
        "better only if it is so by more"
    )
    return [Table(title, headings, rows), Note(text)]


def tasks_view(summaries: Sequence[TaskSummary]) -> View:
    """Mean of each measure of the tasks on both sides, and of its gap; nothing without tasks."""
    rows = []
    for summary in summaries:
        gap = mean_and_spread(summary.gap, summary.gap_std)
        names = (summary.task, summary.measure, summary.unit)
        rows.append((*names, number(summary.real, 2), number(summary.sim, 2), gap))
    if not rows:
        return []
    headings = ("task", "measure", "unit", "real", "simulated", "gap")
    title = "Tasks (means over pairs; gap 0: a perception stack would notice nothing)"
    return [Table(title, headings, rows, words=(0, 1, 2))]


def _pairs_table(scored: Sequence[Row]) -> Table:
    title = "Pairs (means over matched objects)"
    if len(scored) > _MOST_PAIRS:
        scored = sorted(scored, key=lambda row: row["match_rate"])[:_MOST_PAIRS]
        title = f"The {_MOST_PAIRS} pairs with the lowest match rate (means over matched objects)"
    headings = ("pair", "objects\nboth", "only\nreal", "only\nsim", *narrow_labels(_SCORES))
    columns = ("pair_id", "n_matched", "n_not_found", "n_extra", *_SCORES)
    names = shortened({row["pair_id"] for row in scored}, _PAIR_WIDTH)
    rows = [row | {"pair_id": names[row["pair_id"]]} for row in scored]
    return Table(title, headings, columns_of(rows, columns), whole=(0,))


def dataset_table(record: RunRecord) -> Table:
    """Means over pairs, number of pairs, and means with unmatched objects as worst.

    Under the paper's preset also the paper's means.
    """
    with_paper = record.preset == "paper"
    headings = ["score", "mean", "std", "pairs", "unmatched\nas worst", "how to read it"]
    if with_paper:
        headings.append("paper")
    rows = []
    for column in _DATASET:
        metric = metric_of(column)
        score = record.summary[column]
        worst = record.summary.get(unmatched_worst(metric.column))
        row: list[object] = [
            metric.label,
            score.mean,
            score.std,
            f"{score.n_pairs} of {record.pairs.scored}",
            worst.mean if worst else "",
            metric.reading or metric.meaning,
        ]
        if with_paper:
            row.append("" if metric.paper_mean is None else metric.paper_mean)
        rows.append(row)
    title = "Dataset (mean and standard deviation over pairs)"
    return Table(title, headings, rows, words=(0, 5), wide=(5,), whole=(0,))


def _findings_parts(findings: Findings) -> View:
    """Distributions over all objects, as in the paper's "Real experiments"."""
    rank = findings.rank_correlation
    ratio = findings.density_ratio
    return [
        _distributions(findings),
        Note(
            f"Rank correlation of CDC and r_lambda: Spearman {number(rank.spearman, 2)}, Kendall "
            f"{number(rank.kendall, 2)} (near 0: they measure different things)"
        ),
        Note(
            f"Points, simulated / real: {number(ratio.min, 2)} to {number(ratio.max, 2)}, median "
            f"{number(ratio.median, 2)}; below 1/4 in {percent(ratio.share_below_quarter)}, "
            f"above 4 in {percent(ratio.share_above_four)} of the objects\n"
        ),
    ]


def _distributions(findings: Findings) -> Table:
    values = ("min", "q05", "q25", "median", "q75", "q95", "max", "std", "cv")
    headings = ("score", "min", "5 %", "25 %", "median", "75 %", "95 %", "max", "std", "std/mean")
    rows = []
    for name in DISTRIBUTED:
        distribution = findings.distributions[name]
        rows.append([METRIC[name].label, *(getattr(distribution, value) for value in values)])
    title = f"Objects (the {findings.n_matched} that both sides have, of all pairs together)"
    return Table(title, headings, rows)


def _objects_table(findings: Findings) -> Table:
    """Objects that only one side has, and mean scores, by range and by class."""
    ranges = [group for group in findings.groups if group.by == "range"]
    classes = [group for group in findings.groups if group.by == "class"]
    rows = []
    for group in [*ranges, *classes[:_MOST_CLASSES]]:
        n_both = f"{group.n_real - group.n_not_found} ({group.scores['r_lambda'].n})"
        row = (
            group.name,
            group.n_real,
            _with_share(group.n_not_found, group.n_real),
            group.n_sim,
            _with_share(group.n_extra, group.n_sim),
            n_both,
        )
        rows.append((*row, *(group.scores[score].mean for score in DISTRIBUTED)))
    title = (
        "Objects by range and by the most frequent classes (median range of matched objects "
        f"{number(findings.median_matched_m, 1)} m, of unmatched ones "
        f"{number(findings.median_unmatched_m, 1)} m)"
    )
    headings = ("", "real", "not found", "sim", "extra", "both\n(scored)", *labels(DISTRIBUTED))
    return Table(title, headings, rows)


def _with_share(n: int, n_all: int) -> str:
    return f"{n} ({percent(n / n_all if n_all else None)})"
