"""`fidpipe status --timings`: time of each step of a pair, next to the paper's figures."""

from __future__ import annotations

from collections.abc import Mapping

from ...schemas.data_files import read_data
from ..report.view import Table, View


def timings_view(mean: Mapping[str, Mapping[str, float]]) -> View:
    """Mean milliseconds per pair by stage and step, in the order of the run; then the steps that the paper reports."""
    steps = [
        (stage if i == 0 else "", step, 1e3 * seconds)
        for stage, own in mean.items()
        for i, (step, seconds) in enumerate(own.items())
    ]
    rows = []
    for timing in read_data("paper")["timings"]:
        counted = timing["steps"]
        seconds = sum(v for stage, step in counted for name, v in mean.get(stage, {}).items() if step in ("", name))
        text = timing.get("text", ", ".join(f"{stage} {step}" for stage, step in counted))
        rows.append((timing["name"], text, 1e3 * seconds, timing["milliseconds"]))
    headings = ("step", "counted here", "here (ms)", "paper (ms)")
    title = "Time per pair (mean over pairs, both sides, one core)"
    return [
        Table(title, ("stage", "step", "ms"), steps, words=(0, 1), digits={2: 1}),
        Table("Compared with the paper (other scans, another machine)", headings, rows, words=(0, 1), digits={2: 0}),
    ]
