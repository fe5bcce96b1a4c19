"""Families of scores that `compare` decides together: each is one question that a user asks about a simulator.

The two coverages are read together. A simulator that loses points also invents less, one that scatters points
everywhere also covers more, and both change the mean over the objects that are left. So an improvement that lost or
invented surface explains is shown with its reason and does not count.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ...schemas.columns import Row
from ...schemas.data_files import read_rows
from ...schemas.metric_catalogue import COVERAGE_REACHES, metric_of
from ...stages.arrays import FloatArray, IntArray
from ...stages.statistics.comparison import (
    ALIKE,
    CONFIDENCE,
    Difference,
    adjusted_p_values,
    block_means,
    holm,
    paired_difference,
)
from .causes import CAUSE_KINDS, Columns
from .displaced import MovedWorld

PairRows = Mapping[str, tuple[Row, Row]]  #: by pair, its rows before and after
#: Changes that chance makes in under this share of the comparisons are decided.
ERROR_RATE = 1 - CONFIDENCE
#: Roughness says nothing if the number of simulated points changed by more than this share.
SAME_DENSITY = 0.05
SURFACE_MISSING, SURFACE_INVENTED, POSITION, OBJECTS = "surface missing", "surface invented", "position", "objects"
RAYS = "rays"
LOST, EXTRA, IN_FRONT, BEHIND = "returns lost", "returns added", "simulated in front", "simulated behind"
#: Scores of rays of which one can improve at the cost of the other.
OPPOSED = {LOST: EXTRA, EXTRA: LOST, IN_FRONT: BEHIND, BEHIND: IN_FRONT}
#: Distance from a perfect simulator, by the value that is best.
ERRORS: dict[str, Callable[[FloatArray], FloatArray]] = {
    "high": np.negative,
    "low": np.positive,
    "zero": np.abs,
    "one": lambda ratio: np.abs(np.log(np.where(ratio > 0, ratio, np.nan))),
}
#: The same in headings.
MARKS = {"high": "↑", "low": "↓", "zero": "→0", "one": "→1"}
MARKS_NOTE = "↑ higher is better, ↓ lower is better, →0 and →1 nearer to it is better (simulated minus, or over, real)"


@dataclass(frozen=True)
class ComparedScore:
    """One score of pairs, a row of `schemas/compared_scores.csv`.

    preset : whose runs have it; "" for all
    heading : with the unit
    how : its value: the column itself (""), `columns` "minus" or "over" `others`, their "share" in the sum of both, or
        of a "cause" (`causes`) simulated minus real; tested with its sign, NaN if null
    best : key of `ERRORS`
    least : a change of the mean up to this size does not matter to a user
    step : smallest step of the value, such as 1 for a count
    error : columns whose length says which way is better, if that is not the value
    is_direct : False if it also depends on how dense the points are, so that alone it cannot show an improvement
    """

    family: str
    preset: str
    heading: str
    how: str
    columns: list[str]
    others: list[str]
    best: str
    least: float
    step: float
    error: list[str]
    is_direct: bool

    def value(self, pairs: Columns) -> FloatArray:
        """Value of each pair."""
        if self.how == "cause":
            return CAUSE_KINDS[" ".join(self.columns)].value(pairs)
        own, rest = (np.sum([pairs[name] for name in names], axis=0) for names in (self.columns, self.others))
        if self.how == "minus":
            return np.asarray(own - rest)
        if self.how:
            rest = own + rest if self.how == "share" else rest
            return np.asarray(own / np.where(rest > 0, rest, np.nan))
        return np.asarray(own)

    def distance(self, pairs: Columns) -> FloatArray:
        """Distance from a perfect simulator; NaN if null."""
        if not self.error:
            return ERRORS[self.best](self.value(pairs))
        parts = np.stack([pairs[name] for name in self.error])  # those that are known
        return np.where(np.isnan(parts).all(axis=0), np.nan, np.sqrt(np.nansum(parts**2, axis=0)))


def _read_scores() -> Iterator[ComparedScore]:
    for row in read_rows("compared_scores"):
        values: dict[str, Any] = row | {name: row[name].split() for name in ("columns", "others", "error")}
        values |= {name: float(row[name] or 0) for name in ("least", "step")}
        values |= {"heading": row["heading"] or metric_of(row["columns"]).label, "is_direct": bool(row["is_direct"])}
        yield ComparedScore(**values)


_SCORES = tuple(_read_scores())


def families(preset: str) -> dict[str, list[ComparedScore]]:
    """The scores of each family, by its name; the first represents it over many runs that decide no score.

    Parameters
    ----------
    preset : of both runs; "paper" compares the match rate in place of the share of real objects that are found
    """
    chosen: dict[str, list[ComparedScore]] = {}
    for score in _SCORES:
        if score.preset in ("", "paper" if preset == "paper" else "reference"):
            chosen.setdefault(score.family, []).append(score)
    return chosen


@dataclass(frozen=True)
class ScoreChange:
    """A score before and after.

    name, mark : heading and direction of good
    verdict : better, worse, undecided, or same if it changes by no more than matters
    p : adjusted for the scores of its family (maxT), not for the other families; None if it cannot be tested
    towards : direction in which it moved, better or worse, decided or not; "" if it did not move
    why : reason for which its verdict does not count; "" if it counts
    is_direct : see `ComparedScore`
    of_pairs : by pair, after minus before; None if a value is null
    seed_noise : largest difference of the two means that Louvain seeds alone make in 95 % of the cases; None if unknown
    floor : distance of the floor's mean from equal scans; None if unknown
    """

    name: str
    mark: str
    difference: Difference
    verdict: str
    p: float | None
    towards: str
    is_direct: bool
    of_pairs: dict[str, float | None]
    seed_noise: float | None = None
    floor: float | None = None
    why: str = ""

    @property
    def clarity(self) -> float:
        """Change in standard deviations of the blocks' changes."""
        return self.difference.size / (self.difference.std or math.inf)

    def exceeds(self, least: float | None) -> bool | None:
        """True if the difference is larger than `seed_noise` or `floor`; None if one of them is unknown."""
        change = self.difference.difference
        return None if least is None or change is None else abs(change) > least


