"""Which setting the data prefer, by a stated rule, and whether they decide at all."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
from scipy.stats import t as student_t

from ....stages.arrays import FloatArray
from .ablate import PARAMETERS, AblateOutcome, Point

RULE = (
    "a value replaces the one in force if its match rate is clearly higher (of several the highest), or, where none "
    "is, if its r_lambda is clearly lower and its match rate not clearly lower (of several the lowest r_lambda). "
    "Clearly: by a one-sided paired t-test over the pairs at 2.5 %, divided by the number of other values. Delta is "
    "left out: the larger it is, the more objects match, whatever their worth"
)
LEVEL = 0.025
#: The settings that the rule can choose.
CHOSEN = tuple(name for name in PARAMETERS if name != "delta_m")
LEAST_PAIRS = 3
_ROUNDING = 1e-12


@dataclass(frozen=True)
class Verdict:
    """What the data say of one parameter, or of the grid.

    name : the parameter, "grid" for k, tau and t together
    chosen : the point that the rule picks
    decided : whether the data decide: for another point, or that all others are worse
    words : the verdict in a sentence
    """

    name: str
    chosen: Point
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


def choose(outcome: AblateOutcome) -> list[Verdict]:
    """A verdict for each parameter that the rule can choose and that has several values, and for the grid."""
    table = outcome.rows.to_pandas()
    names = [name for name in CHOSEN if len(outcome.values[name]) > 1]
    verdicts = [_verdict(name, table, along(outcome, name), outcome.base) for name in names]
    if outcome.grid:
        points = [
            Point(*row) for row in table[["k", "tau_m", "delta_m", "t"]].drop_duplicates().itertuples(index=False)
        ]
        verdicts.append(
            _verdict("grid", table, [point for point in points if point.delta_m == outcome.base.delta_m], outcome.base)
        )
    return verdicts


def along(outcome: AblateOutcome, name: str) -> list[Point]:
    """The points at which one parameter moves and the others are in force."""
    return [Point(**(vars(outcome.base) | {name: value})) for value in outcome.values[name]]


def influences(outcome: AblateOutcome) -> list[Influence]:
    """How far match rate and r_lambda move with each parameter; needs two pairs and two values of it."""
    table = outcome.rows.to_pandas()
    moves = []
    for name in PARAMETERS:
        points = along(outcome, name)
        for metric in ("match_rate", "r_lambda_mean"):
            values = _by_pair(table, points, metric)
            if values.shape[0] > 1 and len(points) > 1:
                means = values.mean(axis=0)
                at_base = values[:, points.index(outcome.base)]
                moves.append(Influence(name, metric, float(np.ptp(means)), float(at_base.std(ddof=1))))
    return moves


def _verdict(name: str, table: pd.DataFrame, points: Sequence[Point], base: Point) -> Verdict:
    rate, r_lambda = (_by_pair(table, points, metric) for metric in ("match_rate", "r_lambda_mean"))
    n_pairs, here = len(rate), _named(name, base)
    if n_pairs < LEAST_PAIRS:
        few = f"{n_pairs} pair{'s' * (n_pairs != 1)}, at least {LEAST_PAIRS} are needed"
        return Verdict(name, base, False, f"the data do not decide: {few}; {here} stays")
    now = points.index(base)
    others = [i for i in range(len(points)) if i != now]
    level = LEVEL / max(len(others), 1)
    higher = [i for i in others if _is_clear(rate[:, i] - rate[:, now], level)]
    lower = [i for i in others if _is_clear(rate[:, now] - rate[:, i], level)]
    nearer = [i for i in others if i not in lower and _is_clear(r_lambda[:, now] - r_lambda[:, i], level)]
    farther = [i for i in others if _is_clear(r_lambda[:, i] - r_lambda[:, now], level)]
    for winners, values, score, best_of in (
        (higher, rate, "match rate", np.argmax),
        (nearer, r_lambda, "r_lambda", np.argmin),
    ):
        if winners:
            means = values.mean(axis=0)
            best = winners[int(best_of(means[winners]))]
            words = (
                f"{_named(name, points[best])} instead of {here}: {score} {means[best]:.3f} against {means[now]:.3f}"
            )
            rest = [points[i] for i in winners if i != best]
            return Verdict(
                name, points[best], True, words + (f" (clearly better too: {_listed(name, rest)})" if rest else "")
            )
    if set(others) <= set(lower) | set(farther):
        return Verdict(name, base, True, f"{here} stays: all other values are clearly worse")
    return Verdict(name, base, False, f"the data do not decide: no other value is clearly better; {here} stays")


def _is_clear(difference: FloatArray, level: float) -> bool:
    """Whether a paired difference is above 0 beyond chance."""
    error = difference.std(ddof=1) / np.sqrt(len(difference))
    return bool(difference.mean() > max(student_t.isf(level, len(difference) - 1) * error, _ROUNDING))


def _by_pair(table: pd.DataFrame, points: Sequence[Point], metric: str) -> FloatArray:
    """(n_pairs, n_points) values; pairs in which one is missing are left out."""
    wide = table.set_index(["pair_id", "k", "tau_m", "delta_m", "t"])[metric].unstack(["k", "tau_m", "delta_m", "t"])
    columns = [(point.k, point.tau_m, point.delta_m, point.t) for point in points]
    values: FloatArray = wide.reindex(columns=pd.MultiIndex.from_tuples(columns)).dropna().to_numpy(dtype=np.float64)
    return values


def _named(name: str, point: Point) -> str:
    if name == "grid":
        return f"(k {point.k}, tau {point.tau_m:g} m, delta {point.delta_m:g} m, t {point.t:g})"
    unit = " m" if name.endswith("_m") else ""
    return f"{name.removesuffix('_m')} = {getattr(point, name):g}{unit}"


def _listed(name: str, points: Sequence[Point]) -> str:
    if name == "grid":
        return f"{len(points)} of the combinations"
    values = [f"{getattr(point, name):g}" for point in points]
    return f"{', '.join(values[:-1])} and {values[-1]}" if len(values) > 1 else values[0]
