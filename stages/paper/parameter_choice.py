"""The parameter set that the data prefer by a stated rule, if they decide."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import islice
from typing import Any, NamedTuple

import numpy as np
from scipy.stats import t as student_t

from ..arrays import FloatArray
from ..statistics.comparison import holm

RULE = (
    "a value replaces the current one if its match rate is clearly higher (of several the "
    "highest), or, if no match rate is, if its r_lambda is clearly lower and its match rate not "
    "clearly lower (of several the lowest r_lambda). Clearly: by a paired t-test over the pairs "
    "at 5 %, corrected (Holm) for all tests of the experiment: without any effect some setting "
    "is replaced in under 5 % of the experiments. Delta is left out: the larger it is, the more "
    "objects match, regardless of their quality"
)
LEVEL = 0.05
LEAST_PAIRS = 3
_ROUNDING = 1e-12


class ParameterSet(NamedTuple):
    """Values of the four ablated settings: k, tau and delta in metres, diffusion time t."""

    k: int
    tau_m: float
    delta_m: float
    t: float

    def with_value(self, name: str, value: Any) -> ParameterSet:
        """A copy with another value of one parameter."""
        return self._replace(**{name: value})


@dataclass(frozen=True)
class Trial:
    """The scores under several values of one parameter.

    name : of the parameter, or "grid" for k, tau and t together
    tried : (n_sets) the parameter sets that are compared
    current : index of the current one
    match_rate, r_lambda : (n_pairs, n_sets) float64, no NaN
    """

    name: str
    tried: Sequence[ParameterSet]
    current: int
    match_rate: FloatArray
    r_lambda: FloatArray


@dataclass(frozen=True)
class Choice:
    """The choice of one parameter, or of the grid.

    name : as in its trial
    chosen : the parameter set that the rule picks
    decided : True if the data decide: for another parameter set, or that all others are worse
    text : the result in a sentence
    """

    name: str
    chosen: ParameterSet
    decided: bool
    text: str


def choose_parameters(trials: Sequence[Trial]) -> list[Choice]:
    """The choices by `RULE` of all parameters of an experiment; undecided for fewer than three pairs.

    All are tested together, because each further test is one more chance to find an effect that
    does not exist.
    """
    changes = []
    p_values: list[float | None] = []
    for trial in trials:
        for scores in (trial.match_rate, trial.r_lambda):
            change = scores - scores[:, [trial.current]]
            changes.append(change)
            p_values += [_p_value(column) for column in change.T]
    corrected = iter(holm(p_values))
    signs = [_clear_signs(change, islice(corrected, change.shape[1])) for change in changes]
    return [_choose(*signed) for signed in zip(trials, signs[::2], signs[1::2], strict=True)]


def _clear_signs(change: FloatArray, p_values: Iterable[float | None]) -> list[int]:
    """For each value 1 or -1 if the mean change is clear; else 0."""
    is_clear = [p_value is not None and p_value < LEVEL for p_value in p_values]
    return np.where(is_clear, np.sign(change.mean(axis=0)), 0).astype(int).tolist()


def _choose(trial: Trial, match_rate: Sequence[int], r_lambda: Sequence[int]) -> Choice:
    """The choice of one parameter from the signs of clear changes: 1 if a value has more than the current one."""
    name = trial.name
    current = trial.tried[trial.current]
    n_pairs = len(trial.match_rate)
    stays = f"{_named(name, current)} stays"
    if n_pairs < LEAST_PAIRS:
        text = f"the data do not decide: expected at least {LEAST_PAIRS} pairs, got {n_pairs}; {stays}"
        return Choice(name, current, False, text)
    others = [i for i in range(len(trial.tried)) if i != trial.current]
    higher = [i for i in others if match_rate[i] == 1]
    if higher:
        means = trial.match_rate.mean(axis=0)
        return _replaced(trial, "match rate", means, max(higher, key=means.item))
    not_lower = [i for i in others if match_rate[i] == 0]
    better = [i for i in not_lower if r_lambda[i] == -1]
    if better:
        means = trial.r_lambda.mean(axis=0)
        return _replaced(trial, "r_lambda", means, min(better, key=means.item))
    if all(r_lambda[i] == 1 for i in not_lower):
        return Choice(name, current, True, f"{stays}: all other values are clearly worse")
    text = f"the data do not decide: no other value is clearly better; {stays}"
    return Choice(name, current, False, text)


def _replaced(trial: Trial, score: str, means: FloatArray, best: int) -> Choice:
    """The best value instead of the current one."""
    chosen = trial.tried[best]
    current = trial.tried[trial.current]
    text = f"{_named(trial.name, chosen)} instead of {_named(trial.name, current)}: "
    text += f"{score} {means[best]:.3f} against {means[trial.current]:.3f}"
    return Choice(trial.name, chosen, True, text)


def _p_value(change: FloatArray) -> float | None:
    """Two-sided p of a paired t-test; None if there is nothing to test."""
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
