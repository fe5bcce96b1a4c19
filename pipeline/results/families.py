"""Families of scores of the world that `compare` decides together: surface missing, surface invented, objects.

Causes of the sensor and its pose are decided by their precision (`changes`); the world differs from place to place, so
that its scores need independent places. The two coverages are read together: a simulator that loses points also invents
less, one that scatters points everywhere also covers more, and both change the mean over the objects that are left. So
an improvement that lost or invented surface, or a worse sensor, explains is shown with its reason and does not count.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

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

PairRows = Mapping[str, tuple[Row, Row]]  #: by pair, its rows before and after
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
#: Sign of a change that is worse, by the value that is best.
WORSE_IF = {"high": -1.0, "low": 1.0}
#: The same in headings.
MARKS = {"high": "↑", "low": "↓"}
MARKS_NOTE = "↑ higher is better, ↓ lower is better"


@dataclass(frozen=True)
class ComparedScore:
    """One score of pairs.

    column : of `pairs`, or the name of a gap of a task
    heading : with the unit
    best : "high" or "low"
    least : a change of the mean up to this size does not matter to a user
    step : smallest step of the value, such as 1 for a count
    """

    family: str
    heading: str
    column: str
    best: str
    least: float
    step: float


def families(preset: str) -> dict[str, list[ComparedScore]]:
    """The scores of each family, by its name; the first represents it over many runs that decide no score.

    Parameters
    ----------
    preset : of both runs; "paper" compares the match rate in place of the share of real objects that are found
    """
    chosen: dict[str, list[ComparedScore]] = {}
    for metric in metrics_in("compare"):
        if not is_of_preset(metric.pair_column, preset):
            continue
        score = ComparedScore(
            family=metric.family,
            heading=metric.compared_as or metric.label,
            column=metric.pair_column,
            best="high" if metric.higher_is_better else "low",
            least=metric.least or 0.0,
            step=metric.step or 0.0,
        )
        chosen.setdefault(metric.family, []).append(score)
    chosen[TASKS] = []
    for column, (heading, step) in _TASK_SCORES.items():
        chosen[TASKS].append(ComparedScore(TASKS, heading, column, "low", _LEAST_GAP, step))
    return chosen


@dataclass(frozen=True)
class ScoreChange:
    """A score before and after.

    name, mark : heading and direction of good
    verdict : better, worse, undecided, or same if it changes by no more than matters
    p : adjusted for the scores of its family (maxT), not for the other families; None if it cannot be tested
    towards : direction in which it moved, better or worse, decided or not; "" if it did not move
    why : reason for which its verdict does not count; "" if it counts
    of_pairs : by pair, after minus before; None if a value is null
    seed_noise : largest difference of the two means that Louvain seeds alone make in 95 % of the cases; None if unknown
    best_case : distance of the best case's mean from equal scans; None if unknown
    """

    name: str
    mark: str
    difference: Difference
    verdict: str
    p: float | None
    towards: str
    of_pairs: dict[str, float | None]
    seed_noise: float | None = None
    best_case: float | None = None
    why: str = ""

    @property
    def clarity(self) -> float:
        """Change in standard deviations of the blocks' changes."""
        return self.difference.size / (self.difference.std or math.inf)

    @property
    def is_clear(self) -> bool:
        """True if it moved, and its interval, if there is one, does not hold 0."""
        low, high = self.difference.low, self.difference.high
        return bool(self.towards) and (low is None or high is None or low > 0 or high < 0)

    def exceeds(self, least: float | None) -> bool | None:
        """True if the difference is larger than `seed_noise` or `best_case`; None if one of them is unknown."""
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
    best_cases: Mapping[str, float | None] | None = None,
    sectors: tuple[PairRows, IntArray] | None = None,
    worse_causes: Sequence[str] = (),
) -> tuple[FamilyChange, ...]:
    """The families with their verdicts; of equal simulators any is better or worse in under 5 % of the comparisons.

    A family is decided if the smallest adjusted p of its scores is below 5 % after Holm over the families; those in
    which nothing changes take no share. Each score of a decided family with p below 5 % is better or worse by its mean.

    Parameters
    ----------
    preset : of both runs
    rows : by pair, its rows of `pairs` before and after
    blocks : (n,) block of each pair
    seed_noise, best_cases : by column of `pairs`, see `ScoreChange`
    sectors : rows of the sectors of all pairs (`sectors.sector_rows`) and the block of each, where neighbouring frames
        leave few blocks. A change must then be consistent over the sectors of the places, and over the frames, too
    worse_causes : causes of the sensor that became worse, from which improvements of a family may follow
    """
    judged = []
    for name, compared in families(preset).items():
        scores = _changes(compared, rows, blocks, seed_noise or {}, best_cases or {}, sectors)
        if scores:
            judged.append(FamilyChange(name, "undecided", None, "", "", scores))
    lowest = [_lowest_p(family) for family in judged]
    are_few = len(np.unique(blocks)) < LEAST_PAIRS
    for i, p in enumerate(holm(lowest)):
        judged[i] = _with_p(judged[i], p, lowest[i], are_few=are_few)
    worse = set()
    for family in judged:
        if "worse" in [score.verdict for score in family.scores]:
            worse.add(family.name)
    is_more_right = _is_more_right(rows)
    decided = []
    for family in judged:
        why = _consequence(family.name, worse, worse_causes, is_more_right=is_more_right)
        decided.append(_decided(family, why))
    return tuple(decided)


