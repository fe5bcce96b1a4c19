"""What the paper claims of real and simulated scans, and whether a dataset bears it out.

Each claim of the paper's section "Real experiments" (and of its remarks on density and classes) that a number can check
is one line: claim, the paper's value, the value here, the rule, the verdict. What is read off pictures is left out,
as is what the perturbation experiment shows. By which rules a claim holds is said in `claim_rules`.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

from ...schemas.metrics import metric_of
from ...schemas.paper import MEDIAN_UNMATCHED_RANGE_M, N_MATCHED, N_PAIRS
from ...schemas.results import Claim, ClassFindings, Distribution, ObjectFindings, Scans, ScoreSummary
from .claim_rules import clearly_more, in_order, judged, mean_of, near_value, share_of, within_spread

#: |Spearman's rho| below this is a weak rank correlation (Evans, Straightforward Statistics, 1996).
WEAK_CORRELATION = 0.4


#: "Consistently" across scans: in at least this share of them.
CONSISTENT_SHARE = 0.9


_FOLIAGE = ("tree", "vegetation")


_IN_WORDS = "(in words)"  # the paper gives no number


def check_claims(summary: Mapping[str, ScoreSummary], findings: ObjectFindings) -> list[Claim]:
    """Every claim with its verdict; `not checkable` where a number that it needs is missing.

    Parameters
    ----------
    summary : by column of `pairs`, from `summarise_dataset`
    findings : from `summarise_objects`
    """
    return [
        *_means(summary, findings),
        *_unmatched(findings),
        *_spreads(summary, findings),
        *_classes(findings.classes),
    ]


def _means(summary: Mapping[str, ScoreSummary], findings: ObjectFindings) -> Iterator[Claim]:
    for column in ("match_rate", "cdc_mean", "r_lambda_mean", "r_gap_mean"):
        metric = metric_of(column)
        if metric.paper is not None:
            yield within_spread(f"mean {metric.heading} over pairs", metric.paper, summary[column])
    n_pairs = findings.n_pairs
    yield near_value(
        f"matched objects a pair (the paper: {N_MATCHED:,} in {N_PAIRS})",
        N_MATCHED / N_PAIRS,
        findings.n_matched / n_pairs if n_pairs else None,
    )


def _unmatched(findings: ObjectFindings) -> Iterator[Claim]:
    found = findings.range_m
    yield near_value("median range of unmatched objects, m", MEDIAN_UNMATCHED_RANGE_M, found.median_unmatched)
    yield in_order(
        "unmatched objects lie farther away than matched ones",
        _IN_WORDS,
        "median range unmatched > matched, m",
        found.median_unmatched,
        found.median_matched,
        "{:.1f} and {:.1f}",
    )
    near, far = (found.halves[:1], found.halves[1:]) if len(found.halves) == 2 else ((), ())
    for what, side, name in (("missing", "real", "real"), ("hallucinated", "sim", "simulated")):
        yield clearly_more(
            f"more of the distant {name} objects are {what}",
            _IN_WORDS,
            "share beyond the median range > share nearer",
            share_of(far, side),
            share_of(near, side),
        )
    for value, paper, rule, bound, sign in (
        (findings.density_ratio.min, "< 1/4", "smallest ratio < 0.25", 0.25, -1),
        (findings.density_ratio.max, "> 4", "largest ratio > 4", 4.0, 1),
    ):
        yield judged(
            f"n_sim / n_real goes {'below a quarter' if sign < 0 else 'above four'}",
            paper,
            rule,
            "{:.2f}",
            [value],
            lambda value, bound=bound, sign=sign: sign * value > sign * bound,
        )


def _spreads(summary: Mapping[str, ScoreSummary], findings: ObjectFindings) -> Iterator[Claim]:
    cdc, r_lambda = findings.distributions.cdc, findings.distributions.r_lambda
    over_pairs = [summary[f"{name}_mean"] for name in ("cdc", "r_lambda")]
    yield judged(
        "mean CDC is substantially larger than mean r_lambda",
        "0.75 and 0.37",
        "difference of the means > sum of their std over pairs",
        "{:.3f} and {:.3f}",
        [*(score.mean for score in over_pairs), *(score.std for score in over_pairs)],
        lambda a, b, std_a, std_b: a - b > std_a + std_b,
    )
    for name, word in (("mean", "larger"), ("std", "more variable")):
        yield in_order(
            f"r_lambda is {word} than r_gap",
            {"mean": "0.37 and 0.028", "std": "0.03 and 0.014"}[name],
            f"{name} over pairs, r_lambda > r_gap",
            getattr(summary["r_lambda_mean"], name),
            getattr(summary["r_gap_mean"], name),
        )
    yield judged(
        "CDC takes no value below 0.4",
        "0.40",
        "smallest CDC of an object >= 0.4",
        "{:.3f}",
        [cdc.min],
        lambda a: a >= 0.4,
    )
    yield in_order(
        "r_lambda varies more than CDC relative to its mean",
        _IN_WORDS,
        "std / mean over objects, r_lambda > CDC",
        r_lambda.cv,
        cdc.cv,
    )
    yield in_order(
        "r_lambda spans a wider range than CDC",
        _IN_WORDS,
        "95 % less 5 % quantile over objects, r_lambda > CDC",
        _less(r_lambda.q95, r_lambda.q05),
        _less(cdc.q95, cdc.q05),
    )
    yield in_order(
        "the peak of CDC is higher and sharper than that of r_lambda",
        _IN_WORDS,
        "density of the fullest bin of 0.05, CDC > r_lambda",
        cdc.peak_density,
        r_lambda.peak_density,
    )
    pairs = findings.within_pairs
    yield judged(
        "within a scan r_lambda varies more than CDC, consistently",
        _IN_WORDS,
        f"std over a pair's objects, r_lambda > CDC in {CONSISTENT_SHARE:.0%} of the pairs",
        "{} of {} scans",
        [pairs.n_r_lambda_wider, pairs.n_pairs or None],
        lambda n_wider, n: n_wider >= CONSISTENT_SHARE * n,
    )
    yield _four_scans(findings.scans)
    yield judged(
        "CDC and r_lambda are complementary, not redundant",
        _IN_WORDS,
        f"|Spearman's rho| over objects < {WEAK_CORRELATION}",
        "{:.2f}",
        [findings.rank_correlation.spearman],
        lambda rho: abs(rho) < WEAK_CORRELATION,
    )


def _four_scans(found: Scans) -> Claim:
    n_wider = sum((_quartile_range(scan.r_lambda) or 0) > (_quartile_range(scan.cdc) or 0) for scan in found.scans)
    return judged(
        "in four scans over a minute apart, r_lambda varies more than CDC",
        "4 of 4 scans",
        "interquartile range over a scan's objects, r_lambda > CDC in all",
        "{} of {} scans",
        [n_wider, len(found.scans) if found.apart else None],
        lambda wider, n: wider == n,
    )


def _classes(classes: Sequence[ClassFindings]) -> Iterator[Claim]:
    foliage, others, cars, trees = (
        [row for row in classes if row.label in labels] for labels in (_FOLIAGE, ("car", "wall"), ("car",), ("tree",))
    )
    for what, side, rule in (
        ("missing", "real", "share of real objects missing, trees and vegetation > cars and walls"),
        ("hallucinated", "sim", "share of simulated objects hallucinated, trees and vegetation > cars and walls"),
    ):
        yield clearly_more(
            f"trees and vegetation are {what} more often than cars and walls",
            _IN_WORDS,
            rule,
            share_of(foliage, side),
            share_of(others, side),
        )
    yield clearly_more(
        "near trees keep their structure, distant ones less",
        "0.70 and 0.27",
        "mean r_lambda of the farther half of the trees > that of the nearer half",
        mean_of(trees, "r_lambda_far"),
        mean_of(trees, "r_lambda_near"),
    )
    yield clearly_more(
        "CDC exceeds r_lambda more for trees and vegetation than for cars",
        "0.52 and 0.13",
        "mean over objects of CDC less r_lambda (the paper: a near tree, a car)",
        mean_of(foliage, "cdc_excess"),
        mean_of(cars, "cdc_excess"),
    )


def _less(high: float | None, low: float | None) -> float | None:
    return None if high is None or low is None else high - low


def _quartile_range(scores: Distribution) -> float | None:
    return _less(scores.q75, scores.q25)
