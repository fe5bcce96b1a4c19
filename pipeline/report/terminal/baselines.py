"""What the distances of others say, and what each costs."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from rich.console import Group, RenderableType
from rich.text import Text

from ...jobs.baselines import OF_OBJECTS, OF_SCAN
from .layout import number, plain_table


def baselines_view(summary: Iterable[Mapping[str, Any]]) -> RenderableType:
    """Mean and deviation over pairs of each baseline, of matched objects and of whole scans, and seconds a pair."""
    rows = list(summary)
    found = {(row["baseline"], row["level"]): row for row in rows}
    columns = ("baseline", "unit", "objects", "s", "whole scans", "s")
    table = plain_table("Baselines (mean and standard deviation over pairs)", *columns, words=2)
    for name in dict.fromkeys(row["baseline"] for row in rows):
        of_objects, of_scan = found.get((name, OF_OBJECTS)), found.get((name, OF_SCAN))
        unit = next(row["unit"] for row in (of_objects, of_scan) if row is not None)
        table.add_row(
            Text(name, no_wrap=True),
            {"m2": "m²", None: ""}.get(unit, unit),
            *_cells(of_objects),
            *_cells(of_scan),
        )
    nulls = [row for row in rows if row["n_null"]]
    total_s = sum(row["seconds"] or 0.0 for row in rows)
    lines = [
        "A pair counts with the mean over its matched objects, or with all object points of its two scans.",
        f"s: seconds a pair, beside the first number of a method; all together {total_s:.1f}",
        *(
            f"{row['baseline']} is null for {row['n_null']} of {row['n'] + row['n_null']} {row['level']}"
            for row in nulls
        ),
    ]
    return Group(table, *map(Text, lines))


def _cells(row: Mapping[str, Any] | None) -> tuple[str, str]:
    """Mean and deviation, and seconds; empty where the baseline has no such value."""
    if row is None:
        return "", ""
    size = abs(row["mean"] or 0.0)
    digits = 4 if 0 < size < 0.1 else 3 if size < 100 else 0
    value = f"{number(row['mean'], digits)} ± {number(row['std'], digits)}"
    return value, "" if row["seconds"] is None else number(row["seconds"])
