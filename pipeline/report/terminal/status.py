"""What the terminal shows before and during a run: what would be read from a dataset, how far the run is, its time."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from rich.console import Group, RenderableType
from rich.text import Text

from ....schemas.columns import SIDES
from ....schemas.paper import TIMINGS
from ....stages.sensing.sensor import sensor_lines
from ...datasets.scan_checks import DatasetCheck
from ...datasets.sensor_checks import SensorCheck
from ...engine.costs import CostModel
from ...results.status import STATES, RunStatus
from ...storage.files import free_bytes, megabytes
from ...storage.record import command_again
from .layout import plain_table

RUNS = Path("runs")  #: where runs lie unless --out says otherwise


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
        *(Text(f"warning: {text}", style="yellow") for text in dataset.warnings),
        *(Text(f"fault: {text}", style="red") for text in dataset.faults),
        _space_needed(sum(facts.n_raw for _, sides in dataset.pairs for facts in sides.values())),
        Text(verdict, style="red" if dataset.faults else "green"),
    )


def status_view(status: RunStatus) -> RenderableType:
    """Stages by pairs, where the time goes, and why pairs failed."""
    is_open = any(counts["stale"] or counts["to do"] for counts in status.stages.values())
    rows = ((stage, *(counts[state] or None for state in STATES)) for stage, counts in status.stages.items())
    return Group(
        plain_table(f"{status.folder}: {status.n_pairs} pairs of {status.dataset}", ("stage", *STATES), rows),
        *(_timing_tables(status.mean_seconds) if status.mean_seconds else ()),
        *(Text(f"failed: {pair_id}: {reason}", style="red") for pair_id, reason in status.failures.items()),
        *([Text(f"finish it with: {command_again(status.folder, status.dataset)}")] if is_open else ()),
    )


def _sensor_lines(sensors: SensorCheck) -> list[Text]:
    """What sensors the sides are from, and in what they differ."""
    names = {"real": "real sensor", "sim": "simulated sensor"}
    lines = [Text(f"Sensors, as pairs {', '.join(sensors.pair_ids)} tell", style="bold")] if sensors.sides else []
    for side, facts in sensors.sides.items():
        lines += [Text(names[side]), *(Text(f"  {line}") for line in sensor_lines(facts))]
    return [*lines, *(Text(f"differs: {text}", style="yellow") for text in sensors.differences)]


def _space_needed(n_raw: int) -> Text:
    """What the tables of a run may take, and what is free where runs lie by default."""
    need, free = CostModel().disk_bytes(n_raw), free_bytes(RUNS)
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
