"""Views of a dataset check: what would be read, and what is wrong with it."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
from pydantic_core import to_jsonable_python

from ...schemas.columns import SIDE_NAMES, SIDES
from ...stages.sensor_description import sensor_lines
from ..report.view import Answers, Note, Part, Table, View, count, items_of
from ..report.views.answer_view import cause_items, unknown_words
from ..results.causes import MOST_SHOWN, no_cause_words
from .scan_checks import DatasetCheck


def check_json(dataset: DatasetCheck) -> Any:
    """The same for programs: inspection of each scan by pair and side (null if it is missing), and problems."""
    pairs = [
        {"pair_id": check.pair.pair_id, **dict.fromkeys(SIDES), **check.sides}
        for check in dataset.pairs
    ]
    values = vars(dataset) | {"pairs": pairs}
    values["dataset"] = values.pop("folder")
    return to_jsonable_python(values)


def check_view(dataset: DatasetCheck, run_command: str = "") -> View:
    """The pairs of a dataset with points, extents and dropped points, then warnings, errors and the next command."""
    n_pairs = len(dataset.pairs)
    n_usable = sum(not check.faults for check in dataset.pairs)
    view: list[Part] = [_pair_table(dataset), *_notes("error: ", dataset.doubts, "red")]
    view += _sensor_lines(dataset)
    view += _causes(dataset)
    view += _notes("", dataset.notes)
    view += _notes("warning: ", dataset.warnings, "yellow")
    view += _notes("error: ", dataset.faults, "red")
    view.append(
        Note(
            f"{n_usable} of {n_pairs} pairs can be evaluated",
            "red" if dataset.faults else "green",
        ),
    )
    if dataset.doubts or any(check.frames and check.frames.doubt for check in dataset.pairs):
        view.append(Note("next: fix what is named above, then check again"))
    elif run_command and n_usable:
        view.append(Note(f"next: {run_command}"))
    return view


def _pair_table(dataset: DatasetCheck) -> Table:
    """One row per scan: points, extents and dropped points."""
    rows: list[tuple[object, ...]] = []
    for check in dataset.pairs:
        for side in SIDES:
            name = check.pair.pair_id if side == "real" else ""
            scan = check.sides.get(side)
            if scan is None or scan.fault:
                rows.append(
                    (name, side, None, None, "", "cannot be used" if scan else "missing")
                )
                continue
            extent = "  ".join(f"{size:.1f}" for size in np.subtract(scan.high, scan.low))
            dropped = ", ".join(
                f"{n} {reason.replace('_', ' ')}" for reason, n in scan.dropped.items() if n
            )
            rows.append((name, side, scan.n_raw, scan.n_clean, extent, dropped or "none"))
    columns = ("pair", "side", "points", "clean", "extent x y z (m)", "dropped")
    return Table(
        f"{dataset.folder}: {count(len(dataset.pairs), 'pair')}",
        columns,
        rows,
        words=(0, 1, 4, 5),
    )


def _notes(prefix: str, texts: Iterable[str], style: str = "") -> list[Note]:
    return [Note(f"{prefix}{text}", style) for text in texts]


def _sensor_lines(dataset: DatasetCheck) -> list[Note]:
    """Sensors of both sides."""
    lines = []
    if dataset.sensors:
        n_pairs = sum(bool(check.samples) for check in dataset.pairs)
        lines.append(Note(f"Sensors (estimated from {count(n_pairs, 'pair')})", "bold"))
    for side, sensor in dataset.sensors.items():
        lines.append(Note(f"{SIDE_NAMES[side]} sensor"))
        lines += _notes("  ", sensor_lines(sensor))
    return lines


def _causes(dataset: DatasetCheck) -> View:
    """The causes that a few pairs show."""
    n_pairs = sum(bool(check.causes) for check in dataset.pairs)
    if not n_pairs:
        return []
    heading = Note(f"Seen in {count(n_pairs, 'pair')}", "bold")
    items = cause_items(dataset.causes[:MOST_SHOWN]) or items_of(
        no_cause_words(dataset.unknown)
    )
    trust = items_of(*unknown_words(dataset.unknown))
    return [heading, Answers({"Fix first": items, "Trust": trust})]
