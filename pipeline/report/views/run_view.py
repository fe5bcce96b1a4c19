"""A run: its first answer, pairs, scores, findings, baselines and stability of the scores."""

from __future__ import annotations

from collections.abc import Container, Sequence
from pathlib import Path
from shlex import quote
from typing import TYPE_CHECKING

from ....schemas.columns import Row
from ....schemas.metric_catalogue import (
    COVERAGE_REACHES,
    DISTRIBUTED,
    METRIC,
    QUADRANT_SCORES,
    headline_scores,
    labels,
    metric_of,
    narrow_labels,
    pair_columns_in,
    reach_words,
    unit_words,
)
from ....schemas.record import (
    OF_OBJECTS,
    OF_SCAN,
    SURFACE_STATES,
    BaselineSummary,
    RunRecord,
    SeedSummary,
    SurfaceStates,
    TaskSummary,
)
from ....schemas.results import Diagnosis, Findings, Overview, Unmatched
from ....stages.coverage import ABSENT, THERE
from ...results.best_case import RunExcess
from ...results.diagnosis import diagnosis_of
from ...storage.folder import RunFolder
from ...storage.run_record import unmatched_worst
from ...storage.urls import url_or_path
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
)
from .answer_view import answer_view, caution_words, departures
from .best_case_view import HEADLINES, excess_view

if TYPE_CHECKING:
    from ...run import RunOutcome

_MOST_PAIRS = 20
_MOST_CLASSES = 8
_SCORES = pair_columns_in("run")
#: The scores whose spread over seeds is shown of each pair; more would not fit.
_SEED_SCORES = headline_scores("paper")
#: A score of scans or objects whose mean is below this has a digit more.
_SMALL = 0.1
_LARGE = 100


def outcome_view(outcome: RunOutcome) -> View:
    """The end of a run: failures, baselines and spread over seeds if computed, and the answer."""
    record = outcome.record
    rows = outcome.pairs.select(["pair_id", "status", "reason"]).to_pylist()
    scored = [row["pair_id"] for row in rows if row["status"] == "scored"]
    diagnosis = diagnosis_of(RunFolder(outcome.folder), record, scored)
    seconds = record.wall_s["total"]
    took = f" in {seconds:.3g} s" if seconds < 1000 else f" in {seconds / 60:.0f} min"
    if outcome.n_reused:
        took += f", {outcome.n_made} jobs done, {outcome.n_reused} reused"
    return summary_view(outcome.folder, rows, record, diagnosis, outcome.reported, took=took)


def summary_view(
    folder: Path,
    rows: Sequence[Row],
    record: RunRecord,
    diagnosis: Diagnosis | None = None,
    reported: Container[str] = frozenset(),
    excess: RunExcess | None = None,
    *,
    with_all: bool = False,
    took: str = "",
) -> View:
    """Failures and warnings, then the first answer; with `with_all` all tables of the run first.

    Parameters
    ----------
    diagnosis : of the run, if it has one
    reported : pairs whose failure was reported before
    excess : the run over a best case
    took : time and reused jobs of a run that just ended
    """
    parts: list[Part] = []
    if with_all:
        parts += _all_tables(rows, record)
    if record.baselines:
        parts += baselines_view(record.baselines)
    if record.seeds:
        parts += seeds_view(record.seeds)
    if excess:
        parts += [*excess_view(excess, HEADLINES), Note("")]
    parts += _failures_parts(folder, rows, reported)
    for words in caution_words(record.overview, ("frames",)) if record.overview else ():
        parts.append(Note(f"warning: {words}", "yellow"))
    parts += answer_view(folder, record, diagnosis, excess, with_all=with_all, took=took)
    return parts


def _all_tables(rows: Sequence[Row], record: RunRecord) -> View:
    """The pairs of a run and their summary."""
    if record.findings is None:
        return []
    parts: list[Part] = [
        *tasks_view(record.tasks),
        Note(preset_line(record)),
        _pairs_table([row for row in rows if row["status"] == "scored"]),
        dataset_table(record, ("found", *_SCORES)),
        coverage_table(record),
        *map(Note, (surface_line(record), *unmatched_lines(record), "")),
    ]
    if record.overview:
        parts.append(surface_table(record.overview))
    return [*parts, *_findings_parts(record.findings)]


