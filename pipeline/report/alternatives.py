"""The text alternative of each chart of a run: a sentence with its main numbers, for those who do not see it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import pandas as pd

from ...schemas.metrics import METRIC
from ..results.compare import recorded_times_s
from ..results.quadrants import QUADRANTS
from ..terminal import shown
from .aggregates import (
    SCORES,
    Bins,
    along_the_sequence,
    bearing_bins,
    binned_fates,
    binned_scores,
    histograms,
    quadrants,
    range_bands,
    range_bins,
    stage_times,
)
from .results import RunResults

_MOST_GROUPS = 10


def text_alternatives(results: RunResults) -> dict[str, str]:
    """A sentence for each chart of `charts.run_charts`, by the same ids."""
    by_place = {"range": range_bins(results), "bearing": bearing_bins()}
    unmatched = results.unmatched
    return {
        **{f"hist_{score}": _of_histogram(score, counted) for score, counted in histograms(results).items()},
        "quadrants": "r_lambda over CDC of each object: "
        + _listed(f"{title} {counted['n']:,}" for title, counted in _of_quadrants(results).items()),
        "box_scan": f"Box plots of the scans. {_medians(results, 'pair_id', results.pairs.pair_id)}",
        "box_class": f"Box plots by {results.class_is}. "
        + _medians(results, "group", results.matched.group.value_counts().index),
        **{f"scores_{name}": _of_scores(bins, binned_scores(results, bins)) for name, bins in by_place.items()},
        "sequence": _of_sequence(results),
        "polar": f"Map of the {(unmatched.status == 'missing').sum():,} missing and "
        f"{(unmatched.status == 'hallucinated').sum():,} hallucinated objects around the sensor"
        + (f", median distance {unmatched.range_m.median():.0f} m." if len(unmatched) else "."),
        "bands": "Objects by distance: "
        + _listed(
            f"{band} {row.matched} matched, {row.missing} missing, {row.hallucinated} hallucinated"
            for band, row in range_bands(results).iterrows()
        ),
        **{f"fates_{name}": _of_fates(bins, binned_fates(results, bins)) for name, bins in by_place.items()},
        "times": "Median seconds a pair by stage: "
        + _listed(
            f"{stage} {seconds:.2f}"
            for stage, seconds in stage_times(results).groupby("stage", observed=True).seconds.sum().items()
        ),
    }


def _of_histogram(score: str, counted: Mapping[str, float | None]) -> str:
    if counted["median"] is None:
        return f"Histogram of {METRIC[score].label}: no object has it."
    return f"Histogram of {METRIC[score].label} of {counted['n']:,} objects, median {counted['median']:.2f}."


def _of_quadrants(results: RunResults) -> dict[str, dict[str, int]]:
    counted = quadrants(results)
    return {title: counted[key] for key, title in QUADRANTS.items()}


def _medians(results: RunResults, column: str, groups: Iterable[str]) -> str:
    """Medians of both scores of the first groups."""
    medians = results.matched.groupby(column)[list(SCORES)].median()
    known = medians.loc[[name for name in groups if name in medians.index][:_MOST_GROUPS]]
    return "Medians: " + _listed(
        f"{shown(name)} " + ", ".join(f"{METRIC[score].label} {_number(row[score])}" for score in SCORES)
        for name, row in known.iterrows()
    )


def _of_scores(bins: Bins, scores: dict[str, pd.DataFrame]) -> str:
    n = max((rows.n for rows in scores.values()), key=sum)
    return f"Medians by {_place(bins)}: " + _listed(
        f"{name} "
        + ", ".join(f"{METRIC[score].label} {_number(rows['median'][name])}" for score, rows in scores.items())
        + f" of {n[name]}"
        for name in bins.names
        if n[name]
    )


def _of_fates(bins: Bins, fates: pd.DataFrame) -> str:
    return f"Missing share of the real and hallucinated share of the simulated objects by {_place(bins)}: " + _listed(
        f"{name} {_share(row.missing_share)} and {_share(row.hallucinated_share)}"
        for name, row in fates.iterrows()
        if row.matched + row.missing + row.hallucinated
    )


def _of_sequence(results: RunResults) -> str:
    pairs = along_the_sequence(results, recorded_times_s(results.run))
    order = "time" if pairs.has_times else "name"
    columns = {"match rate": "match_rate", **{METRIC[score].label: METRIC[score].mean_column for score in SCORES}}
    ends = {title: pairs.rows[column].dropna() for title, column in columns.items()}
    return f"Each of {len(pairs.rows)} pairs by {order}, lowest to highest: " + _listed(
        f"{title} {own.min():.2f} to {own.max():.2f}" for title, own in ends.items() if len(own)
    )


def _place(bins: Bins) -> str:
    return "distance" if bins.column == "range_m" else "direction (0° ahead, left positive)"


def _listed(parts: Iterable[str]) -> str:
    return ("; ".join(parts) or "nothing") + "."


def _number(value: float) -> str:
    return "not known" if pd.isna(value) else f"{value:.2f}"


def _share(value: float) -> str:
    return "none there" if pd.isna(value) else f"{100 * value:.0f} %"
