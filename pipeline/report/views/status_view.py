"""The state of a run: how far it is, and where the time goes."""

from __future__ import annotations

from collections.abc import Mapping

from ....schemas.paper import TIMINGS
from ...results.status import STATES, RunStatus
from ...storage.record import command_again
from ..view import Note, Table, View

_MOST_FAILURES = 3


def status_view(status: RunStatus, *, with_timings: bool = False) -> View:
    """How far a run is in about ten lines: stages that all pairs have in one, the others one by one; failed pairs.

    Parameters
    ----------
    with_timings : also the time of a pair by step, next to the paper's
    """
    is_open = any(counts["stale"] or counts["to do"] for counts in status.stages.values())
    finished = [stage for stage, counts in status.stages.items() if counts["done"] == status.n_pairs]
    lines = [f"done of all pairs: {', '.join(finished)}"] if finished else []
    for stage, counts in status.stages.items():
        if stage not in finished:
            lines.append(f"{stage}: " + ", ".join(f"{counts[state]} {state}" for state in STATES if counts[state]))
    failed = [f"failed: {pair_id}: {reason}" for pair_id, reason in status.failures.items()]
    if len(failed) > _MOST_FAILURES:
        failed[_MOST_FAILURES:] = [f"failed: {len(failed) - _MOST_FAILURES} more pairs, see pairs.parquet"]
    return [
        Note(f"{status.folder}: {status.n_pairs} pairs of {status.dataset}", "bold"),
        *map(Note, lines),
        *(Note(line, "red") for line in failed),
        *(_timing_tables(status.mean_seconds) if with_timings and status.mean_seconds else ()),
        *([Note(f"finish it with: {command_again(status.folder, status.dataset)}")] if is_open else ()),
    ]


def _timing_tables(mean: Mapping[str, Mapping[str, float]]) -> View:
    """Mean milliseconds per pair by stage and step, in the order of the run; then what the paper has figures for."""
    steps = [
        (stage if i == 0 else "", step, 1e3 * seconds)
        for stage, own in mean.items()
        for i, (step, seconds) in enumerate(own.items())
    ]
    beside = []
    for timing in TIMINGS:
        seconds = sum(
            value for stage, step in timing.steps for name, value in mean.get(stage, {}).items() if step in ("", name)
        )
        words = timing.words or ", ".join(f"{stage} {step}" for stage, step in timing.steps)
        beside.append((timing.name, words, 1e3 * seconds, timing.milliseconds))
    paper = "Beside the paper (its scans and its machine are others)"
    headings = ("step", "counted here", "here (ms)", "paper (ms)")
    own = "Time of a pair (mean over pairs, both sides, one core)"
    return [
        Table(own, ("stage", "step", "ms"), steps, words=(0, 1), digits={2: 1}),
        Table(paper, headings, beside, words=(0, 1), digits={2: 0}),
    ]
