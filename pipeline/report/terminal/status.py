"""What the terminal shows before and during a run: what would be read from a dataset, how far the run is, its time."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path

from pydantic import JsonValue
from rich.console import Group, RenderableType
from rich.text import Text

from ....schemas.columns import SIDES
from ....schemas.paper import TIMINGS
from ....schemas.results import JsonObject
from ....stages.inspect.sensor import sensor_lines
from ...engine.costs import CostModel
from ...inspect.scan_checks import DatasetCheck, ScanFacts
from ...inspect.sensor_checks import SensorCheck
from ...results.status import STATES, RunStatus
from ...storage.files import free_bytes, megabytes
from ...storage.record import command_again
from .layout import plain_table

_MOST_FAILURES = 3
RUNS = Path("runs")  #: where runs lie unless --out says otherwise


def check_json(dataset: DatasetCheck) -> JsonObject:
    """The same for programs: what was learnt of each scan by pair and side (null: it is missing), and what is wrong."""
    pairs: list[JsonValue] = [
        {"pair_id": pair.pair_id, **{side: _scan_json(sides.get(side)) for side in SIDES}}
        for pair, sides in dataset.pairs
    ]
    return {
        "dataset": str(dataset.folder),
        "pairs": pairs,
        "notes": [*dataset.notes],
        "warnings": [*dataset.warnings],
        "faults": [*dataset.faults],
        "sensors": asdict(dataset.sensors),
        "disk_bytes": _disk_bytes(dataset),
    }


def check_view(dataset: DatasetCheck) -> RenderableType:
    """The pairs of a dataset with points, extents and dropped points, then warnings and faults."""
    rows: list[tuple[object, ...]] = []
    for pair, sides in dataset.pairs:
        for side in SIDES:
            facts, name = sides.get(side), pair.pair_id if side == "real" else ""
            if facts is None or facts.fault:
                rows.append((name, side, None, None, "", Text("cannot be used" if facts else "missing", style="red")))
                continue
            extent = "  ".join(f"{high - low:.1f}" for low, high in zip(facts.low, facts.high, strict=True))
            dropped = ", ".join(f"{n} {reason.replace('_', ' ')}" for reason, n in facts.dropped.items() if n)
            rows.append((name, side, facts.n_raw, facts.n_clean, extent, dropped or "none"))
    columns = ("pair", "side", "points", "clean", "extent x y z (m)", "dropped")
    n_faulty = len({text.split(":")[0] for text in dataset.faults})
    verdict = f"{len(dataset.pairs) - n_faulty} of {len(dataset.pairs)} pairs can be evaluated"
    return Group(
        plain_table(f"{dataset.folder}: {len(dataset.pairs)} pairs", columns, rows, words=(0, 1, 4, 5)),
        *_sensor_lines(dataset.sensors),
        *map(Text, dataset.notes),
        *(Text(f"warning: {text}", style="yellow") for text in dataset.warnings),
        *(Text(f"fault: {text}", style="red") for text in dataset.faults),
        _space_needed(_disk_bytes(dataset)),
        Text(verdict, style="red" if dataset.faults else "green"),
    )


def status_view(status: RunStatus, *, with_timings: bool = False) -> RenderableType:
    """How far a run is in about ten lines: stages that all pairs have in one, the others one by one; failed pairs.

    Parameters
    ----------
    with_timings : where the time of a pair goes as well, beside the paper's
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
    return Group(
        Text(f"{status.folder}: {status.n_pairs} pairs of {status.dataset}", style="bold"),
        *map(Text, lines),
        *(Text(line, style="red") for line in failed),
        *(_timing_tables(status.mean_seconds) if with_timings and status.mean_seconds else ()),
        *([Text(f"finish it with: {command_again(status.folder, status.dataset)}")] if is_open else ()),
    )


def _sensor_lines(sensors: SensorCheck) -> list[Text]:
    """Sensors of both sides, their differences, and scans of other sensors."""
    names = {"real": "real sensor", "sim": "simulated sensor"}
    n_pairs = len(sensors.pair_ids)
    pairs = f"pair{'s' * (n_pairs > 1)} {', '.join(sensors.pair_ids)}" if n_pairs < 4 else f"{n_pairs} pairs"
    lines = [Text(f"Sensors (estimated from {pairs})", style="bold")] if sensors.sides else []
    for side, facts in sensors.sides.items():
        lines += [Text(names[side]), *(Text(f"  {line}") for line in sensor_lines(facts))]
    lines += [Text(f"differs: {text}", style="yellow") for text in sensors.differences]
    return [*lines, *(Text(f"warning: {text}", style="yellow") for text in sensors.unlike)]


def _scan_json(facts: ScanFacts | None) -> JsonObject | None:
    if facts is None:
        return None
    names = ("n_raw", "n_clean", "dropped", "low", "high", "azimuth_gap_deg", "fault")
    return {name: getattr(facts, name) for name in names}


def _disk_bytes(dataset: DatasetCheck) -> int:
    """What the tables of a run may take."""
    return CostModel().disk_bytes(sum(facts.n_raw for _, sides in dataset.pairs for facts in sides.values()))


def _space_needed(need: int) -> Text:
    """What the tables of a run may take, and what is free where runs lie by default."""
    free = free_bytes(RUNS)
    text = f"a run needs about {megabytes(need)} on disk"
    if free is not None and need > free:
        return Text(f"warning: {text}; {megabytes(free)} are free here, give it another --out", style="yellow")
    return Text(text if free is None else f"{text}; {megabytes(free)} are free here")


def _timing_tables(mean: Mapping[str, Mapping[str, float]]) -> tuple[RenderableType, RenderableType]:
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
    own_title = "Time of a pair (mean over pairs, both sides, one core)"
    paper_title = "Beside the paper (its scans and its machine are others)"
    return (
        plain_table(own_title, ("stage", "step", "ms"), steps, words=(0, 1), digits={2: 1}),
        plain_table(
            paper_title, ("step", "counted here", "here (ms)", "paper (ms)"), beside, words=(0, 1), digits={2: 0}
        ),
    )
