"""A run: its first answer, pairs, scores, findings, baselines and stability of the scores."""

from __future__ import annotations

from collections.abc import Container, Sequence
from operator import attrgetter
from pathlib import Path
from shlex import quote
from typing import TYPE_CHECKING

from ....schemas.columns import Row
from ....schemas.metric_catalogue import (
    COVERAGE_REACHES,
    DISTRIBUTED,
    HEADLINE_SCORES,
    METRIC,
    labels,
    metric_of,
    narrow_labels,
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
)
from ....schemas.results import ClassFindings, Diagnosis, Findings, Overview, Unmatched
from ....stages.coverage import ABSENT, THERE
from ...results.best_case import RunExcess
from ...results.diagnosis import diagnosis_of
from ...storage.folder import RunFolder
from ...storage.run_record import unmatched_worst
from ...storage.urls import url_or_path
from ..view import Note, Table, View, mean_and_spread, number, percent
from .answer_view import answer_view
from .best_case_view import HEADLINES, excess_view

if TYPE_CHECKING:
    from ...run import RunOutcome

_MOST_PAIRS = 20
_MOST_CLASSES = 8
#: The scores of the paper's box plots.
_BOXES = ("cdc", "r_lambda")
#: The scores whose spread over seeds is shown of each pair; all headline scores would not fit.
_SEED_SCORES = HEADLINE_SCORES[:4]


def outcome_view(outcome: RunOutcome) -> View:
    """The end of a run: failures, baselines and spread over seeds if computed, and the first answer."""
    record, rows = outcome.record, outcome.pairs.select(["pair_id", "status", "reason"]).to_pylist()
    scored = [row["pair_id"] for row in rows if row["status"] == "scored"]
    diagnosis = diagnosis_of(RunFolder(outcome.folder), record, scored)
    seconds = record.wall_s["total"]
    took = f" in {seconds:.3g} s" if seconds < 1000 else f" in {seconds / 60:.0f} min"
    jobs = f", {outcome.n_made} jobs done, {outcome.n_reused} reused" * bool(outcome.n_reused)
    return summary_view(outcome.folder, rows, record, diagnosis, outcome.reported_failures, took=f"{took}{jobs}")


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
    """Failures and warnings, then the first answer; with `with_all` all tables of the run before it.

    Parameters
    ----------
    diagnosis : of the run, if it has one
    reported : pairs whose failure was reported before
    excess : the run over a best case
    took : time and reused jobs of a run that just ended
    """
    trust = record.overview.trust if record.overview else ()
    frames = [caution.words for caution in trust if caution.kind == "frames"]
    return [
        *(_all_tables(rows, record) if with_all else ()),
        *(baselines_view(record.baselines) if record.baselines else ()),
        *(seeds_view(record.seeds) if record.seeds else ()),
        *([*excess_view(excess, HEADLINES), Note("")] if excess else ()),
        *_failures_parts(folder, rows, reported),
        *(Note(f"warning: {words}", "yellow") for words in frames),
        *answer_view(folder, record, diagnosis, excess, with_all=with_all, took=took),
    ]


def _all_tables(rows: Sequence[Row], record: RunRecord) -> View:
    """The pairs of a run and their summary."""
    if record.findings is None:
        return []
    return [
        Note(preset_line(record)),
        _pairs_table([row for row in rows if row["status"] == "scored"], _MOST_PAIRS),
        dataset_table(record, ("found", *HEADLINE_SCORES)),
        coverage_table(record),
        *map(Note, (surface_line(record), *unmatched_lines(record), "")),
        *([surface_table(record.overview)] if record.overview else ()),
        *_findings_parts(record.findings),
    ]


def surface_table(overview: Overview) -> Table:
    """Missing and invented surface by range and by class."""
    rows = [
        (own.name, own.n_real, percent(own.missing_share), own.n_sim, percent(own.invented_share))
        for own in overview.surface
    ]
    title = "Surface by range and class (object points without a counterpart within 0.3 m)"
    return Table(title, ("", "real points", "missing", "simulated points", "invented"), rows)