@dataclass(frozen=True)
class FamilyChange:
    """The decision of one family.

    verdict : better, worse, mixed, same or undecided
    p : smallest of its scores, adjusted for all families (Holm); None if no score can be tested
    why : reason for which the verdict does not count in the overall decision; "" if it counts
    tendency : worse or better if it is not decided and p before Holm is below 5 %, else ""
    scores : those that have values, the one that changed most clearly first
    """

    name: str
    verdict: str
    p: float | None
    why: str
    tendency: str
    scores: tuple[ScoreChange, ...]

    @property
    def called(self) -> str:
        """The verdict as it is shown, in brackets if it does not count."""
        return f"({self.verdict})" if self.why else self.verdict


def judge_families(
    preset: str,
    rows: PairRows,
    blocks: IntArray,
    seed_noise: Mapping[str, float | None] | None = None,
    floors: Mapping[str, float | None] | None = None,
    sectors: tuple[PairRows, IntArray] | None = None,
    world: MovedWorld | None = None,
) -> tuple[FamilyChange, ...]:
    """The families with their verdicts; of equal simulators any is better or worse in under 5 % of the comparisons.

    A family is decided if the smallest adjusted p of its scores is below 5 % after Holm over the families; those in
    which nothing changes take no share. Each score of a decided family with p below 5 % is better or worse by its mean
    distance from a perfect simulator.

    Parameters
    ----------
    preset : of both runs
    rows : by pair, its rows of `pairs` before and after
    blocks : (n,) block of each pair
    seed_noise, floors : by column of `pairs`, see `ScoreChange`
    sectors : rows of the sectors of all pairs (`sectors.sector_rows`) and the block of each, where neighbouring frames
        leave few blocks. A change must then be consistent over the sectors of the places, and over the frames, too
    world : what moved between the simulated scans, if it is known
    """
    noise, floors, pairs = seed_noise or {}, floors or {}, _columns(rows)
    parts = None if sectors is None else (_columns(sectors[0]), sectors[1])
    found = [
        FamilyChange(name, "undecided", None, "", "", _changes(compared, [*rows], pairs, blocks, noise, floors, parts))
        for name, compared in families(preset).items()
    ]
    found = [family for family in found if family.scores]
    lowest = [min((score.p for score in family.scores if score.p is not None), default=None) for family in found]
    for i, (p, before_holm) in enumerate(zip(holm(lowest), lowest, strict=True)):
        scores = found[i].scores
        if p is not None and p < ERROR_RATE:
            scores = tuple(
                replace(score, verdict=score.towards)
                if score.p is not None and score.p < ERROR_RATE and score.exceeds(score.seed_noise) is not False
                else score
                for score in scores
            )
        tends = before_holm is not None and before_holm < ERROR_RATE
        found[i] = replace(found[i], p=p, tendency=scores[0].towards if tends else "", scores=scores)
    called = {family.name: {score.verdict for score in family.scores} for family in found}
    better, worse = (
        {name for name in (SURFACE_MISSING, SURFACE_INVENTED) if word in called.get(name, ())}
        for word in ("better", "worse")
    )
    decided = {name for name, words in called.items() if {"better", "worse"} & words}
    is_scaled = world is not None and world.ranges_alone and RAYS in decided
    moved = _Moved(better, worse, POSITION in decided and not is_scaled, is_scaled, *_points_change(pairs))
    return tuple(_decided(family, moved) for family in found)


