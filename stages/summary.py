"""Summaries over the objects of a pair and over the pairs of a dataset."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from ..schemas.results import Number, ScoreSummary
from .arrays import FloatArray


def summarise_pair(
    scores: Mapping[str, FloatArray],
    statuses: Sequence[str],
    matched_range_m: FloatArray,
    not_found_range_m: FloatArray,
    extra_range_m: FloatArray,
) -> dict[str, Number]:
    """Counts, match rate, median ranges, and mean and standard deviation of each object score.

    The few points of a missing object do not count as an object of the simulated side.
    Nulls (NaN) are left out of means and deviations. Identical objects count with their scores: r_lambda and r_gap are
    0, the others as computed.

    Parameters
    ----------
    scores : by metric, (m,) float64, NaN for null
    statuses : (m,) scored, identical or too_small
    matched_range_m : (m,) distance of the matched real objects from the sensor
    not_found_range_m, extra_range_m : distance of the unmatched real and simulated objects from the sensor
    """
    n_matched = len(matched_range_m)
    n_not_found = len(not_found_range_m)
    n_extra = len(extra_range_m)
    summary: dict[str, Number] = {
        "n_communities_real": n_matched + n_not_found,
        "n_communities_sim": n_matched + n_extra,
        "n_matched": n_matched,
        "n_not_found": n_not_found,
        "n_extra": n_extra,
        "n_scored": statuses.count("scored"),
        "n_identical": statuses.count("identical"),
        "n_too_small": statuses.count("too_small"),
        "match_rate": n_matched / (n_matched + max(n_not_found, n_extra)),
        "found": n_matched / (n_matched + n_not_found),
        "median_range_matched_m": median_of(matched_range_m),
        "median_range_unmatched_m": median_of(
            np.concatenate([not_found_range_m, extra_range_m]),
        ),
    }
    for metric, values in scores.items():
        summary[f"{metric}_mean"], summary[f"{metric}_std"] = mean_and_std(values)
    return summary


def summarise_dataset(
    pair_means: Mapping[str, Sequence[Number] | FloatArray],
) -> dict[str, ScoreSummary]:
    """Mean, standard deviation (n - 1) over pairs, and number of pairs, of each per-pair value; nulls are left out."""
    summary = {}
    for name, of_pairs in pair_means.items():
        values = np.array(of_pairs, dtype=float)  # None becomes NaN
        mean, std = mean_and_std(values)
        summary[name] = ScoreSummary(
            mean=mean,
            std=std,
            n_pairs=int(np.count_nonzero(~np.isnan(values))),
        )
    return summary


def with_unmatched_as_worst(
    mean: Number, n: int, n_unmatched: int, worst: float
) -> float | None:
    """Mean of a pair over n objects, with its unmatched objects counted as worst; None without objects.

    A mean over matched objects only improves if the hardest objects are lost; this one does not.

    Parameters
    ----------
    mean : mean over the n matched objects that have the score; None if n is 0
    n_unmatched : objects not found and extra ones
    worst : upper bound of the score

    Examples
    --------
    >>> with_unmatched_as_worst(0.5, 2, 1, 2.0)
    1.0
    """
    if not n + n_unmatched:
        return None
    return ((mean or 0.0) * n + worst * n_unmatched) / (n + n_unmatched)


def mean_and_std(values: FloatArray) -> tuple[float | None, float | None]:
    """Mean and standard deviation (n - 1) of the values that are not NaN; None if there are too few."""
    known = values[~np.isnan(values)]
    mean = float(known.mean()) if len(known) else None
    std = float(known.std(ddof=1)) if len(known) > 1 else None
    return mean, std


def median_of(values: FloatArray) -> float | None:
    """Median; None without values."""
    return float(np.median(values)) if len(values) else None
