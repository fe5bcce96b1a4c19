"""What the distances of others say, and what each costs."""

from __future__ import annotations

from collections.abc import Sequence

from rich.console import Group, RenderableType
from rich.text import Text

from ....schemas.metrics import METRIC, unit_words
from ....schemas.results import BaselineSummary
from ...jobs.baselines import OF_OBJECTS, OF_SCAN
from .layout import number, plain_table


def baselines_view(rows: Sequence[BaselineSummary]) -> RenderableType:
    """Mean and deviation over pairs of each baseline, of matched objects and of whole scans, and seconds per pair."""
    by_name = {(row.baseline, row.level): row for row in rows}
    columns = ("baseline", "unit", "objects", "s", "whole scans", "s")
    table = plain_table("Baselines (mean and standard deviation over pairs)", *columns, words=2)
    for name in dict.fromkeys(row.baseline for row in rows):
        metric = METRIC[name]
        values = (*_cells(by_name.get((name, OF_OBJECTS))), *_cells(by_name.get((name, OF_SCAN))))
        table.add_row(Text(metric.heading, no_wrap=True), unit_words(metric.unit), *values)
    total_s = sum(row.seconds or 0.0 for row in rows)
    lines = [
        "A pair counts with the mean over its matched objects, or with all object points of its two scans.",
        f"s: seconds per pair, beside the first number of a method; all together {total_s:.1f}",
        *(f"{row.baseline} is null for {row.n_null} of {row.n + row.n_null} {row.level}" for row in rows if row.n_null),
    ]
    return Group(table, *map(Text, lines))


def _cells(row: BaselineSummary | None) -> tuple[str, str]:
    """Mean and deviation, and seconds; empty where the baseline has no such value."""
    if row is None:
        return "", ""
    size = abs(row.mean or 0.0)
    digits = 4 if 0 < size < 0.1 else 3 if size < 100 else 0
    value = f"{number(row.mean, digits)} ± {number(row.std, digits)}"
    return value, "" if row.seconds is None else number(row.seconds)