def _changes(
    compared: Sequence[ComparedScore],
    pair_ids: Sequence[str],
    pairs: Sequence[Columns],
    blocks: IntArray,
    seed_noise: Mapping[str, float | None],
    floors: Mapping[str, float | None],
    sectors: tuple[Sequence[Columns], IntArray] | None,
) -> tuple[ScoreChange, ...]:
    """The scores of a family that have values, without verdicts, the most clearly changed first."""
    values = _read([score.value for score in compared], pairs)
    change, worse_by = (np.diff(own)[..., 0] for own in (values, _read([score.distance for score in compared], pairs)))
    least, step = (np.array([getattr(score, field) for score in compared]) for field in ("least", "step"))
    p_values = adjusted_p_values(block_means(change, blocks), least, step)
    if sectors is not None:
        parts = np.diff(_read([score.value for score in compared], sectors[0]))[..., 0]
        parts = block_means(parts, sectors[1])
        with_parts = ~np.isnan(parts).all(axis=1)
        by_sector = adjusted_p_values(parts[with_parts], least[with_parts], np.zeros(with_parts.sum()))
        p_values[with_parts] = np.maximum(p_values[with_parts], by_sector)
    scores = []
    for i, score in enumerate(compared):
        own = paired_difference(values[i, :, 0], values[i, :, 1], blocks)
        if own.n_pairs:
            column = "" if score.how else score.columns[0]
            towards = ("worse" if np.nanmean(worse_by[i]) > 0 else "better") if own.size > ALIKE else ""
            is_same = own.low == own.high == 0 or (own.n_blocks > 1 and bool(np.isnan(p_values[i])))
            scores.append(
                ScoreChange(
                    name=score.heading,
                    mark=MARKS[score.best],
                    difference=own,
                    verdict="same" if is_same else "undecided",
                    p=None if is_same or np.isnan(p_values[i]) else float(p_values[i]),
                    towards="" if is_same else towards,
                    is_direct=score.is_direct,
                    of_pairs={
                        name: None if math.isnan(x) else x for name, x in zip(pair_ids, change[i].tolist(), strict=True)
                    },
                    seed_noise=seed_noise.get(column),
                    floor=floors.get(column),
                )
            )
    return tuple(sorted(scores, key=lambda score: (2.0 if score.p is None else score.p, -score.clarity)))


def _columns(rows: PairRows) -> list[Columns]:
    """Before and after."""
    return [Columns(own) for own in zip(*rows.values(), strict=True)]


def _read(reads: Sequence[Callable[[Columns], FloatArray]], pairs: Sequence[Columns]) -> FloatArray:
    """(m, n, 2) by score and pair, before and after; NaN if null."""
    return np.stack([[read(own) for read in reads] for own in pairs], axis=-1)


