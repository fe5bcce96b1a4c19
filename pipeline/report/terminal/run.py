"""What the terminal shows of a dataset and of a run: rich renderables, printed by the command alone."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from ....schemas.columns import SIDES, Row
from ....schemas.metrics import HEADLINE_SCORES, metric_of
from ....schemas.results import RunRecord, ScoreSummary
from ...datasets.check import DatasetCheck
from ...engine.request import RunOutcome
from ...results.status import STATES, RunStatus
from .baselines import baselines_view
from .findings import claims_line, findings_view
from .layout import narrow, number, plain_table
from .seeds import seeds_view
from .timings import timing_view

_MOST_PAIRS = 20


def outcome_view(outcome: RunOutcome) -> RenderableType:
    """The results of a run, as a newcomer should see them first."""
    record = RunRecord.from_dict(outcome.record)
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


def check_view(found: DatasetCheck) -> RenderableType:
    """The pairs of a dataset with points, extents and dropped points, then warnings and faults."""
    table = plain_table(f"{found.folder}: {len(found.pairs)} pairs")
    for heading in ("pair", "side", "points", "clean", "extent x y z (m)", "dropped"):
        table.add_column(heading, justify="right" if heading in ("points", "clean") else "left", overflow="fold")
    for pair, sides in found.pairs:
        for side in SIDES:
            facts = sides.get(side)
            name = Text(pair.pair_id if side == "real" else "")
            if facts is None or facts.fault:
                table.add_row(name, side, "-", "-", "", Text("cannot be used" if facts else "missing", style="red"))
                continue
            extent = "  ".join(f"{high - low:.1f}" for low, high in zip(facts.low, facts.high, strict=True))
            dropped = ", ".join(f"{n} {reason.replace('_', ' ')}" for reason, n in facts.dropped.items() if n)
            table.add_row(name, side, f"{facts.n_raw}", f"{facts.n_clean}", extent, dropped or "none")
    lines = [Text(f"warning: {text}", style="yellow") for text in found.warnings]
    lines += [Text(f"fault: {text}", style="red") for text in found.faults]
    n_faulty = len({text.split(":")[0] for text in found.faults})
    verdict = f"{len(found.pairs) - n_faulty} of {len(found.pairs)} pairs can be evaluated"
    return Group(table, *lines, Text(verdict, style="red" if found.faults else "green"))


def status_view(status: RunStatus) -> RenderableType:
    """Stages by pairs."""
    table = plain_table(f"{status.folder}: {status.n_pairs} pairs of {status.dataset}")
    table.add_column("stage")
    for state in STATES:
        table.add_column(state, justify="right")
    for stage, counts in status.stages.items():
        table.add_row(stage, *(str(counts[state]) if counts[state] else "-" for state in STATES))
    failures = [Text(f"failed: {pair_id}: {reason}", style="red") for pair_id, reason in status.failures.items()]
    return Group(table, *([timing_view(status.mean_seconds)] if status.mean_seconds else []), *failures)


def _pairs_table(rows: Sequence[Row]) -> Table:
    title = "Pairs (means over matched objects)"
    if len(rows) > _MOST_PAIRS:
        rows = sorted(rows, key=lambda row: row["match_rate"])[:_MOST_PAIRS]
        title = f"The {_MOST_PAIRS} pairs with the lowest match rate (means over matched objects)"
    table = plain_table(title)
    table.add_column("pair", overflow="fold", min_width=6)
    for heading in ("objects\nreal", "\nsim", "\nboth", "only\nreal", "only\nsim"):
        table.add_column(heading, justify="right")
    for heading in narrow(HEADLINE_SCORES):
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