def surface_table(overview: Overview) -> Table:
    """Missing and invented surface by range and by class."""
    rows = []
    for group in overview.surface:
        missing = percent(group.missing_share)
        invented = percent(group.invented_share)
        rows.append((group.name, group.n_real, missing, group.n_sim, invented))
    title = "Surface by range and class (object points without a counterpart within 0.3 m)"
    return Table(title, ("", "real points", "missing", "simulated points", "invented"), rows)


def _failures_parts(folder: Path, rows: Sequence[Row], reported: Container[str]) -> View:
    """Failed pairs with their reasons; failures already reported are only counted."""
    failures = [row for row in rows if row["status"] == "failed"]
    if not failures:
        return []
    new = [row for row in failures if row["pair_id"] not in reported]
    n_reported = len(failures) - len(new)
    text = f"{len(failures)} of {len(rows)} pairs failed"
    if n_reported:
        which = "" if n_reported == len(failures) else f"{n_reported} of them "
        command = f"fidpipe show {quote(url_or_path(folder))}"
        text += f", {which}as reported above; show them again with: {command}"
    if new:
        text += ":"
    reasons = [f"  {row['pair_id']}: {row['reason']}" for row in new]
    lines = first_of(reasons, _MOST_PAIRS, "  and {} more, see pairs.parquet")
    return [Note(text, "red"), *map(Note, lines)]


def baselines_view(summaries: Sequence[BaselineSummary]) -> View:
    """Mean and deviation over pairs of each baseline, and seconds per pair.

    Of matched objects and of whole scans.
    """
    by_name: dict[str, dict[str, BaselineSummary]] = {}
    notes = []
    for summary in summaries:
        by_name.setdefault(summary.baseline, {})[summary.level] = summary
        if summary.n_null:
            n = summary.n + summary.n_null
            notes.append(f"{summary.baseline} is null for {summary.n_null} of {n} {summary.level}")
    rows = []
    for name, by_level in by_name.items():
        metric = METRIC[name]
        objects = _baseline_cells(by_level.get(OF_OBJECTS))
        scans = _baseline_cells(by_level.get(OF_SCAN))
        rows.append((metric.heading, unit_words(metric.unit), *objects, *scans))
    headings = ("baseline", "unit", "objects", "s", "whole scans", "s")
    title = "Baselines (mean and standard deviation over pairs)"
    total_s = sum(summary.seconds or 0.0 for summary in summaries)
    lines = (
        "A pair counts with the mean over its matched objects, or with all object points of its "
        "two scans (nvs: ground as well).",
        f"s: seconds per pair, next to the first number of a method; in total {total_s:.1f}",
        *notes,
    )
    return [Table(title, headings, rows, words=(0, 1)), *map(Note, lines)]


def _baseline_cells(summary: BaselineSummary | None) -> tuple[str, str]:
    """Mean and deviation, and seconds; empty where the baseline has no such value."""
    if summary is None:
        return "", ""
    size = abs(summary.mean or 0.0)
    digits = 3
    if 0 < size < _SMALL:
        digits = 4
    elif size >= _LARGE:
        digits = 0
    seconds = "" if summary.seconds is None else number(summary.seconds)
    return mean_and_spread(summary.mean, summary.std, digits), seconds