def _failures_parts(folder: Path, rows: Sequence[Row], reported: Container[str]) -> View:
    """Failed pairs with their reasons; failures already reported are only counted."""
    failures = [row for row in rows if row["status"] == "failed"]
    if not failures:
        return []
    new = [row for row in failures if row["pair_id"] not in reported]
    count, n_reported = f"{len(failures)} of {len(rows)} pairs failed", len(failures) - len(new)
    which = "" if n_reported == len(failures) else f"{n_reported} of them "
    above = f", {which}as reported above; show them again with: fidpipe show {quote(url_or_path(folder))}"
    parts = [Note(f"{count}{above if n_reported else ''}{':' if new else ''}", "red")]
    parts += [Note(f"  {row['pair_id']}: {row['reason']}") for row in new[:_MOST_PAIRS]]
    if len(new) > _MOST_PAIRS:
        parts.append(Note(f"  and {len(new) - _MOST_PAIRS} more, see pairs.parquet"))
    return parts


def baselines_view(rows: Sequence[BaselineSummary]) -> View:
    """Mean and deviation over pairs of each baseline, of matched objects and of whole scans, and seconds per pair."""
    by_name = {(row.baseline, row.level): row for row in rows}
    cells = []
    for name in dict.fromkeys(row.baseline for row in rows):
        values = (cell for level in (OF_OBJECTS, OF_SCAN) for cell in _baseline_cells(by_name.get((name, level))))
        cells.append((METRIC[name].heading, unit_words(METRIC[name].unit), *values))
    columns = ("baseline", "unit", "objects", "s", "whole scans", "s")
    total_s = sum(row.seconds or 0.0 for row in rows)
    lines = (
        "A pair counts with the mean over its matched objects, or with all object points of its two scans "
        "(nvs: ground as well).",
        f"s: seconds per pair, next to the first number of a method; in total {total_s:.1f}",
        *(f"{row.baseline} is null for {row.n_null} of {row.n + row.n_null} {row.level}" for row in rows if row.n_null),
    )
    table = Table("Baselines (mean and standard deviation over pairs)", columns, cells, words=(0, 1))
    return [table, *map(Note, lines)]


def seeds_view(seeds: SeedSummary) -> View:
    """Spread over seeds next to spread over pairs, and mean and deviation over seeds of each pair."""
    spreads = [(metric_of(name).label, *vars(seeds.dataset[name]).values()) for name in HEADLINE_SCORES]
    headings = ("std over\npairs", "std over\nseeds", "repeatability\n(one pair)", "repeatability\n(all pairs)")
    title = f"How stable the scores are ({seeds.n_seeds} seeds, {seeds.n_pairs} pairs)"
    dataset = Table(title, ("score", "mean", *headings), spreads)
    chosen, title = list(seeds.pairs.items()), "Pairs (mean ± standard deviation over seeds)"
    if len(chosen) > _MOST_PAIRS:
        chosen = sorted(chosen, key=lambda pair: -(pair[1]["match_rate"].std or 0.0))[:_MOST_PAIRS]
        title = f"The {_MOST_PAIRS} pairs whose match rate depends most on the seed (mean ± standard deviation)"
    rows = [
        (pair_id, *(mean_and_spread(scores[name].mean, scores[name].std) for name in _SEED_SCORES))
        for pair_id, scores in chosen
    ]
    pairs = Table(title, ("pair", *labels(_SEED_SCORES)), rows)
    lines = (
        "repeatability limit (ISO 5725): two results with different seeds, of one pair or the means of all pairs,",
        "that differ by less may do so by chance alone (95 %); a simulator is better only if it is so by more",
    )
    return [dataset, *map(Note, lines), pairs]


def _pairs_table(scored: Sequence[Row], most: int) -> Table:
    title = "Pairs (means over matched objects)"
    if len(scored) > most:
        scored = sorted(scored, key=lambda row: row["match_rate"])[:most]
        title = f"The {most} pairs with the lowest match rate (means over matched objects)"
    headings = ("pair", "objects\nboth", "only\nreal", "only\nsim", *narrow_labels(HEADLINE_SCORES))
    counts = ("n_matched", "n_missing", "n_hallucinated")
    rows = [[row[column] for column in ("pair_id", *counts, *HEADLINE_SCORES)] for row in scored]
    return Table(title, headings, rows)


