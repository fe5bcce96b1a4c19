"""A run: its first answer, pairs, scores, findings, baselines and stability of the scores."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from ....schemas.columns import Row
from ....schemas.metric_catalogue import (
    COVERED,
    METRIC,
    QUADRANT_SCORES,
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
    percent,
    shortened,
)
from .answer_view import answer_view, frame_warnings
from .best_case_view import excess_view

if TYPE_CHECKING:
    from ...run import RunOutcome

_MOST_PAIRS = 20
_PAIR_WIDTH = 16
_SCORES = pair_columns_in("run")


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
        parts += [_worst_pairs(run.scored), *details_view(record)]
    if record.baselines:
        parts += baselines_view(record.baselines)
    if record.seeds:
        parts += seeds_view(record.seeds)
    if excess:
        parts += [*excess_view(excess), Note("")]
    parts += [*failures_view(run), *frame_warnings(run)]
    return [*parts, *answer_view(run, excess, with_all=with_all, took=took)]


def details_view(record: RunRecord) -> View:
    """Tasks, all scores, and surface and objects by range and class."""
    parts = [*tasks_view(record.tasks), dataset_table(record)]
    if record.findings:
        parts.append(_groups_table(record.findings))
    return parts


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
        unit = unit_words(metric.unit)
        rows.append((metric.heading, summary.level, unit, summary.mean, summary.std))
        if summary.n_null:
            n = summary.n + summary.n_null
            notes.append(
                f"{summary.baseline} is null for {summary.n_null} of {n} {summary.level}"
            )
    headings = ("baseline", "of", "unit", "mean", "std")
    title = "Baselines (mean and standard deviation over pairs)"
    lines = (
        "A pair counts with the mean over its matched objects, or with all object points of its "
        "two scans (nvs: ground as well).",
        *notes,
    )
    return [Table(title, headings, rows, words=(0, 1, 2), digits=4), *map(Note, lines)]


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
    names = ("task", "measure", "unit", "real", "sim", "gap", "gap_std")
    rows = columns_of(map(vars, summaries), names)
    if not rows:
        return []
    headings = ("task", "measure", "unit", "real", "simulated", "gap", "std of gap")
    title = "Tasks (means over pairs; gap 0: a perception stack would notice nothing)"
    return [Table(title, headings, rows, words=(0, 1, 2))]


def pairs_table(pairs: Sequence[Row], links: Sequence[str] = ()) -> Table:
    """Scored pairs in the given order; a terminal has the first of them, and no room for coverage.

    links : addresses of the pairs on a page
    """
    columns = ("pair_id", "n_matched", "n_not_found", "n_extra", *_SCORES, *COVERED)
    wide = range(len(columns) - len(COVERED), len(columns))
    scores = narrow_labels((*_SCORES, *COVERED))
    headings = ("pair", "objects\nboth", "only\nreal", "only\nsim", *scores)
    cells = columns_of(pairs, columns)
    title = "Pairs, worst first (means over matched objects)"
    return Table(title, headings, cells, wide=wide, whole=(0,), links=links)


def _worst_pairs(scored: Sequence[Row]) -> Table:
    """The pairs with the lowest match rate, their names shortened."""
    worst = sorted(scored, key=lambda row: row["match_rate"])[:_MOST_PAIRS]
    names = shortened({row["pair_id"] for row in worst}, _PAIR_WIDTH)
    return pairs_table([row | {"pair_id": names[row["pair_id"]]} for row in worst])


def dataset_table(record: RunRecord) -> Table:
    """Means over pairs, number of pairs, and means with unmatched objects as worst."""
    headings = ("score", "mean", "std", "pairs", "unmatched\nas worst", "how to read it")
    rows = []
    for column in pair_columns_in("numbers"):
        metric = metric_of(column)
        score = record.summary[column]
        worst = record.summary.get(unmatched_worst(metric.column))
        n_pairs = f"{score.n_pairs} of {record.pairs.scored}"
        unmatched = worst.mean if worst else ""
        reading = metric.reading or metric.meaning
        rows.append((metric.label, score.mean, score.std, n_pairs, unmatched, reading))
    title = "Dataset (mean and standard deviation over pairs)"
    return Table(title, headings, rows, words=(0, 5), wide=(5,), whole=(0,))


def _groups_table(findings: Findings) -> Table:
    """Surface and objects that only one side has, and mean scores, by range and by class."""
    rows: list[tuple[object, ...]] = []
    for group in findings.groups:
        counts = (group.n_real, group.n_not_found, group.n_sim, group.n_extra)
        shares = (percent(group.missing_share), percent(group.invented_share))
        scores = [group.scores[name] for name in QUADRANT_SCORES]
        rows.append((group.name, *shares, *counts, *scores))
    title = "By range and class (missing, invented: of the object points, within 0.3 m)"
    headings = (
        *("", "missing", "invented", "objects\nreal", "not\nfound", "objects\nsim", "extra"),
        *labels(QUADRANT_SCORES),
    )
    return Table(title, headings, rows)
