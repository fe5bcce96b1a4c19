"""Which setting the data prefer, by a stated rule, and whether they decide at all.

Leaves to others: the numbers (`ablate`), how the verdict is shown (`report`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd

from ...stages.arrays import FloatArray
from .ablate import PARAMETERS, AblateOutcome, Point

RULE = (
    "keep the values whose match rate is not clearly below the highest; of these, those whose r_lambda is not clearly "
    "above the lowest. Clearly: the mean difference over pairs is more than two of its standard errors. If the value "
    "in force is left, it stays"
)
CLEAR_ERRORS = 2.0
LEAST_PAIRS = 3


@dataclass(frozen=True)
class Verdict:
    """What the data say of one parameter, or of the grid.

    name : the parameter, "grid" for all four
    chosen : the point that the rule picks
    left : all points that the rule leaves
    decided : whether it left one alone
    words : the verdict in a sentence
    """

    name: str
    chosen: Point
    left: tuple[Point, ...]
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
    """A verdict for each parameter that has several values, and for the grid if there is one."""
    table = outcome.rows.to_pandas()
    names = [name for name in PARAMETERS if len(outcome.values[name]) > 1]
    verdicts = [_verdict(name, table, along(outcome, name), outcome.base) for name in names]
    if outcome.grid:
        points = [Point(*of) for of in table[["k", "tau_m", "delta_m", "t"]].drop_duplicates().itertuples(index=False)]
        verdicts.append(_verdict("grid", table, points, outcome.base))
    return verdicts


def along(outcome: AblateOutcome, name: str) -> list[Point]:
    """The points at which one parameter moves and the others are in force."""
    return [Point(**(vars(outcome.base) | {name: value})) for value in outcome.values[name]]


def influences(outcome: AblateOutcome) -> list[Influence]:
    """How far match rate and r_lambda move with each parameter."""
    table = outcome.rows.to_pandas()
    found = []
    for name in PARAMETERS:
        points = along(outcome, name)
        for metric in ("match_rate", "r_lambda_mean"):
            values = _by_pair(table, points, metric)
            if values.shape[0] > 1 and len(points) > 1:
                means = values.mean(axis=0)
                at_base = values[:, points.index(outcome.base)]
                found.append(Influence(name, metric, float(np.ptp(means)), float(at_base.std(ddof=1))))
    return found


def _verdict(name: str, table: pd.DataFrame, points: Sequence[Point], base: Point) -> Verdict:
    rate, r_lambda = (_by_pair(table, points, metric) for metric in ("match_rate", "r_lambda_mean"))
    n_pairs = len(rate)
    if n_pairs < LEAST_PAIRS:
        words = (
            f"the data do not decide: {n_pairs} pairs, at least {LEAST_PAIRS} are needed; {_named(name, base)} stays"
        )
        return Verdict(name, base, tuple(points), False, words)
    high = _not_clearly_worse(-rate, range(len(points)))
    left = _not_clearly_worse(r_lambda, high)
    kept = tuple(points[i] for i in left)
    others = [point for point in kept if point != base]
    means = r_lambda.mean(axis=0)
    chosen = base if base in kept else points[min(left, key=lambda i: means[i])]
    here = _named(name, base)
    if chosen == base and not others:
        words = f"{here} stays: all other values are clearly worse"
    elif chosen == base:
        words = f"the data do not decide between {_listed(name, kept)}; {here} stays"
    else:
        words = f"{_named(name, chosen)} instead of {here}: {_why(points, base, high, rate, r_lambda, chosen)}"
        if len(kept) > 1:
            words += f"; the data do not decide between {_listed(name, kept)}, the lowest r_lambda is taken"
    return Verdict(name, chosen, kept, len(kept) == 1, words)


def _not_clearly_worse(cost: FloatArray, among: Sequence[int]) -> list[int]:
    """The columns of least mean cost and those that are not clearly above it.

    Parameters
    ----------
    cost : (n_pairs, n_points), less is better
    among : columns that are looked at
    """
    best = min(among, key=lambda i: cost[:, i].mean())
    return [i for i in among if not _is_clear(cost[:, i] - cost[:, best])]


def _is_clear(difference: FloatArray) -> bool:
    error = difference.std(ddof=1) / np.sqrt(len(difference))
    return bool(difference.mean() > CLEAR_ERRORS * error and difference.mean() > 0)


def _why(
    points: Sequence[Point],
    base: Point,
    high: Sequence[int],
    rate: FloatArray,
    r_lambda: FloatArray,
    chosen: Point,
) -> str:
    """Which of the two steps the value in force lost in, and by how much."""
    now, then = points.index(base), points.index(chosen)
    if now not in high:
        best = max(high, key=lambda i: rate[:, i].mean())
        return f"match rate {rate[:, now].mean():.3f} against up to {rate[:, best].mean():.3f}"
    return f"r_lambda {r_lambda[:, now].mean():.3f} against {r_lambda[:, then].mean():.3f}"


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
