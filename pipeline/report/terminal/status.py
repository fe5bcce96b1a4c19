"""How far a run is in the terminal: stages by pairs, and where the time goes beside the paper's figures."""

from __future__ import annotations

from collections.abc import Mapping

from rich.console import Group, RenderableType
from rich.text import Text

from ....schemas.paper import TIMINGS
from ...results.status import STATES, RunStatus
from .layout import number, plain_table


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


def timing_view(mean: Mapping[str, Mapping[str, float]]) -> RenderableType:
    """Mean milliseconds per pair by stage and step, in the order of the run; then what the paper has figures for."""
    steps = plain_table("Time of a pair (mean over pairs, both sides, one core)", "stage", "step", "ms", words=2)
    for stage, own in mean.items():
        for i, (step, seconds) in enumerate(own.items()):
            steps.add_row(stage if i == 0 else "", step, number(1e3 * seconds, 1))
    beside = plain_table(
        "Beside the paper (its scans and its machine are others)",
        *("step", "counted here", "here (ms)", "paper (ms)"),
        words=2,
    )
    for timing in TIMINGS:
        seconds = sum(
            value for stage, step in timing.steps for name, value in mean.get(stage, {}).items() if step in ("", name)
        )
        words = timing.words or ", ".join(f"{stage} {step}" for stage, step in timing.steps)
        beside.add_row(timing.name, words, number(1e3 * seconds, 0), str(timing.milliseconds))
    return Group(steps, beside)
