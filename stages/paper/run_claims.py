"""The paper's claims about real and simulated scans, checked on the objects of a run.

Each claim of the paper's section "Real experiments" (and of its remarks on density and classes) that a number can check
is a row of `schemas/paper.toml`: claim, the paper's value, rule and samples. The rules are in `claim_rules`. Left out
are claims that are read off pictures, those of the perturbation experiment (`sweep_claims`), and that r_lambda is
larger than r_gap, which no data can deny: r_gap is at most half of r_lambda by its definition.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...schemas.data_files import read_data
from ...schemas.metric_catalogue import metric_of
from ..arrays import FloatArray, IntArray
from ..statistics.comparison import blocks_of
from ..statistics.findings import (
    DENSE_RATIO,
    SPARSE_RATIO,
    Objects,
    chain_apart,
    peak_density,
    std_by_pair,
)
from .claim_rules import (
    Claim,
    Sample,
    Statistic,
    above_zero,
    complementary,
    in_most_pairs,
    in_some_pairs,
    near,
    order,
    over_pairs,
    share_order,
)

#: The smallest CDC of the paper's data.
LEAST_CDC = 0.4

_COPY = -1
_Tables = dict[str, dict[str, NDArray[Any]]]  #: arrays by table and column


def check_run_claims(
    real: Objects,
    sim: Objects,
    contents: Sequence[str],
    real_scans: Sequence[str],
    timestamps_s: Sequence[float | None],
) -> list[Claim]:
    """All claims with their verdicts; `not decided`, with the reason, if there are too few data or none.

    Parameters
    ----------
    real, sim : the objects of all pairs
    contents : by pair, a hash of all inputs of its scores: a copy of an earlier pair is left out
    real_scans : by pair, a hash of its real scan: pairs of one real scan count as one
    timestamps_s : by pair, time of the scan, None if unknown: scans within 10 s count as one
    """
    first: dict[str, int] = {}
    kept = [i for i, content in enumerate(contents) if first.setdefault(content, i) == i]
    blocks = np.full(len(contents), _COPY, dtype=np.int32)
    blocks[kept] = blocks_of([real_scans[i] for i in kept], [timestamps_s[i] for i in kept])
    apart = [kept[i] for i in chain_apart([timestamps_s[i] for i in kept])]
    tables = _columns(real, sim, blocks, apart)
    claims = []
    for row in read_data("paper")["run_claims"]:  # names of statistics and samples stand for these
        texts = {name: row.pop(name) for name in ("claim", "paper") if name in row}
        if "statistic" in row:
            row["statistic"] = _STATISTICS[row["statistic"]]
        samples = {name: _sample(tables, **value) for name, value in row.items() if isinstance(value, dict)}
        claims.append(replace(_RULES[row.pop("rule")](**row | samples), **texts))
    return claims


def _columns(real: Objects, sim: Objects, blocks: IntArray, apart: Sequence[int]) -> _Tables:
    """Columns of the objects of each side, of the matched ones and of the pairs, without copies of pairs.

    `block` is the independent pair of a row; pairs that count as one have the same.
    """
    objects = {name: np.concatenate([own, getattr(sim, name)]) for name, own in vars(real).items()}
    objects["is_unmatched"] = ~objects["is_matched"]
    objects["side"] = np.repeat(["real", "sim"], [len(real.pair), len(sim.pair)])
    matched = real.matched
    ratio, excess = matched.n_sim / matched.n_real, matched.cdc - matched.r_lambda
    matches = vars(matched) | {"ratio": ratio, "excess": excess, "is_scored": ~np.isnan(excess)}
    matches |= {"is_sparse": ratio < SPARSE_RATIO, "is_dense": ratio > DENSE_RATIO, "is_low": matched.cdc < LEAST_CDC}
    pairs = _of_pairs(real, sim, matched, len(blocks), apart) | {"pair": np.arange(len(blocks))}
    tables = {}
    for name, own in {"objects": objects, "matches": matches, "pairs": pairs}.items():
        block = blocks[own["pair"]]
        tables[name] = {key: values[block != _COPY] for key, values in (own | {"block": block}).items()}
    objects, matches = tables["objects"], tables["matches"]
    objects["is_far"] = objects["range_m"] >= _median(objects["range_m"])
    matches["is_far_tree"] = matches["range_m"] >= _median(matches["range_m"][matches["label"] == "tree"])
    return tables


def _sample(
    tables: _Tables, of: str, values: Sequence[str], where: Mapping[str, Any] = MappingProxyType({}), name: str = ""
) -> Sample:
    """Some columns without rows with NaN, of the rows whose columns in `where` have one of the given values."""
    columns = tables[of]
    chosen = np.all([~np.isnan(columns[value].astype(np.float64)) for value in values], axis=0)
    for column, allowed in where.items():
        chosen &= np.isin(columns[column], allowed)
    found = np.stack([columns[value][chosen] for value in values], axis=1)
    return Sample(found[:, 0] if len(values) == 1 else found, columns["block"][chosen], name)


def _of_pairs(
    real: Objects, sim: Objects, matched: Objects, n_pairs: int, apart: Sequence[int]
) -> dict[str, NDArray[Any]]:
    """Columns of the pairs: matches and match rate, mean scores, and how much more r_lambda varies than CDC.

    iqr_excess : difference of the interquartile ranges, only of scans over a minute apart
    """
    n_matched, n_real, n_sim = (np.bincount(own.pair, minlength=n_pairs) for own in (matched, real, sim))
    pairs: dict[str, NDArray[Any]] = {"n_matched": n_matched}
    with np.errstate(invalid="ignore"):  # pairs without objects or scores have none
        pairs["match_rate"] = n_matched / np.maximum(n_real, n_sim)
        for name in ("cdc", "r_lambda", "r_gap"):
            known = ~np.isnan(scores := getattr(matched, name))
            pair = matched.pair[known]
            pairs[name] = np.bincount(pair, scores[known], n_pairs) / np.bincount(pair, minlength=n_pairs)
    r_lambda_std, cdc_std = (std_by_pair(own, matched.pair, n_pairs) for own in (matched.r_lambda, matched.cdc))
    pairs["std_excess"], pairs["iqr_excess"] = r_lambda_std - cdc_std, np.full(n_pairs, np.nan)
    for i in apart if len(apart) > 1 else ():
        own = [scores[(matched.pair == i) & ~np.isnan(scores)] for scores in (matched.r_lambda, matched.cdc)]
        if all(len(scores) for scores in own):
            r_lambda, cdc = (np.subtract(*np.quantile(scores, [0.75, 0.25])) for scores in own)
            pairs["iqr_excess"][i] = r_lambda - cdc
    return pairs


def _check_mean(metric: str, sample: Sample) -> Claim:
    """Check that a mean over pairs is within a standard deviation of the paper's."""
    row, interval = metric_of(metric), over_pairs(np.mean, sample)
    assert row.paper is not None, f"the paper has no mean of {metric}"
    found = near("mean over pairs", (row.paper.mean - row.paper.std, row.paper.mean + row.paper.std), interval)
    return replace(found, claim=f"mean {row.heading} over pairs", paper=f"{row.paper}")


