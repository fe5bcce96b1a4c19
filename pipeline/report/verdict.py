"""What a run says in a sentence, in six numbers, and where the simulation is weakest."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import pandas as pd

from ...schemas.metrics import metric_of
from ..results.overview import run_overview, verdict_sentence
from ..results.quadrants import CDC_LIMIT, QUADRANTS, R_LAMBDA_LIMIT
from ..storage.record import unmatched_worst
from .aggregates import band_of
from .results import RunResults
from .terminal.layout import number
from .terminal.run import coverage_rows, surface_line, unmatched_lines

_FEWEST_TO_JUDGE = 20
_NUMBERS = ["match_rate", "cdc_mean", "r_lambda_mean", "r_gap_mean", "n_missing", "n_hallucinated"]


@dataclass(frozen=True)
class Verdict:
    """What a run says of the simulation.

    weakest : where it is weakest; "" where too few objects tell
    unmatched : what is behind the objects that only one side has, a sentence for each side that has any
    surface : how far the simulated surface is displaced, and how rough both are
    coverage : headings, then a row for each side: which share of its surface the other side has
    numbers : six scores with name, mean and std over pairs (NaN where null), digits to show, how to read them, and of
        object scores of how many pairs they are and what they are with unmatched objects as worst
    """

    sentence: str
    weakest: str
    unmatched: str
    surface: str
    coverage: list[list[str]]
    numbers: list[dict[str, Any]]


def verdict_of(results: RunResults) -> Verdict:
    """What the run says of the simulation."""
    record, overview = results.run.record, run_overview(results.run)
    return Verdict(
        sentence=verdict_sentence(overview.verdict) if overview else "",
        weakest=_weakest(results),
        unmatched=_as_text(unmatched_lines(record)),
        surface=_as_text([surface_line(record)]),
        coverage=coverage_rows(record),
        numbers=_numbers(results),
    )


def limits_in_words() -> str:
    """The four quadrants and where they part."""
    faithful, lost, displaced, failed = QUADRANTS.values()
    return (
        f"{faithful}: CDC at most {CDC_LIMIT} and r_lambda at most {R_LAMBDA_LIMIT}; {lost}: r_lambda above "
        f"{R_LAMBDA_LIMIT}; {displaced}: CDC above {CDC_LIMIT}; {failed}: both above. The limits are fidpipe's, "
        "not the paper's: each side about half a metre from the other on average, and the upper end of what is usual "
        "for a twin that was meshed from scans"
    )


def _as_text(lines: Iterable[str]) -> str:
    """Lines of the terminal as sentences of one paragraph."""
    return " ".join(f"{line[0].upper()}{line[1:]}." for line in lines)


def _weakest(results: RunResults) -> str:
    """The class with the smallest share of faithful real objects, and the range band with the largest of missing ones.

    Only classes and bands with enough real objects count, where there are two of them.
    """
    missing = results.unmatched[results.unmatched.status == "missing"]
    real = pd.concat([results.matched, missing], ignore_index=True)
    classes = pd.Series(pd.Categorical(real.group, real.group.unique()))
    parts = []
    for kind, groups, word, is_so, sign in (
        (results.class_is, classes, "faithful", real.quadrant == "faithful", -1),
        ("range", band_of(real.range_m), "missing", real.status == "missing", 1),
    ):
        shares = is_so.groupby(groups, observed=True).agg(["mean", "size"]).query("size >= @_FEWEST_TO_JUDGE")
        if len(shares) > 1:
            worst = shares.iloc[int((sign * shares["mean"]).argmax())]
            parts.append(f"{kind} {worst.name} ({100 * worst['mean']:.0f} % {word} of {worst['size']:.0f})")
    return f"Weakest: {'; '.join(parts)}." if parts else ""


def _numbers(results: RunResults) -> list[dict[str, Any]]:
    over_pairs = results.pairs.agg({column: ["mean", "std"] for column in _NUMBERS})
    summary = results.run.record.summary
    shift, change, rms = (
        f"{metric_of(column).heading} {number(summary[column].mean, 2)}"
        for column in ("max_eigenvalue_shift_mean", "laplacian_change_mean", "alignment_rms_m_mean")
    )
    beside = {"r_lambda_mean": f"; {shift} over {change}, {rms} m"}
    return [
        {
            "name": metric_of(column).label,
            "digits": 1 if metric_of(column).is_count else 3,
            "reading": metric_of(column).reading + beside.get(column, ""),
            "count": _count(results, column),
            **over_pairs[column],
        }
        for column in _NUMBERS
    ]


def _count(results: RunResults, column: str) -> str:
    """Of how many pairs the mean of an object score is, and what it is with unmatched objects as worst; else ""."""
    worst = results.run.record.summary.get(unmatched_worst(metric_of(column).column))
    if worst is None:
        return ""
    return (
        f"{results.pairs[column].count()} of {len(results.pairs)} pairs; {number(worst.mean)} with unmatched as worst"
    )