def _lowest_p(family: FamilyChange) -> float | None:
    """The smallest p of its scores; None if none can be tested."""
    return min((score.p for score in family.scores if score.p is not None), default=None)


def _with_p(
    family: FamilyChange, p: float | None, before_holm: float | None, *, are_few: bool
) -> FamilyChange:
    """The family with its p-value, and the verdicts of its scores if it is decided.

    Parameters
    ----------
    are_few : few pairs cannot lower p-values of 1, which are left out
    """
    is_decided = p is not None and p < ERROR_RATE
    tends = before_holm is not None and before_holm < ERROR_RATE
    scores = []
    for score in family.scores:
        is_clear = score.p is not None and score.p < ERROR_RATE
        is_beyond = score.exceeds(score.seed_noise) is not False
        verdict = score.towards if is_decided and is_clear and is_beyond else score.verdict
        score_p = None if are_few and score.p == 1.0 else score.p
        scores.append(replace(score, verdict=verdict, p=score_p))
    return replace(
        family,
        p=None if are_few and p == 1.0 else p,
        tendency=scores[0].towards if tends else "",
        scores=tuple(scores),
    )


def _changes(
    compared: Sequence[ComparedScore],
    rows: PairRows,
    blocks: IntArray,
    seed_noise: Mapping[str, float | None],
    best_cases: Mapping[str, float | None],
    sectors: tuple[PairRows, IntArray] | None,
) -> tuple[ScoreChange, ...]:
    """The scores of a family that have values, without verdicts, the most clearly changed first."""
    before, after = _read(compared, rows)
    least = np.array([score.least for score in compared])
    step = np.array([score.step for score in compared])
    p_values = adjusted_p_values(block_means(after - before, blocks), least, step)
    if sectors is not None:
        p_values = _with_sectors(p_values, compared, sectors, least)
    scores = []
    for i, score in enumerate(compared):
        difference = paired_difference(before[i], after[i], blocks)
        if difference.n_pairs:
            change = dict(zip(rows, (after[i] - before[i]).tolist(), strict=True))
            p = None if np.isnan(p_values[i]) else float(p_values[i])
            scores.append(_score_change(score, difference, p, change, seed_noise, best_cases))
    return tuple(
        sorted(scores, key=lambda score: (2.0 if score.p is None else score.p, -score.clarity))
    )