@dataclass(frozen=True)
class _Moved:
    """Decided changes of other families.

    better, worse, is_displaced : surfaces, and the position
    is_scaled : ranges alone became longer or shorter
    right, invented, density : mean changes of the numbers of right and of invented simulated points, and of all
        relative to before
    """

    better: set[str]
    worse: set[str]
    is_displaced: bool
    is_scaled: bool
    right: float
    invented: float
    density: float


def _points_change(pairs: Sequence[Columns]) -> tuple[float, float, float]:
    """See `_Moved`."""
    counts = []
    for own in pairs:
        n = own["n_sim_points"]
        right = n * np.mean([own[f"covered_sim_{reach}"] for reach in COVERAGE_REACHES], axis=0)
        counts.append([right.mean(), (n - right).mean(), n.mean()])
    before, after = counts
    return after[0] - before[0], after[1] - before[1], after[2] / before[2] - 1


def _decided(family: FamilyChange, moved: _Moved) -> FamilyChange:
    """The family with its verdict, and with reasons for which verdicts do not count."""
    scores = tuple(
        replace(score, why=_of_rays(family, score, moved) or _consequence(family.name, score, moved))
        if score.verdict in ("better", "worse")
        else score
        for score in family.scores
    )
    called = {score.verdict for score in scores if not score.why} & {"better", "worse"}
    hidden = [score for score in scores if score.why]
    if called:
        verdict, why = ("mixed" if len(called) == 2 else called.pop()), ""
    elif hidden:
        verdict, why = hidden[0].verdict, hidden[0].why
    else:
        verdict, why = ("same" if {score.verdict for score in scores} == {"same"} else "undecided"), ""
    tendency = family.tendency if verdict == "undecided" else ""
    return replace(family, verdict=verdict, why=why, tendency=tendency, scores=scores)


def _of_rays(family: FamilyChange, score: ScoreChange, moved: _Moved) -> str:
    """The reason for which the verdict of a score of rays does not count; "" if it does, or for other scores.

    A displaced simulation is paired with other rays. Lost and added returns, and simulated returns in front of and
    behind the real ones, are opposed: if they move in opposite directions, only that of their sum counts.
    """
    if family.name != RAYS:
        return ""
    if moved.is_displaced:
        return "a displaced simulation is paired with other rays"
    other = next((own for own in family.scores if own.name == OPPOSED.get(score.name)), None)
    if other is None or {score.verdict, other.verdict} != {"better", "worse"}:
        return ""
    net = (score.difference.difference or 0.0) + (other.difference.difference or 0.0)
    is_main = net > 0 if score.verdict == "worse" else net < 0
    return "" if is_main else f"follows from {other.name}"


def _consequence(family: str, score: ScoreChange, moved: _Moved) -> str:
    """The reason for which the verdict of a score does not count; "" if it does.

    An improvement of a surface next to a loss of the other one counts only if the number of right simulated points grew
    by more than half of that of the invented ones, or fell by less.
    """
    if not score.is_direct:
        if abs(moved.density) > SAME_DENSITY:
            return "follows from the number of points"
        if score.verdict == "better" or moved.better:
            return "roughness alone is not fidelity"
    if family == POSITION and moved.is_scaled:
        return f"follows from {RAYS}: longer or shorter ranges alone"
    if score.verdict == "worse" or not moved.worse:
        return ""
    if family == POSITION and len(moved.worse) == 2:
        return "both surfaces lie farther apart"
    is_surface = family in (SURFACE_MISSING, SURFACE_INVENTED)
    follows = family == OBJECTS or (is_surface and moved.right <= moved.invented / 2)
    return f"follows from {' and '.join(sorted(moved.worse, reverse=True))}" if follows else ""


def overall(decided: Sequence[FamilyChange]) -> str:
    """The decision over all families: better, worse, mixed, same or undecided.

    An improvement counts only if no other family is worse, or tends to be.
    """
    called = {family.verdict for family in decided if not family.why}
    if "mixed" in called or {"better", "worse"} <= called:
        return "mixed"
    if "worse" in called:
        return "worse"
    if "better" in called:
        return "mixed" if any(family.tendency == "worse" for family in decided) else "better"
    return "same" if {family.verdict for family in decided} <= {"same"} else "undecided"
