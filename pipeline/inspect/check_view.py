"""Views of a dataset check: what would be read, and what is wrong with it."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path

from pydantic import JsonValue

from ...schemas.columns import SIDES
from ...schemas.results import JsonObject
from ...stages.sensor_description import sensor_lines
from ..engine.costs import CostModel
from ..report.view import Answers, Note, Table, View
from ..report.views.answer_view import NO_CAUSE, cause_items
from ..results.causes import MOST_SHOWN
from ..storage.files import free_bytes, megabytes
from .cause_checks import CauseCheck
from .scan_checks import DatasetCheck
from .side_checks import SensorCheck

RUNS = Path("runs")  #: where runs lie unless --out says otherwise


def check_json(dataset: DatasetCheck) -> JsonObject:
    """The same for programs: inspection of each scan by pair and side (null if it is missing), and problems."""
    pairs: list[JsonValue] = [
        {"pair_id": own.pair.pair_id}
        | {side: own.sides[side].as_dict() if side in own.sides else None for side in SIDES}
        for own in dataset.pairs
    ]
    return {
        "dataset": str(dataset.folder),
        "pairs": pairs,
        "notes": [*dataset.notes],
        "doubts": [*dataset.doubts],
        "warnings": [*dataset.warnings],
        "faults": [*dataset.faults],
        "sensors": asdict(dataset.sensors),
        "causes": {
            "pair_ids": [*dataset.causes.pair_ids],
            "causes": [cause.as_dict() for cause in dataset.causes.causes],
        },
        "disk_bytes": _disk_bytes(dataset),
    }


def check_view(dataset: DatasetCheck, run_command: str = "") -> View:
    """The pairs of a dataset with points, extents and dropped points, then warnings, errors and the next command."""
    rows: list[tuple[object, ...]] = []
    for own in dataset.pairs:
        for side in SIDES:
            facts, name = own.sides.get(side), own.pair.pair_id if side == "real" else ""
            if facts is None or facts.fault:
                rows.append((name, side, None, None, "", "cannot be used" if facts else "missing"))
                continue
            extent = "  ".join(f"{high - low:.1f}" for low, high in zip(facts.low, facts.high, strict=True))
            dropped = ", ".join(f"{n} {reason.replace('_', ' ')}" for reason, n in facts.dropped.items() if n)
            rows.append((name, side, facts.n_raw, facts.n_clean, extent, dropped or "none"))
    columns = ("pair", "side", "points", "clean", "extent x y z (m)", "dropped")
    n_usable = len(dataset.pairs) - len({text.split(":")[0] for text in dataset.faults})
    verdict = f"{n_usable} of {len(dataset.pairs)} pairs can be evaluated"
    return [
        Table(f"{dataset.folder}: {len(dataset.pairs)} pairs", columns, rows, words=(0, 1, 4, 5)),
        *(Note(f"error: {text}", "red") for text in dataset.doubts),
        *_sensor_lines(dataset.sensors),
        *_causes(dataset.causes),
        *map(Note, dataset.notes),
        *(Note(f"warning: {text}", "yellow") for text in dataset.warnings),
        *(Note(f"error: {text}", "red") for text in dataset.faults),
        _space_needed(_disk_bytes(dataset)),
        Note(verdict, "red" if dataset.faults else "green"),
        *([Note(f"next: {run_command}")] if run_command and n_usable else ()),
    ]


def _sensor_lines(sensors: SensorCheck) -> list[Note]:
    """Sensors of both sides, and scans of other sensors."""
    names = {"real": "real sensor", "sim": "simulated sensor"}
    n_pairs = len(sensors.pair_ids)
    pairs = f"pair{'s' * (n_pairs > 1)} {', '.join(sensors.pair_ids)}" if n_pairs < 4 else f"{n_pairs} pairs"
    lines = [Note(f"Sensors (estimated from {pairs})", "bold")] if sensors.sides else []
    for side, facts in sensors.sides.items():
        lines += [Note(names[side]), *(Note(f"  {line}") for line in sensor_lines(facts))]
    return [*lines, *(Note(f"warning: {text}", "yellow") for text in sensors.unlike)]


def _causes(check: CauseCheck) -> View:
    """The causes that a few pairs show."""
    n_pairs = len(check.pair_ids)
    if not n_pairs:
        return []
    heading = Note(f"Seen in {n_pairs} pair{'s' if n_pairs > 1 else ''}", "bold")
    items = cause_items(check.causes[:MOST_SHOWN]) or [(NO_CAUSE, "", "")]
    return [heading, Answers([("Fix first", items)])]


def _disk_bytes(dataset: DatasetCheck) -> int:
    """Disk space that the tables of a run may take."""
    return CostModel().disk_bytes(sum(facts.n_raw for own in dataset.pairs for facts in own.sides.values()))


def _space_needed(need: int) -> Note:
    """Disk space that the tables of a run may take, and free space in the default folder of runs."""
    free = free_bytes(RUNS)
    text = f"a run needs about {megabytes(need)} on disk"
    if free is not None and need > free:
        return Note(f"warning: {text}; {megabytes(free)} are free here, give it another --out", "yellow")
    return Note(text if free is None else f"{text}; {megabytes(free)} are free here")
