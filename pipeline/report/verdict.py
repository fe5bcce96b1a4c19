"""What a run says in a sentence, in six numbers, and where the simulation is weakest."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from typing import Any

import pandas as pd

from .aggregates import quadrants, range_bands
from .quadrants import CDC_LIMIT, QUADRANTS, R_LAMBDA_LIMIT, UNKNOWN
from .results import RunResults

_FEWEST_TO_JUDGE = 20


@dataclass(frozen=True)
class Verdict:
    """The sentence, where the simulation is weakest ("" where too few objects tell), and the six numbers."""

    sentence: str
    weakest: str
    numbers: list[dict[str, Any]]


def verdict_of(results: RunResults) -> Verdict:
    """What the run says of the simulation."""
    return Verdict(_sentence(results), _weakest(results), _numbers(results))


def _sentence(results: RunResults) -> str:
    n_of = {key: counted["n"] for key, counted in quadrants(results).items()}
    n_missing = int((results.unmatched.status == "missing").sum())
    n_hallucinated = len(results.unmatched) - n_missing
    n_real = len(results.matched) + n_missing
    n_pairs = len(results.pairs)

    def share(n: int) -> str:
        return f"{100 * n / n_real:.0f} %"

    parts = [
        f"{share(n_of['faithful'])} faithfully",
        f"{share(n_of['structure lost'])} with the right shape but lost structure",
        f"{share(n_of['displaced'])} with the right structure but displaced",
    ]
    unknown = n_of[UNKNOWN]
    has = "object has" if n_hallucinated == 1 else "objects have"
    return (
        f"Of the {n_real:,} real objects in {n_pairs:,} pair{'s' * (n_pairs > 1)} of scans the simulation reproduces "
        f"{', '.join(parts)}; {share(n_of['failed'])} fail in both, {share(n_missing)} are missing"
        f"{f', {share(unknown)} are too small to judge' if unknown else ''}; "
        f"{n_hallucinated:,} simulated {has} no real counterpart."
    )


def _weakest(results: RunResults) -> str:
    """The class and the range band with the smallest share of faithful real objects, among those with enough."""
    parts = []
    missing = results.unmatched[results.unmatched.status == "missing"]
    faithful = results.matched[results.matched.quadrant == "faithful"]
    n_real = Counter([*results.matched.group, *missing.group])
    n_faithful = Counter(faithful.group)
    classes = [name for name, n in n_real.items() if n >= _FEWEST_TO_JUDGE]
    if len(classes) > 1:
        worst = min(classes, key=lambda name: n_faithful[name] / n_real[name])
        kind = "class" if results.class_is == "label" else "shape"
        parts.append(f"{kind} {worst} ({100 * n_faithful[worst] / n_real[worst]:.0f} % faithful of {n_real[worst]})")
    bands = [band for band in range_bands(results) if band["matched"] + band["missing"] >= _FEWEST_TO_JUDGE]
    if len(bands) > 1:
        worst_band = max(bands, key=lambda band: band["missing"] / (band["matched"] + band["missing"]))
        n = worst_band["matched"] + worst_band["missing"]
        parts.append(f"range {worst_band['name']} ({100 * worst_band['missing'] / n:.0f} % missing of {n})")
    return f"Weakest: {'; '.join(parts)}." if parts else ""


def _numbers(results: RunResults) -> list[dict[str, Any]]:
    pairs = results.pairs
    summary = results.run.record.summary

    def mean(column: str) -> str:
        value = summary[column].mean
        return "-" if value is None else f"{value:.2f}"

    beside = (
        f"largest eigenvalue shift {mean('max_eigenvalue_shift_mean')} over Laplacian change "
        f"{mean('laplacian_change_mean')}, alignment {mean('alignment_rms_m_mean')} m"
    )
    rows = (
        ("match rate", "match_rate", "1 best", "objects that both sides have, over those of the side with more"),
        ("CDC", "cdc_mean", "0 best, 2 worst", "geometry: how far the points of an object are from its counterpart"),
        ("r_lambda", "r_lambda_mean", "0 best, 1 worst", f"structure; {beside}"),
        ("r_gap", "r_gap_mean", "0 best, 0.5 worst", "structure: change of the overall connectivity"),
        ("missing per pair", "n_missing", "0 best", "real objects without a simulated counterpart"),
        ("hallucinated per pair", "n_hallucinated", "0 best", "simulated objects without a real counterpart"),
    )
    return [
        {
            "name": name,
            "mean": _or_none(pairs[column].mean()),
            "std": _or_none(pairs[column].std()),
            "digits": 1 if column.startswith("n_") else 3,
            "scale": scale,
            "meaning": meaning,
        }
        for name, column, scale, meaning in rows
    ]


def _or_none(value: float) -> float | None:
    return None if pd.isna(value) else float(value)


def limits_in_words() -> str:
    """The four quadrants and where they part."""
    faithful, lost, displaced, failed = QUADRANTS.values()
    return (
        f"{faithful}: CDC at most {CDC_LIMIT} and r_lambda at most {R_LAMBDA_LIMIT}; {lost}: r_lambda above "
        f"{R_LAMBDA_LIMIT}; {displaced}: CDC above {CDC_LIMIT}; {failed}: both above. The limits are fidpipe's, "
        "not the paper's: each side about half a metre from the other on average, and the upper end of what is usual "
        "for a twin that was meshed from scans"
    )
