"""The state of a run."""

from __future__ import annotations

from ...results.status import STATES, RunStatus
from ...storage.run_record import command_again
from ...storage.urls import url_or_path
from ..view import Note, View

_MOST_LINES = 3


def status_view(status: RunStatus) -> View:
    """Progress of a run in about ten lines: finished stages in one, then the others; failures."""
    is_open = any(counts["stale"] or counts["to do"] for counts in status.stages.values())
    finished = [stage for stage, counts in status.stages.items() if counts["done"] == status.n_pairs]
    lines = [f"done of all pairs: {', '.join(finished)}"] if finished else []
    for stage, counts in status.stages.items():
        if stage not in finished:
            lines.append(f"{stage}: " + ", ".join(f"{counts[state]} {state}" for state in STATES if counts[state]))
    failed = [f"failed: {pair_id}: {reason}" for pair_id, reason in status.failures.items()]
    if len(failed) > _MOST_LINES:
        failed[_MOST_LINES:] = [f"failed: {len(failed) - _MOST_LINES} more pairs, see pairs.parquet"]
    damaged = [f"damaged or gone: {name}" for name in status.damaged]
    if len(damaged) > _MOST_LINES:
        damaged[_MOST_LINES:] = [f"damaged or gone: {len(damaged) - _MOST_LINES} more tables"]
    return [
        Note(f"{url_or_path(status.folder)}: {status.n_pairs} pairs of {status.dataset}", "bold"),
        *map(Note, lines),
        *(Note(line, "red") for line in [*failed, *damaged]),
        *(
            [Note(f"finish it with: {command_again(status.folder, status.dataset)}")]
            if is_open or status.damaged
            else ()
        ),
    ]
