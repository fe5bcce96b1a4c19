"""By which rules a claim holds: within a spread, near a value, or in an order; and what an order is judged by.

- a value with a spread (a ± s) holds where the mean here lies within a ± s;
- a plain value holds where the value here lies within a tenth of it;
- an order (more, farther, wider) holds where it is so here; between means or shares of two groups of objects, where
  they differ by more than two standard errors, and each group has five objects. The error of a share must not vanish at
  0 and 1: both share and error are taken with two unmatched and two matched objects added (Agresti and Coull, 1998).

The rules were written before any of our results was seen, but for the two standard errors and the five objects, which
came later and make it harder to hold.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from ...schemas.metrics import PaperMean
from ...schemas.results import Claim, ClassFindings, ScoreSummary, Unmatched

HOLDS = "holds"
FAILS = "does not hold"
UNKNOWN = "not checkable"

#: A group of fewer objects is not compared with another.
LEAST_OBJECTS = 5


@dataclass(frozen=True)
class Estimate:
    """A value of a group of objects; `centre` and `error` are what an order between groups is judged by."""

    value: float | None = None
    centre: float | None = None
    error: float | None = None


#: Of a group of too few objects.
NOTHING = Estimate()


def judged(
    claim: str, paper: str, rule: str, pattern: str, values: list[float | None], holds: Callable[..., bool]
) -> Claim:
    """A claim with its verdict: `holds` of the values, or not checkable where one is missing."""
    if any(value is None for value in values):
        return Claim(claim=claim, paper=paper, here="-", rule=rule, verdict=UNKNOWN)
    verdict = HOLDS if holds(*values) else FAILS
    return Claim(claim=claim, paper=paper, here=pattern.format(*values), rule=rule, verdict=verdict)


def within_spread(claim: str, paper: PaperMean, here: ScoreSummary) -> Claim:
    """That a mean over pairs lies within the paper's mean ± std."""
    text = "{:.3f}" if here.std is None else f"{{:.3f}} ± {here.std:.3f}"
    return judged(
        claim, f"{paper}", f"mean within {paper}", text, [here.mean], lambda value: abs(value - paper.mean) <= paper.std
    )


def near_value(claim: str, paper: float, here: float | None) -> Claim:
    """That a value lies within a tenth of the paper's."""
    rule = f"within a tenth of {paper:.3g}"
    return judged(claim, f"{paper:.3g}", rule, "{:.3g}", [here], lambda value: abs(value - paper) <= paper / 10)


def in_order(
    claim: str, paper: str, rule: str, larger: float | None, smaller: float | None, pattern: str = "{:.3f} and {:.3f}"
) -> Claim:
    """That one value is larger than another."""
    return judged(claim, paper, rule, pattern, [larger, smaller], lambda a, b: a > b)


def clearly_more(claim: str, paper: str, rule: str, larger: Estimate, smaller: Estimate) -> Claim:
    """That one group has more than another, by over two standard errors of both together."""
    return judged(
        claim,
        paper,
        f"{rule}, by over two standard errors",
        "{:.3f} and {:.3f}",
        [larger.value, smaller.value, larger.centre, smaller.centre, larger.error, smaller.error],
        lambda _, __, a, b, error_a, error_b: a - b > 2 * math.hypot(error_a, error_b),
    )


def share_of(groups: Sequence[Unmatched], side: str) -> Estimate:
    """Share of unmatched objects of a side in some groups together, with centre and error after Agresti and Coull."""
    n = sum(group.count(side) for group in groups)
    if n < LEAST_OBJECTS:
        return NOTHING
    n_unmatched = sum(group.alone(side) for group in groups)
    centre = (n_unmatched + 2) / (n + 4)
    return Estimate(n_unmatched / n, centre, math.sqrt(centre * (1 - centre) / (n + 4)))


def mean_of(classes: Sequence[ClassFindings], score: str) -> Estimate:
    """Mean of a score over the objects of some classes together, and its standard error."""
    groups = [(group.n, group.mean, group.std or 0.0) for row in classes if (group := row.of_score(score)).n]
    known = [(n, mean, std) for n, mean, std in groups if mean is not None]
    n_all = sum(n for n, _, _ in known)
    if n_all < LEAST_OBJECTS:
        return NOTHING
    mean_all = sum(n * mean for n, mean, _ in known) / n_all
    squares = sum((n - 1) * std**2 + n * (mean - mean_all) ** 2 for n, mean, std in known)
    return Estimate(mean_all, mean_all, math.sqrt(squares / (n_all - 1) / n_all))
