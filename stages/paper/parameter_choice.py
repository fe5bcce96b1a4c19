"""Which parameter set the data prefer, by a stated rule, and whether they decide at all."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import t as student_t

from ..arrays import FloatArray
from ..statistics.comparison import holm

RULE = (
    "a value replaces the one in force if its match rate is clearly higher (of several the highest), or, where none "
    "is, if its r_lambda is clearly lower and its match rate not clearly lower (of several the lowest r_lambda). "
    "Clearly: by a paired t-test over the pairs at 5 %, corrected (Holm) for all tests of the experiment: without any "
    "effect some setting is replaced in under 5 % of the experiments. Delta is left out: the larger it is, the more "
    "objects match, whatever their worth"
)
LEVEL = 0.05
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
class Trial:
    """The scores under several values of one parameter.

    name : of the parameter, or "grid"
    tried : (n_sets) the parameter sets that are compared
    now : place of the one in force
    match_rate, r_lambda : (n_pairs, n_sets) float64, no NaN
    """

    name: str
    tried: Sequence[ParameterSet]
    now: int
    match_rate: FloatArray
    r_lambda: FloatArray

    def scores(self) -> tuple[FloatArray, FloatArray]:
        """Both scores."""
        return self.match_rate, self.r_lambda


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


def judge_parameters(trials: Sequence[Trial]) -> list[Verdict]:
    """The verdicts of `RULE` on all parameters of an experiment; undecided for fewer than three pairs.

    They are judged together, because each further test is one more chance to find an effect where there is none.
    """
    changes = [_changes(trial) for trial in trials]
    p_values = [_p_value(change) for of_trial in changes for of_score in of_trial for change in of_score]
    is_clear = iter([p is not None and p < LEVEL for p in holm(p_values)])
    signs = [
        [[int(np.sign(change.mean())) if next(is_clear) else 0 for change in of_score] for of_score in of_trial]
        for of_trial in changes
    ]
    return [_verdict(trial, *own) for trial, own in zip(trials, signs, strict=True)]


def _verdict(trial: Trial, match_rate: Sequence[int], r_lambda: Sequence[int]) -> Verdict:
    """The verdict on one parameter, of the signs of what is clear: 1 where a value has more than the one in force."""
    name, tried, now = trial.name, trial.tried, trial.now
    n_pairs, here = len(trial.match_rate), _named(name, tried[now])
    if n_pairs < LEAST_PAIRS:
        few = f"{n_pairs} pair{'s' * (n_pairs != 1)}, at least {LEAST_PAIRS} are needed"
        return Verdict(name, tried[now], False, f"the data do not decide: {few}; {here} stays")
    others = [i for i in range(len(tried)) if i != now]
    higher, lower = ([i for i in others if match_rate[i] == sign] for sign in (1, -1))
    nearer = [i for i in others if i not in lower and r_lambda[i] == -1]
    farther = [i for i in others if r_lambda[i] == 1]
    for winners, values, score, sign in (
        (higher, trial.match_rate, "match rate", 1),
        (nearer, trial.r_lambda, "r_lambda", -1),
    ):
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


def _changes(trial: Trial) -> list[list[FloatArray]]:
    """Of match rate and of r_lambda, by value that was tried: its scores less those of the one in force, by pair."""
    return [[(values - values[:, [trial.now]])[:, i] for i in range(values.shape[1])] for values in trial.scores()]


def _p_value(change: FloatArray) -> float | None:
    """Two-sided p of a paired t-test; None where there is nothing to test."""
    if len(change) < LEAST_PAIRS or np.abs(change).max() < _ROUNDING:
        return None
    error = change.std(ddof=1) / np.sqrt(len(change))
    if error < _ROUNDING:
        return 0.0
    return 2 * float(student_t.sf(abs(change.mean()) / error, len(change) - 1))


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
