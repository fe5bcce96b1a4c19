"""Where the time of a pair goes, step by step, beside the paper's figures."""

from __future__ import annotations

from collections.abc import Mapping

from rich.console import Group, RenderableType

from .layout import number, plain_table

#: The paper's section "Pipeline Timing": its step, its milliseconds, and which of our steps do that work.
PAPER_MS: tuple[tuple[str, int, tuple[tuple[str, str], ...]], ...] = (
    ("community detection", 544, (("communities", "louvain"),)),
    ("Laplacians", 596, (("selection", "subgraphs"), ("selection", "laplacian"), ("metrics", "laplacian"))),
    ("heat kernel", 1505, (("selection", "heat"),)),
    ("alignment", 1532, (("selection", "alignment"),)),
)
PAPER_ALL_MS = 7120
#: The stages that the paper has too; further scores are not part of its total.
STAGES = ("ground", "graph", "communities", "matching", "selection", "metrics")


def timing_view(mean: Mapping[str, Mapping[str, float]]) -> RenderableType:
    """Mean milliseconds a pair by stage and step, and the sums that the paper has figures for."""
    steps = plain_table("Time of a pair (mean over pairs, both sides, one core)", "stage", "step", "ms", words=2)
    for stage, of_stage in mean.items():
        for i, (step, seconds) in enumerate(of_stage.items()):
            steps.add_row(stage if i == 0 else "", step, number(1e3 * seconds, 1))
    beside = plain_table(
        "Beside the paper (its scans and its machine are others)",
        "step",
        "counted here",
        "here, ms",
        "paper, ms",
        words=2,
    )
    for name, paper_ms, counted in PAPER_MS:
        seconds = sum(mean.get(stage, {}).get(step, 0.0) for stage, step in counted)
        words = ", ".join(f"{stage} {step}" for stage, step in counted)
        beside.add_row(name, words, number(1e3 * seconds, 0), f"{paper_ms}")
    total = sum(seconds for stage in STAGES for seconds in mean.get(stage, {}).values())
    beside.add_row("all", "every step of ground to metrics", number(1e3 * total, 0), f"{PAPER_ALL_MS}")
    return Group(steps, beside)
