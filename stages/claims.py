"""What the paper claims of real and simulated scans, and whether a dataset bears it out.

Each claim of the paper's section "Real experiments" (and of its remarks on density and classes) that a number can check
is one line: claim, the paper's value, the value here, the rule, the verdict. Three rules recur:

- a value with a spread (a ± s) holds where the mean here lies within a ± s;
- a plain value holds where the value here lies within a tenth of it;
- an order (more, farther, wider) holds where it is so here; between means or shares of two groups of objects, where
  they differ by more than two standard errors, and each group has five objects. The error of a share must not vanish at
  0 and 1: both share and error are taken with two unmatched and two matched objects added (Agresti and Coull, 1998).

The rules were written before any of our results was seen, but for the two standard errors and the five objects, which
came later and make it harder to hold. Claims about single pictures are left out, as is what the perturbation
experiment shows.

Leaves to others: the numbers themselves (`findings`, `summary`).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

HOLDS, FAILS, UNKNOWN = "holds", "does not hold", "not checkable"

#: |Spearman's rho| below this is a weak rank correlation (Evans, Straightforward Statistics, 1996).
WEAK_CORRELATION = 0.4
#: "Consistently" across scans: in at least this share of them.
CONSISTENT_SHARE = 0.9
_FOLIAGE = ("tree", "vegetation")
_IN_WORDS = "(in words)"  # the paper gives no number

#: A group of fewer objects is not compared with another.
LEAST_OBJECTS = 5


@dataclass(frozen=True)
class _Estimate:
    """A value of a group of objects; `centre` and `error` are what an order between groups is judged by."""

    value: float | None = None
    centre: float | None = None
    error: float | None = None


_NOTHING = _Estimate()


@dataclass(frozen=True)
class Claim:
    """One claim: what the paper says, what is found here, by which rule, and whether it holds."""

    claim: str
    paper: str
    here: str
    rule: str
    verdict: str

    def as_dict(self) -> dict[str, str]:
        """Plain values, for the run's record."""
        return asdict(self)


def check_claims(summary: Mapping[str, Any], findings: Mapping[str, Any]) -> list[Claim]:
    """Every claim with its verdict; `not checkable` where a number that it needs is missing.

    Parameters
    ----------
    summary : mean and std over pairs by score, from `summarise_dataset`
    findings : from `summarise_objects`
    """
    return [
        *_means(summary, findings),
        *_unmatched(findings),
        *_spreads(summary, findings),
        *_classes(findings["classes"]),
    ]


def _means(summary: Mapping[str, Any], findings: Mapping[str, Any]) -> Iterator[Claim]:
    for column, name, mean, std in (
        ("match_rate", "match rate", 0.594, 0.066),
        ("cdc_mean", "CDC", 0.75, 0.02),
        ("r_lambda_mean", "r_lambda", 0.37, 0.03),
        ("r_gap_mean", "r_gap", 0.028, 0.014),
    ):
        yield _within_spread(f"mean {name} over pairs", mean, std, summary[column])
    n_pairs = findings["n_pairs"]
    yield _near(
        "matched objects a pair (the paper: 1,067 in 50)",
        1067 / 50,
        findings["n_matched"] / n_pairs if n_pairs else None,
    )


def _unmatched(findings: Mapping[str, Any]) -> Iterator[Claim]:
    median = findings["range_m"]
    yield _near("median range of unmatched objects, m", 29.0, median["median_unmatched"])
    yield _order(
        "unmatched objects lie farther away than matched ones",
        _IN_WORDS,
        "median range unmatched > matched, m",
        median["median_unmatched"],
        median["median_matched"],
        "{:.1f} and {:.1f}",
    )
    near, far = halves if len(halves := findings["range_m"]["halves"]) == 2 else ({}, {})
    for what, side, name in (("missing", "real", "real"), ("hallucinated", "sim", "simulated")):
        yield _more(
            f"more of the distant {name} objects are {what}",
            _IN_WORDS,
            "share beyond the median range > share nearer",
            _share([far], what, side),
            _share([near], what, side),
        )
    ratio = findings["density_ratio"]
    for name, paper, rule, bound, sign in (
        ("min", "< 1/4", "smallest ratio < 0.25", 0.25, -1),
        ("max", "> 4", "largest ratio > 4", 4.0, 1),
    ):
        yield _claim(
            f"n_sim / n_real goes {'below a quarter' if sign < 0 else 'above four'}",
            paper,
            rule,
            "{:.2f}",
            [ratio[name]],
            lambda value, bound=bound, sign=sign: sign * value > sign * bound,
        )