def dataset_table(record: RunRecord, columns: Sequence[str]) -> Table:
    """Means over pairs, number of pairs, means with unmatched objects as worst, and the paper's under its preset."""
    rows, with_paper = [], record.preset == "paper"
    for column in columns:
        metric, score = metric_of(column), record.summary[column]
        worst = record.summary.get(unmatched_worst(metric.column))
        pairs = f"{score.n_pairs} of {record.pairs.scored}"
        values = (metric.label, score.mean, score.std, pairs, worst.mean if worst else "")
        paper = ["" if metric.paper_mean is None else metric.paper_mean] * with_paper
        rows.append((*values, metric.reading or metric.meaning, *paper))
    title = "Dataset (mean and standard deviation over pairs; pairs without a match have no object scores)"
    headings = ("score", "mean", "std", "pairs", "unmatched\nas worst", "how to read it", *["paper"] * with_paper)
    return Table(title, headings, rows, words=(0, 5), wide=(6,))


def coverage_table(record: RunRecord) -> Table:
    """Share of each side's surface that the other side has, mean and deviation over pairs."""
    rows = []
    for side, words in (("real", "real points with a simulated one"), ("sim", "simulated points with a real one")):
        scores = (record.summary[f"covered_{side}_{reach}"] for reach in COVERAGE_REACHES)
        rows.append((words, *(mean_and_spread(score.mean, score.std) for score in scores)))
    headings = ("share of", *(f"within {reach_words(reach)}" for reach in COVERAGE_REACHES))
    return Table("Surface (mean and std over pairs; the rest is missing or invented)", headings, rows)


def surface_line(record: RunRecord) -> str:
    """The displacement vector of the simulated surface, and the median roughness of both: means over pairs."""
    scores = ("shift_m", "shift_x_m", "shift_y_m", "shift_z_m", "roughness_real_m", "roughness_sim_m")
    length, x, y, z, real, sim = (number(record.summary[score].mean) for score in scores)
    return (
        f"the simulated surface is displaced by x {x}, y {y}, z {z} m (mean over pairs; mean length {length} m); "
        f"its median roughness is {sim} m, that of the real one {real} m"
    )


def unmatched_lines(record: RunRecord) -> list[str]:
    """State of the unmatched objects, a line for each side that has some."""
    lines: list[str] = []
    if record.metrics is None:
        return lines
    for status, other in (("missing", "simulated"), ("hallucinated", "real")):
        states: SurfaceStates = getattr(record.metrics.unmatched, status)
        there, partly, absent = (getattr(states, name) / max(1, record.pairs.scored) for name in SURFACE_STATES)
        total, near = there + partly + absent, f"of their points have a {other} one within 0.3 m"
        if there or partly:
            lines.append(
                f"of {total:.1f} {status} objects per pair, {there:.1f} exist on the other side, partitioned "
                f"differently (over {100 * THERE:.0f} % {near}), {partly:.1f} partly, {absent:.1f} absent"
            )
        elif absent:
            lines.append(
                f"the {total:.1f} {status} objects per pair are all absent from the {other} side (at most "
                f"{100 * ABSENT:.0f} % {near})"
            )
        if states.road:
            lines.append(
                f"{states.road} of the {states.there + states.partly + states.absent} {status} objects are road that "
                f"the ground cut of the {other} side removed and that of their side kept (column road_share)"
            )
    if lines:
        lines.append(
            "missing and invented pieces are parts of a surface without a counterpart, also of matched objects"
        )
    return lines


def preset_line(record: RunRecord) -> str:
    """The preset of a run, the kind of its objects, and the settings that differ from the preset."""
    from ....schemas.settings import PRESET_OBJECTS  # takes as long to load as all else here

    differing = f", but {' '.join(record.departures)}" if record.departures else ""
    return f"preset {record.preset} ({PRESET_OBJECTS[record.preset]}){differing}"


