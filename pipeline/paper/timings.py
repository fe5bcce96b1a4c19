"""`fidpipe status --timings`: where the time of a pair goes, beside the paper's figures."""

from __future__ import annotations

from collections.abc import Mapping

from ...stages.paper.reported import TIMINGS
from ..report.view import Table, View


def timings_view(mean: Mapping[str, Mapping[str, float]]) -> View:
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
    paper = "Beside the paper (its scans and its machine are others)"
    headings = ("step", "counted here", "here (ms)", "paper (ms)")
    own = "Time of a pair (mean over pairs, both sides, one core)"
    return [
        Table(own, ("stage", "step", "ms"), steps, words=(0, 1), digits={2: 1}),
        Table(paper, headings, beside, words=(0, 1), digits={2: 0}),
    ]