def _spreads(summary: Mapping[str, Any], findings: Mapping[str, Any]) -> Iterator[Claim]:
    cdc, r_lambda = (findings["distributions"][name] for name in ("cdc", "r_lambda"))
    of_pairs = [summary[f"{name}_mean"] for name in ("cdc", "r_lambda")]
    yield _claim(
        "mean CDC is substantially larger than mean r_lambda",
        "0.75 and 0.37",
        "difference of the means > sum of their std over pairs",
        "{:.3f} and {:.3f}",
        [of[name] for name in ("mean", "std") for of in of_pairs],
        lambda a, b, std_a, std_b: a - b > std_a + std_b,
    )
    for name, word in (("mean", "larger"), ("std", "more variable")):
        yield _order(
            f"r_lambda is {word} than r_gap",
            {"mean": "0.37 and 0.028", "std": "0.03 and 0.014"}[name],
            f"{name} over pairs, r_lambda > r_gap",
            summary["r_lambda_mean"][name],
            summary["r_gap_mean"][name],
        )
    yield _claim(
        "CDC takes no value below 0.4",
        "0.40",
        "smallest CDC of an object >= 0.4",
        "{:.3f}",
        [cdc["min"]],
        lambda a: a >= 0.4,
    )
    yield _order(
        "r_lambda varies more than CDC relative to its mean",
        _IN_WORDS,
        "std / mean over objects, r_lambda > CDC",
        r_lambda["cv"],
        cdc["cv"],
    )
    yield _order(
        "r_lambda spans a wider range than CDC",
        _IN_WORDS,
        "95 % less 5 % quantile over objects, r_lambda > CDC",
        _span(r_lambda, "q05", "q95"),
        _span(cdc, "q05", "q95"),
    )
    yield _order(
        "the peak of CDC is higher and sharper than that of r_lambda",
        _IN_WORDS,
        "density of the fullest bin of 0.05, CDC > r_lambda",
        cdc["peak_density"],
        r_lambda["peak_density"],
    )
    pairs = findings["within_pairs"]
    yield _claim(
        "within a scan r_lambda varies more than CDC, consistently",
        "50 of 50 scans",
        f"std over a pair's objects, r_lambda > CDC in {CONSISTENT_SHARE:.0%} of the pairs",
        "{} of {} scans",
        [pairs["n_r_lambda_wider"], pairs["n_pairs"] or None],
        lambda n_wider, n: n_wider >= CONSISTENT_SHARE * n,
    )
    yield _four_scans(findings["scans"])
    yield _claim(
        "CDC and r_lambda are complementary, not redundant",
        _IN_WORDS,
        f"|Spearman's rho| over objects < {WEAK_CORRELATION}",
        "{:.2f}",
        [findings["rank_correlation"]["spearman"]],
        lambda rho: abs(rho) < WEAK_CORRELATION,
    )


def _four_scans(found: Mapping[str, Any]) -> Claim:
    scans = found["scans"]
    n_wider = sum(
        (_span(scan["r_lambda"], "q25", "q75") or 0) > (_span(scan["cdc"], "q25", "q75") or 0) for scan in scans
    )
    return _claim(
        "in four scans over a minute apart, r_lambda varies more than CDC",
        "4 of 4 scans",
        "interquartile range over a scan's objects, r_lambda > CDC in all",
        "{} of {} scans",
        [n_wider, len(scans) if found["apart"] else None],
        lambda wider, n: wider == n,
    )