def _with_sectors(
    p_values: FloatArray,
    compared: Sequence[ComparedScore],
    sectors: tuple[PairRows, IntArray],
    least: FloatArray,
) -> FloatArray:
    """The larger of the p-values over the frames and over the directions; 1 if a score is not known by direction."""
    before, after = _read(compared, sectors[0])
    change = block_means(after - before, sectors[1])
    is_known = ~np.isnan(change).all(axis=1)
    by_sector = adjusted_p_values(change[is_known], least[is_known], np.zeros(is_known.sum()))
    larger = np.where(np.isnan(p_values), np.nan, 1.0)
    larger[is_known] = np.maximum(p_values[is_known], by_sector)
    return larger


def _score_change(
    score: ComparedScore,
    difference: Difference,
    p: float | None,
    change: Mapping[str, float],
    seed_noise: Mapping[str, float | None],
    best_cases: Mapping[str, float | None],
) -> ScoreChange:
    is_same = difference.low == difference.high == 0 or (difference.n_blocks > 1 and p is None)
    towards = ""
    if difference.size > ALIKE and not is_same:
        towards = "worse" if (difference.difference or 0.0) * WORSE_IF[score.best] > 0 else "better"
    return ScoreChange(
        name=score.heading,
        mark=MARKS[score.best],
        difference=difference,
        verdict="same" if is_same else "undecided",
        p=None if is_same else p,
        towards=towards,
        of_pairs={name: None if math.isnan(value) else value for name, value in change.items()},
        seed_noise=seed_noise.get(score.column),
        best_case=best_cases.get(score.column),
    )


def _read(compared: Sequence[ComparedScore], rows: PairRows) -> tuple[FloatArray, FloatArray]:
    """(m, n) values by score and pair, before and after; NaN for null."""
    values = [_values(rows, score.column) for score in compared]
    before, after = np.stack(values, axis=1)
    return before, after


def _values(rows: PairRows, column: str) -> FloatArray:
    """(2, n) a column of all pairs before and after; NaN for null, and if the rows lack it."""
    pairs = [(before.get(column), after.get(column)) for before, after in rows.values()]
    return np.array(pairs, dtype=np.float64).T


def _is_more_right(rows: PairRows) -> bool:
    """True if the number of correct simulated points grew by more than half of that of the invented ones.

    Or fell by less.
    """
    n_points = _values(rows, "n_sim_points")
    covered = [_values(rows, f"covered_sim_{reach}") for reach in COVERAGE_REACHES]
    n_right = n_points * np.mean(covered, axis=0)
    right_before, right_after = n_right.mean(axis=1)
    invented_before, invented_after = (n_points - n_right).mean(axis=1)
    return bool(right_after - right_before > (invented_after - invented_before) / 2)


def _decided(family: FamilyChange, consequence: str) -> FamilyChange:
    """The family with its verdict; improvements do not count if they are a consequence."""
    scores = tuple(
        replace(score, why=consequence) if score.verdict == "better" else score
        for score in family.scores
    )
    hidden = [score for score in scores if score.why]
    verdicts = {score.verdict for score in scores if not score.why}
    counted = verdicts & {"better", "worse"}
    why = ""
    if counted:
        verdict = "mixed" if len(counted) == 2 else counted.pop()
    elif hidden:
        verdict = hidden[0].verdict
        why = consequence
    else:
        verdict = "same" if verdicts == {"same"} else "undecided"
    tendency = family.tendency if verdict == "undecided" else ""
    return replace(family, verdict=verdict, why=why, tendency=tendency, scores=scores)


def _consequence(
    family: str, worse: Collection[str], worse_causes: Sequence[str], *, is_more_right: bool
) -> str:
    """The reason for which an improvement of a family does not count; "" if it does."""
    if worse_causes:
        return f"follows from {' and '.join(worse_causes)}"
    surfaces = {SURFACE_MISSING, SURFACE_INVENTED}
    worse_surfaces = surfaces.intersection(worse)
    follows = family in (OBJECTS, TASKS) or (family in surfaces and not is_more_right)
    if worse_surfaces and follows:
        return f"follows from {' and '.join(sorted(worse_surfaces, reverse=True))}"
    return ""


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
