"""The state of a run."""

from __future__ import annotations

from ...results.status import STATES, RunStatus
from ...storage.run_record import command_again
from ...storage.urls import url_or_path
from ..view import Note, Part, View, count, first_of

_MOST_LINES = 3


def status_view(status: RunStatus) -> View:
    """Progress of a run in about ten lines: finished stages in one, then the others; failures."""
    n_pairs = count(status.n_pairs, "pair")
    title = f"{url_or_path(status.folder)}: {n_pairs} of {status.dataset}"
    parts: list[Part] = [Note(title, "bold")]
    finished = [
        name for name, counts in status.stages.items() if counts["done"] == status.n_pairs
    ]
    if finished:
        parts.append(Note(f"finished for all pairs: {', '.join(finished)}"))
    is_open = False
    for stage, counts in status.stages.items():
        is_open |= bool(counts["stale"] or counts["to do"])
        if stage not in finished:
            states = [f"{counts[state]} {state}" for state in STATES if counts[state]]
            parts.append(Note(f"{stage}: {', '.join(states)}"))
    failed = [f"failed: {pair_id}: {reason}" for pair_id, reason in status.failures.items()]
    damaged = [f"damaged or gone: {name}" for name in status.damaged]
    for line in (
        *first_of(failed, _MOST_LINES, "failed: {} more pairs, see pairs.parquet"),
        *first_of(damaged, _MOST_LINES, "damaged or gone: {} more tables"),
    ):
        parts.append(Note(line, "red"))
    if is_open or status.damaged:
        parts.append(Note(f"finish it with: {command_again(status.folder, status.dataset)}"))
    return parts
