"""What the terminal shows of a dataset: what would be read from it, and what is wrong with it."""

from __future__ import annotations

from rich.console import Group, RenderableType
from rich.text import Text

from ....schemas.columns import SIDES
from ...datasets.scan_checks import DatasetCheck
from .layout import plain_table


def check_view(dataset: DatasetCheck) -> RenderableType:
    """The pairs of a dataset with points, extents and dropped points, then warnings and faults."""
    table = plain_table(f"{dataset.folder}: {len(dataset.pairs)} pairs")
    for heading in ("pair", "side", "points", "clean", "extent x y z (m)", "dropped"):
        table.add_column(heading, justify="right" if heading in ("points", "clean") else "left", overflow="fold")
    for pair, sides in dataset.pairs:
        for side in SIDES:
            facts = sides.get(side)
            name = Text(pair.pair_id if side == "real" else "")
            if facts is None or facts.fault:
                table.add_row(name, side, "-", "-", "", Text("cannot be used" if facts else "missing", style="red"))
                continue
            extent = "  ".join(f"{high - low:.1f}" for low, high in zip(facts.low, facts.high, strict=True))
            dropped = ", ".join(f"{n} {reason.replace('_', ' ')}" for reason, n in facts.dropped.items() if n)
            table.add_row(name, side, f"{facts.n_raw}", f"{facts.n_clean}", extent, dropped or "none")
    lines = [Text(f"warning: {text}", style="yellow") for text in dataset.warnings]
    lines += [Text(f"fault: {text}", style="red") for text in dataset.faults]
    n_faulty = len({text.split(":")[0] for text in dataset.faults})
    verdict = f"{len(dataset.pairs) - n_faulty} of {len(dataset.pairs)} pairs can be evaluated"
    return Group(table, *lines, Text(verdict, style="red" if dataset.faults else "green"))
