"""What the terminal shows of a run at its end: its pairs, its scores, its findings; printed by the command alone."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from ....schemas.columns import Row
from ....schemas.metrics import HEADLINE_SCORES, metric_of, narrow_labels
from ....schemas.results import RunRecord, ScoreSummary
from ...run import RunOutcome
from .baselines import baselines_view
from .findings import claims_line, findings_view
from .layout import number, plain_table
from .seeds import seeds_view

_MOST_PAIRS = 20


def outcome_view(outcome: RunOutcome) -> RenderableType:
    """The results of a run, as a newcomer should see them first."""
    record = outcome.record
    return Group(
        summary_view(outcome.folder, outcome.rows, record),
        Text(f"{outcome.n_made} jobs done, {outcome.n_reused} reused, in {record.wall_s['total']:.1f} s"),
        Text(
            f"results: {outcome.folder}/pairs.parquet (one row per pair), "
            f"{outcome.folder}/metrics/ (one row per object)"
        ),
        Text(f"to look at them: fidpipe report {outcome.folder}"),
    )


def summary_view(folder: Path, rows: Sequence[Row], record: RunRecord) -> RenderableType:
    """The pairs of a run, what they say together, and which failed."""
    scored = [row for row in rows if row["status"] == "scored"]
    parts: list[RenderableType] = []
    if record.findings:
        findings = record.findings
        parts += [_pairs_table(scored), _dataset_table(record.summary), findings_view(findings)]
        parts.append(Text(f"{claims_line(findings)}; see: fidpipe show {folder} --paper"))
    if record.baselines:
        parts.append(baselines_view(record.baselines))
    if record.seeds:
        parts.append(seeds_view(record.seeds))
    failures = [row for row in rows if row["status"] == "failed"]
    if failures:
        parts.append(Text(f"{len(failures)} of {len(rows)} pairs failed:", style="red"))
        parts += [Text(f"  {row['pair_id']}: {row['reason']}") for row in failures[:_MOST_PAIRS]]
        if len(failures) > _MOST_PAIRS:
            parts.append(Text(f"  and {len(failures) - _MOST_PAIRS} more, see pairs.parquet"))
    return Group(*parts)


def _pairs_table(rows: Sequence[Row]) -> Table:
    title = "Pairs (means over matched objects)"
    if len(rows) > _MOST_PAIRS:
        rows = sorted(rows, key=lambda row: row["match_rate"])[:_MOST_PAIRS]
        title = f"The {_MOST_PAIRS} pairs with the lowest match rate (means over matched objects)"
    table = plain_table(title)
    table.add_column("pair", overflow="fold", min_width=6)
    for heading in ("objects\nreal", "\nsim", "\nboth", "only\nreal", "only\nsim"):
        table.add_column(heading, justify="right")
    for heading in narrow_labels(HEADLINE_SCORES):
        table.add_column(heading, justify="right", no_wrap=True)
    for row in rows:
        counts = ("n_communities_real", "n_communities_sim", "n_matched", "n_missing", "n_hallucinated")
        table.add_row(
            Text(row["pair_id"]),
            *(str(row[name]) for name in counts),
            *(number(row[column]) for column in HEADLINE_SCORES),
        )
    return table


def _dataset_table(summary: Mapping[str, ScoreSummary]) -> Table:
    table = plain_table("Dataset (mean and standard deviation over pairs)")
    table.add_column("score", no_wrap=True)
    table.add_column("mean", justify="right", no_wrap=True)
    table.add_column("std", justify="right", no_wrap=True)
    table.add_column("how to read it")
    for column in HEADLINE_SCORES:
        metric, score = metric_of(column), summary[column]
        table.add_row(metric.label, number(score.mean), number(score.std), metric.reading)
    return table
