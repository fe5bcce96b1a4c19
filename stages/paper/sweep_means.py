"""Means of perturbation sweeps over their repeats, and the alteration that each metric reacts to most."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from ...schemas.metric_catalogue import METRIC, OBJECT_METRICS
from ..generate.perturbations import Perturbation

OWN_METRICS = (
    "r_lambda",
    "r_gap",
    "max_eigenvalue_shift",
    "laplacian_change",
    "eigenspectrum_distance",
    "cdc",
)


@dataclass(frozen=True)
class Mean:
    """Mean and standard deviation of a metric at a level over `n` repeats; None if it could not be computed."""

    mean: float | None = None
    std: float | None = None
    n: int = 0


@dataclass(frozen=True)
class Reaction:
    """A metric at the strongest level of each kind.

    values : means over the objects, in the order of the levels; None if nothing could be computed
    most : the level at which it is farthest from its value for equal objects; None if it never
        moves
    """

    metric: str
    values: tuple[float | None, ...]
    most: Perturbation | None


class Means:
    """Means of the sweeps by object, level and metric.

    Parameters
    ----------
    rows : rows of `perturb_summary`: object (None for the whole scan), kind, amount, shift_m,
        metric, mean, std, n
    """

    def __init__(self, rows: Iterable[Mapping[str, Any]]) -> None:
        self._by_key: dict[tuple[str | None, Perturbation, str], Mean] = {}
        for row in rows:
            level = Perturbation(row["kind"], row["amount"], row["shift_m"])
            self._by_key[row["object"], level, row["metric"]] = Mean(
                row["mean"],
                row["std"],
                row["n"],
            )
        self.objects = tuple(dict.fromkeys(name for name, _, _ in self._by_key if name is not None))
        self.object_metrics = {metric for name, _, metric in self._by_key if name is not None}

    def get(self, object_name: str | None, level: Perturbation, metric: str) -> Mean:
        """One mean; that of the whole scan if `object_name` is None."""
        return self._by_key.get((object_name, level, metric), Mean())

    def over_objects(self, level: Perturbation, metric: str) -> float | None:
        """Mean over the objects; None if it could be computed for none."""
        means = [self.get(name, level, metric).mean for name in self.objects]
        known = [mean for mean in means if mean is not None]
        return sum(known) / len(known) if known else None


def react(means: Means, levels: Sequence[Perturbation]) -> list[Reaction]:
    """The reaction of each of our metrics, then of the swept baseline metrics by name.

    Parameters
    ----------
    means : of the sweeps
    levels : the swept levels
    """
    strongest = strongest_levels(levels)
    reactions = []
    for metric in (*OWN_METRICS, *sorted(means.object_metrics - set(OBJECT_METRICS))):
        values = [means.over_objects(level, metric) for level in strongest]
        equal = METRIC[metric].equal or 0.0
        moved = {
            level: abs(v - equal)
            for level, v in zip(
                strongest,
                values,
                strict=True,
            )
            if v is not None
        }
        most = max(moved, key=lambda level: moved[level]) if any(moved.values()) else None
        reactions.append(Reaction(metric, tuple(values), most))
    return reactions


def strongest_levels(levels: Sequence[Perturbation]) -> list[Perturbation]:
    """The level of each kind with the largest amount; of density also the one with the smallest."""
    strongest = []
    for kind in dict.fromkeys(level.kind for level in levels):
        of_kind = [level for level in levels if level.kind == kind]
        of_kind.sort(key=lambda level: (level.amount, level.shift_m))
        if kind == "density" and of_kind[0].amount < 1 < of_kind[-1].amount:
            strongest.append(of_kind[0])
        strongest.append(of_kind[-1])
    return strongest
