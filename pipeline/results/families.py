"""Families of scores of the world that `compare` decides together: surface missing, surface invented, objects.

Causes of the sensor and its pose are decided by their precision (`changes`); the world differs from place to place, so
that its scores need independent places. The two coverages are read together: a simulator that loses points also invents
less, one that scatters points everywhere also covers more, and both change the mean over the objects that are left. So
an improvement that lost or invented surface, or a worse sensor, explains is shown with its reason and does not count.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd

from ...schemas.columns import Row
from ...schemas.metric_catalogue import COVERAGE_REACHES, is_of_preset, metrics_in
from ...stages.arrays import FloatArray, IntArray
from ...stages.statistics.comparison import (
    ALIKE,
    CONFIDENCE,
    LEAST_PAIRS,
    Difference,
    adjusted_p_values,
    block_means,
    holm,
    paired_difference,
)

#: Changes that chance makes in under this share of the comparisons are decided.
ERROR_RATE = 1 - CONFIDENCE
SURFACE_MISSING, SURFACE_INVENTED, OBJECTS = "surface missing", "surface invented", "objects"
TASKS = "tasks"
#: Compared gaps of tasks: heading, and step of the share (objects are few).
_TASK_SCORES = {
    "objects.lost": ("obstacles lost", 0.04),
    "objects.added": ("obstacles added", 0.04),
    "occupancy.mismatch": ("occupancy mismatch", 0.0),
    "occupancy.wrongly_free": ("occupied map free", 0.0),
    "free_space.too_far": ("free space too long", 0.0),
}
_LEAST_GAP = 0.005
MARKS_NOTE = "↑ higher is better, ↓ lower is better"


@dataclass(frozen=True)
class ScoredPairs:
    """Scores of some pairs, or of the sectors of some pairs, in two runs.

    frames : before and after, one row per pair; columns of `pairs`, and gaps of tasks by names such as `objects.lost`
    blocks : (n,) block of each row
    """

    frames: Sequence[pd.DataFrame]
    blocks: IntArray

    def values(self, columns: list[str]) -> FloatArray:
        """(2, m, n) before and after, by column and row; NaN for null, and if the rows lack a column."""
        frames = [frame.reindex(columns=columns) for frame in self.frames]
        return np.stack([frame.to_numpy(np.float64).T for frame in frames])


@dataclass(frozen=True)
class ComparedScore:
    """One score of pairs.

    heading : with the unit
    column : of `pairs`, or the name of a gap of a task
    least : a change of the mean up to this size does not matter to a user
    step : smallest step of the value, such as 1 for a count
    """

    family: str
    heading: str
    column: str
    higher_is_better: bool
    least: float
    step: float


def compared_scores(preset: str) -> list[ComparedScore]:
    """The scores of all families; those of objects differ between presets."""
    scores = [
        ComparedScore(
            family=metric.family,
            heading=metric.compared_as or metric.label,
            column=metric.pair_column,
            higher_is_better=metric.higher_is_better,
            least=metric.least or 0.0,
            step=metric.step or 0.0,
        )
        for metric in metrics_in("compare")
        if is_of_preset(metric.pair_column, preset)
    ]
    for column, (heading, step) in _TASK_SCORES.items():
        scores.append(ComparedScore(TASKS, heading, column, False, _LEAST_GAP, step))
    return scores


@dataclass
class ScoreChange:
    """A score before and after.

    name, mark : heading and direction of good
    verdict : better, worse, undecided, or same if it changes by no more than matters
    p : adjusted for the scores of its family (maxT), not for the other families; None if it cannot be tested
    towards : direction in which it moved, better or worse, decided or not; "" if it did not move
    why : reason for which its verdict does not count; "" if it counts
    seed_noise : largest difference of the two means that Louvain seeds alone make in 95 % of the cases; None if unknown
    best_case : distance of the best case's mean from equal scans; None if unknown
    """

    name: str
    mark: str
    difference: Difference
    verdict: str
    p: float | None
    towards: str
    seed_noise: float | None = None
    best_case: float | None = None
    why: str = ""

    @property
    def is_clear(self) -> bool:
        """True if it moved, and its interval, if there is one, does not hold 0."""
        low, high = self.difference.low, self.difference.high
        return bool(self.towards) and (low is None or high is None or low > 0 or high < 0)

    def exceeds(self, least: float | None) -> bool | None:
        """True if the difference is larger than `seed_noise` or `best_case`; None if one of them is unknown."""
        change = self.difference.difference
        return None if least is None or change is None else abs(change) > least


@dataclass
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
    pairs: ScoredPairs,
    *,
    sectors: ScoredPairs | None = None,
    seed_noise: Mapping[str, float] | None = None,
    best_cases: Mapping[str, float | None] | None = None,
    worse_causes: Sequence[str] = (),
) -> tuple[FamilyChange, ...]:
    """The families with their verdicts; of equal simulators any is better or worse in under 5 % of the comparisons.

    A family is decided if the smallest adjusted p of its scores is below 5 % after Holm over the families; those in
    which nothing changes take no share. Each score of a decided family with p below 5 % is better or worse by its mean.

    Parameters
    ----------
    preset : of both runs; "paper" compares the match rate in place of the share of real objects that are found
    sectors : the sectors of all pairs, where neighbouring frames leave few blocks. A change must then be consistent
        over the sectors of the places, and over the frames, too
    seed_noise, best_cases : by column of `pairs`, see `ScoreChange`
    worse_causes : causes of the sensor that became worse, from which improvements of a family may follow
    """
    by_family: dict[str, list[ComparedScore]] = {}
    for score in compared_scores(preset):
        by_family.setdefault(score.family, []).append(score)
    families = []
    for name, scores in by_family.items():
        changes = _changes(scores, pairs, sectors, seed_noise or {}, best_cases or {})
        if changes:
            p = min((change.p for change in changes if change.p is not None), default=None)
            families.append(FamilyChange(name, "undecided", p, "", "", changes))
    are_few = len(np.unique(pairs.blocks)) < LEAST_PAIRS
    for family, p in zip(families, holm([family.p for family in families]), strict=True):
        _decide_scores(family, p, are_few=are_few)
    worse = []
    for family in families:
        if any(change.verdict == "worse" for change in family.scores):
            worse.append(family.name)
    is_more_right = _is_more_right(pairs)
    for family in families:
        _decide(family, _consequence(family.name, worse, worse_causes, is_more_right=is_more_right))
    return tuple(families)


def _changes(
    scores: Sequence[ComparedScore],
    pairs: ScoredPairs,
    sectors: ScoredPairs | None,
    seed_noise: Mapping[str, float],
    best_cases: Mapping[str, float | None],
) -> tuple[ScoreChange, ...]:
    """The scores of a family that have values, without verdicts, the most clearly changed first."""
    before, after = pairs.values([score.column for score in scores])
    changes = []
    for i, p in enumerate(_p_values(scores, pairs, sectors).tolist()):
        score = scores[i]
        difference = paired_difference(before[i], after[i], pairs.blocks)
        if not difference.n_pairs:
            continue
        is_same = difference.low == difference.high == 0
        is_same |= difference.n_blocks > 1 and math.isnan(p)
        towards = ""
        if difference.size > ALIKE and not is_same:
            is_higher = (difference.difference or 0.0) > 0
            towards = "better" if is_higher == score.higher_is_better else "worse"
        change = ScoreChange(
            name=score.heading,
            mark="↑" if score.higher_is_better else "↓",
            difference=difference,
            verdict="same" if is_same else "undecided",
            p=None if is_same or math.isnan(p) else p,
            towards=towards,
            seed_noise=seed_noise.get(score.column),
            best_case=best_cases.get(score.column),
        )
        changes.append(change)
    return tuple(sorted(changes, key=_clearest_first))


def _clearest_first(change: ScoreChange) -> tuple[float, float]:
    """Key that sorts by p, then by the change in standard deviations of the blocks' changes."""
    difference = change.difference
    return 2.0 if change.p is None else change.p, -difference.size / (difference.std or math.inf)