def _classes(classes: list[dict[str, Any]]) -> Iterator[Claim]:
    foliage, others, cars, walls, trees = (
        [row for row in classes if row["label"] in labels]
        for labels in (_FOLIAGE, ("car", "wall"), ("car",), ("wall",), ("tree",))
    )
    for what, side, rule in (
        ("missing", "real", "share of real objects missing, trees and vegetation > cars and walls"),
        ("hallucinated", "sim", "share of simulated objects hallucinated, trees and vegetation > cars and walls"),
    ):
        yield _more(
            f"trees and vegetation are {what} more often than cars and walls",
            _IN_WORDS,
            rule,
            _share(foliage, what, side),
            _share(others, what, side),
        )
    for score, name, paper in (("cdc", "CDC", "0.56 and 0.40"), ("r_lambda", "r_lambda", "0.27 and 0.13")):
        means = [_mean([row], score) for row in classes if row["label"] in ("car", *_FOLIAGE)]
        yield _more(
            f"walls have the lowest {name} of the four classes",
            paper,
            "mean of the next class > mean of walls",
            min(means, key=lambda of: math.inf if of.value is None else of.value, default=_NOTHING),
            _mean(walls, score),
        )
    yield _more(
        "near trees keep their structure, distant ones less",
        "0.70 and 0.27",
        "mean r_lambda of the farther half of the trees > that of the nearer half",
        _mean(trees, "r_lambda_far"),
        _mean(trees, "r_lambda_near"),
    )
    yield _more(
        "CDC exceeds r_lambda more for trees and vegetation than for cars",
        "0.52 and 0.13",
        "mean over objects of CDC less r_lambda (the paper: a near tree, a car)",
        _mean(foliage, "cdc_excess"),
        _mean(cars, "cdc_excess"),
    )


def _claim(
    claim: str, paper: str, rule: str, pattern: str, values: list[float | None], holds: Callable[..., bool]
) -> Claim:
    if any(value is None for value in values):
        return Claim(claim, paper, "-", rule, UNKNOWN)
    return Claim(claim, paper, pattern.format(*values), rule, HOLDS if holds(*values) else FAILS)


def _within_spread(claim: str, mean: float, std: float, here: Mapping[str, Any]) -> Claim:
    text = "{:.3f}" if here["std"] is None else f"{{:.3f}} ± {here['std']:.3f}"
    rule = f"mean within {mean:g} ± {std:g}"
    return _claim(claim, f"{mean:g} ± {std:g}", rule, text, [here["mean"]], lambda value: abs(value - mean) <= std)


def _near(claim: str, paper: float, here: float | None) -> Claim:
    rule = f"within a tenth of {paper:.3g}"
    return _claim(claim, f"{paper:.3g}", rule, "{:.3g}", [here], lambda value: abs(value - paper) <= paper / 10)


def _order(
    claim: str, paper: str, rule: str, larger: float | None, smaller: float | None, pattern: str = "{:.3f} and {:.3f}"
) -> Claim:
    return _claim(claim, paper, rule, pattern, [larger, smaller], lambda a, b: a > b)


def _more(claim: str, paper: str, rule: str, larger: _Estimate, smaller: _Estimate) -> Claim:
    return _claim(
        claim,
        paper,
        f"{rule}, by over two standard errors",
        "{:.3f} and {:.3f}",
        [larger.value, smaller.value, larger.centre, smaller.centre, larger.error, smaller.error],
        lambda _, __, a, b, error_a, error_b: a - b > 2 * math.hypot(error_a, error_b),
    )


def _span(of: Mapping[str, Any], low: str, high: str) -> float | None:
    return None if of[low] is None else of[high] - of[low]


def _share(groups: Sequence[Mapping[str, Any]], what: str, side: str) -> _Estimate:
    """Share of unmatched objects in some groups together, with centre and error after Agresti and Coull."""
    n = sum(group.get(f"n_{side}", 0) for group in groups)
    if n < LEAST_OBJECTS:
        return _NOTHING
    n_unmatched = sum(group[f"n_{what}"] for group in groups)
    centre = (n_unmatched + 2) / (n + 4)
    return _Estimate(n_unmatched / n, centre, math.sqrt(centre * (1 - centre) / (n + 4)))


def _mean(classes: list[dict[str, Any]], score: str) -> _Estimate:
    """Mean of a score over the objects of some classes together, and its standard error."""
    rows = [row for row in classes if row[f"{score}_n"]]
    n = sum(row[f"{score}_n"] for row in rows)
    if n < LEAST_OBJECTS:
        return _NOTHING
    mean = sum(row[f"{score}_n"] * row[f"{score}_mean"] for row in rows) / n
    squares = sum(
        (row[f"{score}_n"] - 1) * (row[f"{score}_std"] or 0) ** 2
        + row[f"{score}_n"] * (row[f"{score}_mean"] - mean) ** 2
        for row in rows
    )
    return _Estimate(mean, mean, math.sqrt(squares / (n - 1) / n))
