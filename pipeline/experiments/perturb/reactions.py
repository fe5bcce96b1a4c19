"""Which metric reacts to which alteration: ours and the baselines side by side."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import pyarrow as pa

from ....schemas.metrics import METRIC, OBJECT_METRICS
from ....stages.sensing.perturbations import Perturbation
from .claims import Means

OWN_METRICS = (
    "r_lambda",
    "r_gap",
    "max_eigenvalue_shift",
    "laplacian_change",
    "eigenspectrum_distance",
    "cdc",
)


@dataclass(frozen=True)
class Reaction:
    """A metric at the strongest level of each kind.

    values : means over the objects, in the order of the levels; None where nothing could be computed
    most : the level at which it is farthest from its value for equal objects; None where it never moves
    """

    metric: str
    values: tuple[float | None, ...]
    most: Perturbation | None


def react(summary: pa.Table, levels: Sequence[Perturbation]) -> list[Reaction]:
    """How each metric answers: our own, then the baselines that were swept, by name.

    Parameters
    ----------
    summary : rows of `perturb_summary`
    levels : that were swept
    """
    means, strongest = Means(summary), strongest_levels(levels)
    swept = {row["metric"] for row in summary.to_pylist() if row["scope"] == "object"}
    reactions = []
    for metric in (*OWN_METRICS, *sorted(swept - set(OBJECT_METRICS))):
        values = []
        for level in strongest:
            of_objects = [value for name in means.objects for value in means.series(name, [level], metric)]
            values.append(sum(of_objects) / len(of_objects) if of_objects else None)
        equal = METRIC[metric].equal or 0.0
        moved = {level: abs(v - equal) for level, v in zip(strongest, values, strict=True) if v is not None}
        most = max(moved, key=lambda level: moved[level]) if any(moved.values()) else None
        reactions.append(Reaction(metric, tuple(values), most))
    return reactions


def strongest_levels(levels: Sequence[Perturbation]) -> list[Perturbation]:
    """Of each kind the level with the largest amount; of density also the one with the smallest."""
    strongest = []
    for kind in dict.fromkeys(level.kind for level in levels):
        own = sorted((level for level in levels if level.kind == kind), key=lambda level: (level.amount, level.shift_m))
        if kind == "density" and own[0].amount < 1 < own[-1].amount:
            strongest.append(own[0])
        strongest.append(own[-1])
    return strongest