def seeds_view(seeds: SeedSummary) -> View:
    """Spread over seeds next to spread over pairs; mean and deviation over seeds of each pair."""
    spreads = []
    for column in _SCORES:
        spreads.append((metric_of(column).label, *vars(seeds.dataset[column]).values()))
    headings = (
        *("score", "mean", "std over\npairs", "std over\nseeds"),
        *("repeatability\n(one pair)", "repeatability\n(all pairs)"),
    )
    title = f"How stable the scores are ({seeds.n_seeds} seeds, {seeds.n_pairs} pairs)"
    pairs = list(seeds.pairs.items())
    pairs_title = "Pairs (mean ± standard deviation over seeds)"
    if len(pairs) > _MOST_PAIRS:
        pairs = sorted(pairs, key=lambda pair: -(pair[1]["match_rate"].std or 0.0))[:_MOST_PAIRS]
        pairs_title = (
            f"The {_MOST_PAIRS} pairs whose match rate depends most on the seed "
            "(mean ± standard deviation)"
        )
    rows = []
    for pair_id, scores in pairs:
        spread = [scores[column] for column in _SEED_SCORES]
        rows.append((pair_id, *(mean_and_spread(score.mean, score.std) for score in spread)))
    return [
        Table(title, headings, spreads),
        Note(
            "repeatability limit (ISO 5725): two results with different seeds, of one pair or the "
            "means of all pairs,"
        ),
        Note(
            "that differ by less may do so by chance alone (95 %); a simulator is better only if "
            "it is so by more"
        ),
        Table(pairs_title, ("pair", *labels(_SEED_SCORES)), rows),
    ]


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
    columns = ("pair_id", "n_matched", "n_missing", "n_hallucinated", *_SCORES)
    return Table(title, headings, columns_of(scored, columns))


def dataset_table(record: RunRecord, columns: Sequence[str]) -> Table:
    """Means over pairs, number of pairs, and means with unmatched objects as worst.

    Under the paper's preset also the paper's means.
    """
    with_paper = record.preset == "paper"
    headings = ["score", "mean", "std", "pairs", "unmatched\nas worst", "how to read it"]
    if with_paper:
        headings.append("paper")
    rows = []
    for column in columns:
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
    title = (
        "Dataset (mean and standard deviation over pairs; pairs without a match have no object "
        "scores)"
    )
    return Table(title, headings, rows, words=(0, 5), wide=(6,))


def coverage_table(record: RunRecord) -> Table:
    """Share of each side's surface that the other side has, mean and deviation over pairs."""
    rows = []
    for side, words in (
        ("real", "real points with a simulated one"),
        ("sim", "simulated points with a real one"),
    ):
        scores = [record.summary[f"covered_{side}_{reach}"] for reach in COVERAGE_REACHES]
        rows.append((words, *(mean_and_spread(score.mean, score.std) for score in scores)))
    headings = ("share of", *(f"within {reach_words(reach)}" for reach in COVERAGE_REACHES))
    title = "Surface (mean and std over pairs; the rest is missing or invented)"
    return Table(title, headings, rows)


def surface_line(record: RunRecord) -> str:
    """The displacement vector of the simulated surface, and the median roughness of both sides.

    Means over pairs.
    """
    mean = {name: number(score.mean) for name, score in record.summary.items()}
    return (
        f"the simulated surface is displaced by x {mean['shift_x_m']}, y {mean['shift_y_m']}, "
        f"z {mean['shift_z_m']} m (mean over pairs; mean length {mean['shift_m']} m); its median "
        f"roughness is {mean['roughness_sim_m']} m, that of the real one "
        f"{mean['roughness_real_m']} m"
    )


def unmatched_lines(record: RunRecord) -> list[str]:
    """State of the unmatched objects, a line for each side that has some."""
    lines: list[str] = []
    if record.metrics is None:
        return lines
    n_pairs = max(1, record.pairs.scored)
    for status, other in (("missing", "simulated"), ("hallucinated", "real")):
        states: SurfaceStates = getattr(record.metrics.unmatched, status)
        objects = {"missing": "objects not found", "hallucinated": "extra objects"}[status]
        n_states = [getattr(states, name) for name in SURFACE_STATES]
        there, partly, absent = [n / n_pairs for n in n_states]
        total = there + partly + absent
        near = f"of their points have a {other} one within 0.3 m"
        if there or partly:
            lines.append(
                f"of {total:.1f} {objects} per pair, {there:.1f} exist on the other side, "
                f"partitioned differently (over {100 * THERE:.0f} % {near}), {partly:.1f} partly, "
                f"{absent:.1f} absent"
            )
        elif absent:
            lines.append(
                f"the {total:.1f} {objects} per pair are all absent from the {other} side "
                f"(at most {100 * ABSENT:.0f} % {near})"
            )
        if states.road:
            lines.append(
                f"{states.road} of the {sum(n_states)} {objects} are road that the ground "
                f"cut of the {other} side removed and that of their side kept (column road_share)"
            )
    if lines:
        lines.append(
            "missing and invented pieces are parts of a surface without a counterpart, also of "
            "matched objects"
        )
    return lines