def _check_near(what: str, statistic: Statistic, value: float, sample: Sample) -> Claim:
    """Check that a value is within a tenth of the paper's."""
    what = f"{what} within a tenth of the paper's, that is"
    return near(what, (0.9 * value, 1.1 * value), over_pairs(statistic, sample), "{:.3g}")


def _check_margin(what: str, larger: Sample, smaller: Sample) -> Claim:
    """Check that a mean is larger than another by more than the sum of their standard deviations."""
    here = " and ".join(f"{np.mean(own.values):.3f}" if len(own.values) else "-" for own in (larger, smaller))
    interval = over_pairs(lambda a, b: np.mean(a) - np.mean(b) - _std(a) - _std(b), larger, smaller)
    return above_zero(what, here, interval)


def _median(values: FloatArray) -> float:
    """Median of the known values; infinite without any."""
    return float(np.nanmedian(values)) if (~np.isnan(values)).any() else math.inf


def _std(values: FloatArray) -> float:
    """Standard deviation (n - 1); NaN for fewer than two values."""
    return float(np.std(values, ddof=1)) if len(values) > 1 else np.nan


def _variation(values: FloatArray) -> float:
    """Standard deviation over mean; NaN if the mean is 0."""
    mean = float(np.mean(values))
    return _std(values) / mean if mean else np.nan


def _span(values: FloatArray) -> float:
    """The 95 % minus the 5 % quantile."""
    return float(np.subtract(*np.quantile(values, [0.95, 0.05])))


_STATISTICS: dict[str, Statistic] = {
    "mean": np.mean,
    "median": np.median,
    "smallest": np.min,
    "largest": np.max,
    "std": _std,
    "variation": _variation,
    "span": _span,
    "peak": peak_density,
}
_RULES: dict[str, Callable[..., Claim]] = {
    "mean": _check_mean,
    "near": _check_near,
    "order": order,
    "share": share_order,
    "some": in_some_pairs,
    "most": in_most_pairs,
    "margin": _check_margin,
    "complementary": complementary,
}
