"""Families of scores of the world that `compare` decides together: surface missing, surface invented, objects.

Causes of the sensor and its pose are decided by their precision (`changes`); the world differs from place to place, so
that its scores need independent places. The two coverages are read together: a simulator that loses points also invents
less, one that scatters points everywhere also covers more, and both change the mean over the objects that are left. So
an improvement that lost or invented surface, or a worse sensor, explains is shown with its reason and does not count.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd

from ...schemas.metric_catalogue import COVERAGE_REACHES, Metric, is_of_preset, metrics_in
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

    def changes(self, columns: list[str]) -> FloatArray:
        """(m, b) mean of after - before over the rows of each block, by column."""
        before, after = self.values(columns)
        return block_means(after - before, self.blocks)


@dataclass
class ScoreChange:
    """A score before and after.

    name, mark : heading and direction of good
    verdict : better, worse, undecided, or same if it changes by no more than matters
    p : adjusted for the scores of its family (maxT), not for the other families; None if it cannot be tested
    towards : direction in which it moved, better or worse, decided or not; "" if it did not move
    why : reason for which its verdict does not count; "" if it counts
    """

    name: str
    mark: str
    difference: Difference
    verdict: str
    p: float | None
    towards: str
    why: str = ""


@dataclass
class FamilyChange:
    """The decision of one family.

    scores : those that have values, the one that changed most clearly first
    verdict : better, worse, mixed, same or undecided
    p : smallest of its scores, adjusted for all families (Holm); None if no score can be tested
    why : reason for which the verdict does not count in the overall decision; "" if it counts
    tendency : worse or better if it is not decided and p before Holm is below 5 %, else ""
    """

    name: str
    scores: tuple[ScoreChange, ...]
    verdict: str = "undecided"
    p: float | None = None
    why: str = ""
    tendency: str = ""

    @property
    def called(self) -> str:
        """The verdict as it is shown, in brackets if it does not count."""
        return f"({self.verdict})" if self.why else self.verdict


def judge_families(
    preset: str,
    pairs: ScoredPairs,
    *,
    sectors: ScoredPairs | None = None,
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
    worse_causes : causes of the sensor that became worse, from which improvements of a family may follow
    """
    by_family: dict[str, list[Metric]] = {}
    for metric in metrics_in("compare"):
        if is_of_preset(metric.pair_column, preset):
            by_family.setdefault(metric.family, []).append(metric)
    families = []
    for name, metrics in by_family.items():
        if scores := _changes(metrics, pairs, sectors):
            families.append(FamilyChange(name, scores))
    smallest = []
    for family in families:
        known = [score.p for score in family.scores if score.p is not None]
        smallest.append(min(known, default=None))
    are_few = len(np.unique(pairs.blocks)) < LEAST_PAIRS
    for family, p, adjusted in zip(families, smallest, holm(smallest), strict=True):
        if p is not None and p < ERROR_RATE:
            family.tendency = family.scores[0].towards
        _decide_scores(family, adjusted, are_few=are_few)
    worse = []
    for family in families:
        if any(score.verdict == "worse" for score in family.scores):
            worse.append(family.name)
    is_more_right = _is_more_right(pairs)
    for family in families:
        _decide(
            family, _consequence(family.name, worse, worse_causes, is_more_right=is_more_right)
        )
    return tuple(families)


def _changes(
    metrics: Sequence[Metric], pairs: ScoredPairs, sectors: ScoredPairs | None
) -> tuple[ScoreChange, ...]:
    """The scores of a family that have values, without verdicts, the most clearly changed first."""
    before, after = pairs.values([metric.pair_column for metric in metrics])
    p_values = _p_values(metrics, pairs, sectors).tolist()
    changes = []
    for metric, first, last, p in zip(metrics, before, after, p_values, strict=True):
        difference = paired_difference(first, last, pairs.blocks)
        if not difference.n_pairs:
            continue
        is_same = difference.low == difference.high == 0
        is_same |= difference.n_blocks > 1 and math.isnan(p)
        towards = ""
        if difference.size > ALIKE and not is_same:
            is_higher = (difference.difference or 0.0) > 0
            towards = "better" if is_higher == metric.higher_is_better else "worse"
        change = ScoreChange(
            name=metric.compared_as or metric.label,
            mark="↑" if metric.higher_is_better else "↓",
            difference=difference,
            verdict="same" if is_same else "undecided",
            p=None if is_same or math.isnan(p) else p,
            towards=towards,
        )
        changes.append(change)
    return tuple(sorted(changes, key=_clearest_first))


def _clearest_first(change: ScoreChange) -> tuple[float, float]:
    """Key that sorts by p, then by the change in standard deviations of the blocks' changes."""
    difference = change.difference
    return 2.0 if change.p is None else change.p, -difference.size / (
        difference.std or math.inf
    )


def _p_values(
    metrics: Sequence[Metric], pairs: ScoredPairs, sectors: ScoredPairs | None
) -> FloatArray:
    """p-values over the pairs, or the larger ones of pairs and sectors; 1 if a score is not known by direction."""
    columns = [metric.pair_column for metric in metrics]
    least = np.array([metric.least for metric in metrics])
    step = np.array([metric.step or 0.0 for metric in metrics])
    p_values = adjusted_p_values(pairs.changes(columns), least, step)
    if sectors is None:
        return p_values
    change = sectors.changes(columns)
    by_sector = adjusted_p_values(change, least, np.zeros(len(metrics)))
    by_sector[np.isnan(change).all(axis=1)] = 1.0
    larger: FloatArray = np.maximum(p_values, by_sector)
    return larger


def _decide_scores(family: FamilyChange, p: float | None, *, are_few: bool) -> None:
    """Set the p-value of a family, and the verdicts of its scores if it is decided.

    Parameters
    ----------
    p : after Holm
    are_few : few pairs cannot lower p-values of 1, which are left out
    """
    is_decided = p is not None and p < ERROR_RATE
    for change in family.scores:
        is_clear = change.p is not None and change.p < ERROR_RATE
        if is_decided and is_clear:
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