def preset_line(record: RunRecord) -> str:
    """The preset of a run, the kind of its objects, and the settings that differ from it."""
    from ....schemas.settings import PRESET_OBJECTS  # takes as long to load as all else here

    return f"preset {record.preset} ({PRESET_OBJECTS[record.preset]}){departures(record)}"


def _findings_parts(findings: Findings) -> View:
    """Distributions, ranges, classes and four scans, as in the paper's "Real experiments"."""
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
        range_table(findings),
        *(_classes(findings) if findings.classes else ()),
        _scans(findings),
    ]


def _distributions(findings: Findings) -> Table:
    values = ("min", "q05", "q25", "median", "q75", "q95", "max", "std", "cv")
    headings = (
        "score",
        *("min", "5 %", "25 %", "median", "75 %", "95 %", "max"),
        "std",
        "std/mean",
    )
    rows = []
    for name in DISTRIBUTED:
        distribution = getattr(findings.distributions, name)
        rows.append([METRIC[name].label, *(getattr(distribution, value) for value in values)])
    title = f"Objects (the {findings.n_matched} that both sides have, of all pairs together)"
    return Table(title, headings, rows)


def range_table(findings: Findings) -> Table:
    """Objects that only one side has, by range."""
    ranges = findings.range_m
    rows = []
    for band in ranges.bands:
        end = "and more" if band.to_m is None else f"to {band.to_m:.0f}"
        rows.append((f"{band.from_m:.0f} {end}", *_unmatched(band)))
    title = (
        f"By range (median range of matched objects {number(ranges.median_matched, 1)} m, of "
        f"unmatched ones {number(ranges.median_unmatched, 1)} m)"
    )
    return Table(title, ("range (m)", "real", "not found", "sim", "extra"), rows)


def _classes(findings: Findings) -> View:
    classes = findings.classes[:_MOST_CLASSES]
    title = "By class (of the real object where both sides have it)"
    if len(classes) < len(findings.classes):
        title = (
            f"The {_MOST_CLASSES} most frequent of {len(findings.classes)} classes (of the real "
            "object where both have it)"
        )
    rows = []
    fewer = []
    for group in classes:
        means = []
        for score in DISTRIBUTED:
            mean = group.scores[score]
            is_of_all = mean.n == group.n_matched
            means.append(number(mean.mean) + ("" if is_of_all else "*"))
            if not is_of_all:
                fewer.append(f"{group.label} {METRIC[score].label} of {mean.n}")
        rows.append((group.label, *_unmatched(group), group.n_matched, *means))
    headings = ("class", "real", "not found", "sim", "extra", "both", *labels(DISTRIBUTED))
    parts: list[Part] = [Table(title, headings, rows)]
    if fewer:
        parts.append(Note(f"* some objects are too small for the score: {', '.join(fewer)}\n"))
    return parts


def _scans(findings: Findings) -> Table:
    """Quartiles of the scores in a few scans, those of the paper's box plots."""
    scans = findings.scans
    kind = "evenly spaced by name (quartiles; no timestamps say that they are a minute apart)"
    if scans.apart:
        kind = "more than a minute apart (quartiles over their objects)"
    headings = ["pair", "time (s)", "objects"]
    for name in QUADRANT_SCORES:
        headings += [f"{METRIC[name].label} 25 %", "50 %", "75 %"]
    rows = []
    for scan in scans.scans:
        row: list[object] = [scan.pair, scan.timestamp_s, scan.cdc.n]
        for name in QUADRANT_SCORES:
            score = getattr(scan, name)
            row += [score.q25, score.median, score.q75]
        rows.append(row)
    digits = {1: 0, **dict.fromkeys(range(3, 9), 2)}
    return Table(f"{len(scans.scans)} scans {kind}", headings, rows, digits=digits)


def _unmatched(group: Unmatched) -> tuple[object, ...]:
    return (
        group.n_real,
        f"{group.n_missing} ({percent(group.missing_share)})",
        group.n_sim,
        f"{group.n_hallucinated} ({percent(group.hallucinated_share)})",
    )