def _findings_parts(findings: Findings) -> View:
    """Distributions, ranges, classes and four scans, as in the paper's section "Real experiments"."""
    rank, ratio = findings.rank_correlation, findings.density_ratio
    return [
        _distributions(findings),
        Note(
            f"Rank correlation of CDC and r_lambda: Spearman {number(rank.spearman, 2)}, "
            f"Kendall {number(rank.kendall, 2)} (near 0: they measure different things)"
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
    values = attrgetter("min", "q05", "q25", "median", "q75", "q95", "max", "std", "cv")
    headings = ("score", "min", "5 %", "25 %", "median", "75 %", "95 %", "max", "std", "std/mean")
    rows = [(METRIC[name].label, *values(getattr(findings.distributions, name))) for name in DISTRIBUTED]
    title = f"Objects (the {findings.n_matched} that both sides have, of all pairs together)"
    return Table(title, headings, rows)


def range_table(findings: Findings) -> Table:
    """Missing and hallucinated objects by range."""
    ranges = findings.range_m
    rows = [
        (f"{band.from_m:.0f} {'and more' if band.to_m is None else f'to {band.to_m:.0f}'}", *_unmatched(band))
        for band in ranges.bands
    ]
    title = (
        f"By range (median range of matched objects {number(ranges.median_matched, 1)} m, of unmatched ones "
        f"{number(ranges.median_unmatched, 1)} m)"
    )
    return Table(title, ("range (m)", "real", "missing", "sim", "hallucinated"), rows)


def _classes(findings: Findings) -> View:
    classes, title = findings.classes, "By class (of the real object where both sides have it)"
    if len(classes) > _MOST_CLASSES:
        title = f"The {_MOST_CLASSES} most frequent of {len(classes)} classes (of the real object where both have it)"
    rows = [
        (own.label, *_unmatched(own), own.n_matched, *(_mean_of(own, score) for score in DISTRIBUTED))
        for own in classes[:_MOST_CLASSES]
    ]
    table = Table(title, ("class", "real", "missing", "sim", "hallucinated", "both", *labels(DISTRIBUTED)), rows)
    fewer = [
        f"{own.label} {METRIC[score].label} of {own.scores[score].n}"
        for own in classes[:_MOST_CLASSES]
        for score in DISTRIBUTED
        if own.scores[score].n != own.n_matched
    ]
    return [table, *([Note(f"* some objects are too small for the score: {', '.join(fewer)}\n")] if fewer else ())]


def _mean_of(own: ClassFindings, score: str) -> str:
    """A mean of a class; with an asterisk where not all objects that both sides have are in it."""
    mean = own.scores[score]
    return number(mean.mean) + "*" * (mean.n != own.n_matched)


def _scans(findings: Findings) -> Table:
    scans = findings.scans
    kind = "evenly spaced by name (quartiles; no timestamps say that they are a minute apart)"
    if scans.apart:
        kind = "more than a minute apart (quartiles over their objects)"
    quartiles = [heading for name in _BOXES for heading in (f"{METRIC[name].label} 25 %", "50 %", "75 %")]
    values = attrgetter("pair", "timestamp_s", "cdc.n", *(f"{n}.{q}" for n in _BOXES for q in ("q25", "median", "q75")))
    headings, digits = ("pair", "time (s)", "objects", *quartiles), {1: 0, **dict.fromkeys(range(3, 9), 2)}
    return Table(f"{len(scans.scans)} scans {kind}", headings, [*map(values, scans.scans)], digits=digits)


def _unmatched(group: Unmatched) -> tuple[object, ...]:
    return (
        group.n_real,
        f"{group.n_missing} ({percent(group.missing_share)})",
        group.n_sim,
        f"{group.n_hallucinated} ({percent(group.hallucinated_share)})",
    )


def _baseline_cells(row: BaselineSummary | None) -> tuple[str, str]:
    """Mean and deviation, and seconds; empty where the baseline has no such value."""
    if row is None:
        return "", ""
    size = abs(row.mean or 0.0)
    digits = 4 if 0 < size < 0.1 else 3 if size < 100 else 0
    return mean_and_spread(row.mean, row.std, digits), "" if row.seconds is None else number(row.seconds)
