"""Causes of the catalogue that the estimates of a run name."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ...schemas.cause_catalogue import CAUSES, CauseModel
from ...stages.arrays import FloatArray, IntArray
from ...stages.causes.evidence import FLAT, LOSSES, UNEVEN
from ...stages.causes.gain import Shares
from ...stages.displacement import PARAMETERS
from ...stages.statistics.comparison import block_means
from ..results.causes import mean_interval, size_words

#: Below this distance over the floor, metres, gains are not shares.
LEAST_EXCESS_M = 0.005
#: Part of what the other causes leave that a cause must explain, and a displacement, as it moves every point.
LEAST_PART, LEAST_PART_MOVED = 0.03, 0.15
#: Causes that are also looked for between the simulated scans of a run and of its floor: all that moves surface.
CHANGES = frozenset((*PARAMETERS, "missing pieces", "invented pieces", "moved pieces"))
#: Part of the intensity that is missing; without a floor only if both sides have one scale.
SCALE = "intensity scale"
_UNEVEN = 0.01  # variance between directions that is still random, and the square of the loss
#: More of the points in other places, with both of these, are a bent world.
_BENT, _ALONE = 0.03, ("missing pieces", "invented pieces")
_MELTED = 0.3  # if more of the curved surface is too flat, more than the shape of some objects is wrong
#: Solid foliage makes surface flat, by less than this part of it; boxes stop rays in foliage: one of both is named.
_FLAT_OF_SOLID = 0.25
_BLURRED = ("elevation noise", "azimuth noise")  # not named with a displacement, which blurs beams too
_ACCURACY = 0.7  # part of the resolution that covers the errors of 95 % of the estimates
_ENOUGH = 4  # blocks that all lie beyond a tolerance


@dataclass(frozen=True)
class NamedCause:
    """A cause that the pairs show, with its mean and 95 % interval.

    low, high : of Student's t over blocks of pairs, and the accuracy of the estimate, constant and in proportion to the
        amount, root of the sum of squares
    values : of the pairs, over the floor
    """

    model: CauseModel
    mean: float
    low: float
    high: float
    values: FloatArray

    @property
    def sentence(self) -> str:
        """The flaw as a sentence."""
        return self.model.words[self.mean < 0].format(size=size_words(self.mean, self.model.unit))


def name_causes(
    estimates: Sequence[Mapping[str, float]], floor: Sequence[Mapping[str, float]] | None, blocks: IntArray
) -> list[NamedCause]:
    """The causes whose interval lies beyond the tolerance, strongest first.

    Parameters
    ----------
    estimates, floor : by name of the cause, of each pair and of the same pair of a floor
    blocks : (n,) block of each pair; those of a block count as one, with their mean
    """

    def excess(name: str) -> FloatArray:
        own, base = (
            np.array([pair.get(name, np.nan) for pair in pairs]) if pairs else np.zeros(len(estimates))
            for pairs in (estimates, floor)
        )
        return 1.0 - (1.0 - own) / np.maximum(1.0 - base, 1e-9) if name in (*LOSSES, SCALE) else own - base

    named = []
    uneven, alone = np.nanmean(excess(UNEVEN)), min(np.nanmean(excess(name)) for name in _ALONE)
    for model in CAUSES.values():
        values = excess(model.name)
        is_known = ~np.isnan(values)
        if 2 * is_known.sum() < len(values):
            continue
        means = block_means(values[is_known], blocks[is_known])
        mean, low, high = mean_interval(means)
        is_bent = model.name == "moved pieces" and mean > _BENT and alone > mean / 10
        is_melted = model.name == FLAT and mean > _MELTED
        if is_bent or is_melted or (model.name in LOSSES and uneven > _UNEVEN + mean**2):
            continue
        limit = model.resolution if floor else model.tolerance
        least, most = (means.min(), means.max()) if floor and len(means) >= _ENOUGH else (low, high)
        if max(low, least) > limit or (min(high, most) < -limit and len(model.words) > 1):
            reach = float(np.linalg.norm([(high - low) / 2, _ACCURACY * model.resolution, model.relative * mean]))
            named.append(NamedCause(model, mean, mean - reach, mean + reach, values[is_known]))
    amounts = {own.model.name: own.mean for own in named}
    feigned = {*(() if amounts.keys().isdisjoint(PARAMETERS) else _BLURRED)}
    if FLAT in amounts:
        is_solid = amounts[FLAT] < _FLAT_OF_SOLID * abs(amounts.get("solid foliage", 0.0))
        feigned.add(FLAT if is_solid else "solid foliage")
    named = [own for own in named if own.model.name not in feigned]
    return sorted(named, key=lambda own: -abs(own.mean) / own.model.resolution)


#: Shares of all pairs if causes are corrected, which are given with their amounts.
Correction = Callable[[Mapping[str, float]], Sequence[Shares]]


def confirm(
    named: Sequence[NamedCause], correct: Correction, correct_changes: Correction | None = None
) -> tuple[list[NamedCause], list[NamedCause], Sequence[Shares]]:
    """The causes whose correction brings the sides closer, most important first; the others; the shares of the former.

    Something that is not in the catalogue also changes estimates, but correcting these does not remove it. So a cause
    must explain a part of the distance that the other causes leave, unless there is hardly any.

    Parameters
    ----------
    correct : shares of the distance between both sides
    correct_changes : shares of the distance between the simulated scans of the run and of its floor, which causes of
        `CHANGES` must explain first
    """
    kept, doubtful = [*named], list[NamedCause]()
    if correct_changes and (changed := [own for own in named if own.model.name in CHANGES]):
        _, doubtful, _ = confirm(changed, correct_changes)
        kept = [own for own in named if own not in doubtful]
    while True:
        found = correct({own.model.name: own.mean for own in kept})
        before_m, after_m, floor_m = np.mean([(own.before_m, own.after_m, own.floor_m) for own in found], axis=0)
        names = [own.model.name for own in kept if own.model.name in found[0].by_cause]
        gain_m = {name: float(np.mean([pair.by_cause[name] for pair in found])) for name in names}
        if before_m - floor_m < LEAST_EXCESS_M:
            return kept, doubtful, found
        least = {name: LEAST_PART_MOVED if name in PARAMETERS else LEAST_PART for name in gain_m}
        weak = [name for name, own_m in gain_m.items() if own_m <= least[name] * (own_m + after_m - floor_m)]
        if not weak:
            return sorted(kept, key=lambda own: -gain_m.get(own.model.name, 0.0)), doubtful, found
        doubtful += [own for own in kept if own.model.name in weak]
        kept = [own for own in kept if own.model.name not in weak]