def _p_values(
    scores: Sequence[ComparedScore], pairs: ScoredPairs, sectors: ScoredPairs | None
) -> FloatArray:
    """p-values over the pairs, or the larger ones of pairs and sectors; 1 if a score is not known by direction."""
    columns = [score.column for score in scores]
    least = np.array([score.least for score in scores])
    step = np.array([score.step for score in scores])
    before, after = pairs.values(columns)
    p_values = adjusted_p_values(block_means(after - before, pairs.blocks), least, step)
    if sectors is None:
        return p_values
    before, after = sectors.values(columns)
    change = block_means(after - before, sectors.blocks)
    is_known = ~np.isnan(change).all(axis=1)
    by_sector = np.ones(len(scores))
    by_sector[is_known] = adjusted_p_values(
        change[is_known], least[is_known], np.zeros(is_known.sum())
    )
    larger: FloatArray = np.maximum(p_values, by_sector)
    return larger


def _decide_scores(family: FamilyChange, p: float | None, *, are_few: bool) -> None:
    """Set the p-value of a family, and the verdicts of its scores if it is decided.

    Parameters
    ----------
    p : after Holm
    are_few : few pairs cannot lower p-values of 1, which are left out
    """
    if family.p is not None and family.p < ERROR_RATE:
        family.tendency = family.scores[0].towards
    is_decided = p is not None and p < ERROR_RATE
    for change in family.scores:
        is_clear = change.p is not None and change.p < ERROR_RATE
        if is_decided and is_clear and change.exceeds(change.seed_noise) is not False:
            change.verdict = change.towards
        if are_few and change.p == 1.0:
            change.p = None
    family.p = None if are_few and p == 1.0 else p


