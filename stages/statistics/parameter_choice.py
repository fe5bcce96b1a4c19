"""Which parameter set the data prefer, by a stated rule, and whether they decide at all."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import t as student_t

from ..arrays import FloatArray

RULE = (
    "a value replaces the one in force if its match rate is clearly higher (of several the highest), or, where none "
    "is, if its r_lambda is clearly lower and its match rate not clearly lower (of several the lowest r_lambda). "
    "Clearly: by a one-sided paired t-test over the pairs at 2.5 %, divided by the number of other values. Delta is "
    "left out: the larger it is, the more objects match, whatever their worth"
)
LEVEL = 0.025
LEAST_PAIRS = 3
_ROUNDING = 1e-12


@dataclass(frozen=True, order=True)
class ParameterSet:
    """One choice of the four settings: k, tau and delta in metres, diffusion time t."""

    k: int
    tau_m: float
    delta_m: float
    t: float

    def moved(self, name: str, value: float) -> ParameterSet:
        """The same with another value of one parameter."""
        return ParameterSet(**(vars(self) | {name: value}))


@dataclass(frozen=True)
class Verdict:
    """What the data say of one parameter, or of the grid.

    name : the parameter, "grid" for k, tau and t together
    chosen : the parameter set that the rule picks
    decided : whether the data decide: for another parameter set, or that all others are worse
    words : the verdict in a sentence
    """

    name: str
    chosen: ParameterSet
    decided: bool
    words: str


@dataclass(frozen=True)
class Influence:
    """How far a metric moves over the values of a parameter, beside its spread over pairs."""

    name: str
    metric: str
    range_of_means: float
    std_over_pairs: float

    @property
    def is_within_spread(self) -> bool:
        """Whether it moves less than the pairs differ."""
        return self.range_of_means < self.std_over_pairs


def influence(name: str, metric: str, values: FloatArray, now: int) -> Influence | None:
    """How far the mean of a metric moves over the values of a parameter; None for fewer than two pairs or values.

    Parameters
    ----------
    values : (n_pairs, n_values) float64, no NaN
    now : column of the value in force, whose standard deviation (n - 1) over pairs is taken
    """
    if min(values.shape) < 2:
        return None
    return Influence(name, metric, float(np.ptp(values.mean(axis=0))), float(values[:, now].std(ddof=1)))


def judge_parameter(
    name: str, tried: Sequence[ParameterSet], now: int, match_rate: FloatArray, r_lambda: FloatArray
) -> Verdict:
    """The verdict of `RULE`; undecided for fewer than three pairs.

    Parameters
    ----------
    name : of the parameter, or "grid"
    tried : (n_sets) the parameter sets that are compared
    now : place of the one in force
    match_rate, r_lambda : (n_pairs, n_sets) float64, no NaN
    """
    n_pairs, here = len(match_rate), _named(name, tried[now])
    if n_pairs < LEAST_PAIRS:
        few = f"{n_pairs} pair{'s' * (n_pairs != 1)}, at least {LEAST_PAIRS} are needed"
        return Verdict(name, tried[now], False, f"the data do not decide: {few}; {here} stays")
    others = [i for i in range(len(tried)) if i != now]
    level = LEVEL / max(len(others), 1)
    higher = [i for i in others if _is_clear(match_rate[:, i] - match_rate[:, now], level)]
    lower = [i for i in others if _is_clear(match_rate[:, now] - match_rate[:, i], level)]
    nearer = [i for i in others if i not in lower and _is_clear(r_lambda[:, now] - r_lambda[:, i], level)]
    farther = [i for i in others if _is_clear(r_lambda[:, i] - r_lambda[:, now], level)]
    for winners, values, score, sign in ((higher, match_rate, "match rate", 1), (nearer, r_lambda, "r_lambda", -1)):
        if winners:
            means = values.mean(axis=0)
            best = winners[int(np.argmax(sign * means[winners]))]
            words = f"{_named(name, tried[best])} instead of {here}: {score} {means[best]:.3f} against {means[now]:.3f}"
            rest = [tried[i] for i in winners if i != best]
            also = f" (clearly better too: {_listed(name, rest)})" if rest else ""
            return Verdict(name, tried[best], True, words + also)
    if set(others) <= set(lower) | set(farther):
        return Verdict(name, tried[now], True, f"{here} stays: all other values are clearly worse")
    return Verdict(name, tried[now], False, f"the data do not decide: no other value is clearly better; {here} stays")


def _is_clear(difference: FloatArray, level: float) -> bool:
    """Whether a paired difference is above 0 beyond chance."""
    error = difference.std(ddof=1) / np.sqrt(len(difference))
    return bool(difference.mean() > max(student_t.isf(level, len(difference) - 1) * error, _ROUNDING))


def _named(name: str, choice: ParameterSet) -> str:
    if name == "grid":
        return f"(k {choice.k}, tau {choice.tau_m:g} m, delta {choice.delta_m:g} m, t {choice.t:g})"
    unit = " m" if name.endswith("_m") else ""
    return f"{name.removesuffix('_m')} = {getattr(choice, name):g}{unit}"


def _listed(name: str, choices: Sequence[ParameterSet]) -> str:
    if name == "grid":
        return f"{len(choices)} of the combinations"
    *values, last = [f"{getattr(choice, name):g}" for choice in choices]
    return f"{', '.join(values)} and {last}" if values else last