def _is_more_right(pairs: ScoredPairs) -> bool:
    """True if the number of correct simulated points grew by more than half of that of the invented ones.

    Or fell by less.
    """
    n_points = pairs.values(["n_sim_points"])[:, 0]
    covered = pairs.values([f"covered_sim_{reach}" for reach in COVERAGE_REACHES])
    n_right = n_points * covered.mean(axis=1)
    right_before, right_after = n_right.mean(axis=1)
    invented_before, invented_after = (n_points - n_right).mean(axis=1)
    return bool(right_after - right_before > (invented_after - invented_before) / 2)


def _consequence(
    family: str, worse: Collection[str], worse_causes: Sequence[str], *, is_more_right: bool
) -> str:
    """The reason for which an improvement of a family does not count; "" if it does."""
    if worse_causes:
        return f"follows from {' and '.join(worse_causes)}"
    surfaces = [name for name in (SURFACE_MISSING, SURFACE_INVENTED) if name in worse]
    if surfaces and (family in (OBJECTS, TASKS) or not is_more_right):
        return f"follows from {' and '.join(surfaces)}"
    return ""


def _decide(family: FamilyChange, consequence: str) -> None:
    """Set the verdict of a family from those of its scores; improvements do not count if they are a consequence."""
    for change in family.scores:
        if change.verdict == "better":
            change.why = consequence
    family.verdict = overall({change.verdict for change in family.scores if not change.why})
    if family.verdict in ("same", "undecided") and any(change.why for change in family.scores):
        family.verdict = "better"
        family.why = consequence
    if family.verdict != "undecided":
        family.tendency = ""


def overall(verdicts: Collection[str], *, tends_worse: bool = False) -> str:
    """The decision over all verdicts that count: better, worse, mixed, same or undecided.

    An improvement counts only if nothing else is worse, or tends to be.
    """
    if "mixed" in verdicts or {"better", "worse"} <= {*verdicts}:
        return "mixed"
    if "worse" in verdicts:
        return "worse"
    if "better" in verdicts:
        return "mixed" if tends_worse else "better"
    return "same" if {*verdicts} <= {"same"} else "undecided"


def score_rows(families: Sequence[FamilyChange]) -> list[Row]:
    """One row per score, for programs."""
    rows = []
    for family in families:
        for score in family.scores:
            change = score.difference
            rows.append(
                {
                    "family": family.name,
                    "score": score.name,
                    "better is": score.mark,
                    "verdict": score.verdict,
                    "pairs": change.n_pairs,
                    "before": change.before,
                    "after": change.after,
                    "change": change.difference,
                    "from": change.low,
                    "to": change.high,
                    "p": score.p,
                }
            )
    return rows
