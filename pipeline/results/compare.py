"""Compares finished runs of the same real scans: simulator versions, each with a base.

Pairs are the same if they have the same name and the same real scan, by content. Causes of the sensor and its pose are
decided by their precision (`changes`), the world by families of scores over independent places (`families`); the
objects are followed from run to run (`followed`) as a description.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from ...schemas.columns import Row
from ...schemas.errors import RunError
from ...schemas.metric_catalogue import SEEDED_SCORES
from ...schemas.results import JsonObject
from ...stages.arrays import IntArray
from ...stages.statistics.comparison import KINDS, LEAST_FLIPPED, LEAST_PAIRS
from ...stages.statistics.spread import spread
from ..engine.progress import Reporter
from .best_case import RunExcess, excess_over
from .changes import Changes, change_rows, find_changes
from .families import FamilyChange, ScoreChange, judge_families, overall, score_rows
from .finished import OF_SIM_FILES, FinishedRun, differences, partition_note, settings_changes
from .followed import CHANGE_COLUMNS, FOLLOWED_COLUMNS, by_class, by_range, follow
from .independence import how_found, pairs_and_places
from .object_frame import object_parts, plain_rows
from .sectors import N_SECTORS, sector_rows

#: Largest number of runs in one command.
MOST_RUNS = 8


@dataclass(frozen=True)
class Comparison:
    """One run against the base.

    pairs : names of the pairs that are compared
    left_out : by pair, why it is not compared
    lost : of these, the pairs that the base has scored
    failed : of these, the pairs that failed in the other run, whose means would else look better without them
    unfollowed : pairs whose real communities differ, so that their objects cannot be followed
    settings : settings that differ, as text
    notes : what else differs
    changes : causes that changed
    families : scores of the world
    objects : the real objects and their fates, see `followed.follow`
    n_places : independent places: copies and neighbouring frames count once
    counted : the numbers of pairs and places, and how places were recognised
    by_direction : True if few places are left, so that changes of the world must be consistent over directions as well
    on_partition : what chance does to scores of the paper's partition; "" of reference objects
    excess : of the base and of the other run over the best case; None without one
    """

    base: Path
    other: Path
    pairs: tuple[str, ...]
    left_out: dict[str, str]
    lost: tuple[str, ...]
    failed: tuple[str, ...]
    unfollowed: tuple[str, ...]
    settings: tuple[str, ...]
    notes: tuple[str, ...]
    changes: Changes
    families: tuple[FamilyChange, ...]
    objects: pd.DataFrame
    n_places: int
    counted: str
    by_direction: bool
    on_partition: str
    excess: tuple[RunExcess, RunExcess] | None = None

    @property
    def is_small(self) -> bool:
        """True if so few pairs are compared that only very large changes count."""
        return (len(self.pairs) if self.by_direction else self.n_places) < LEAST_PAIRS

    @property
    def lacks_places(self) -> bool:
        """True if the comparison is undecided although more places may decide it."""
        return self.decision == "undecided" and self.n_places < LEAST_PAIRS

    @property
    def decision(self) -> str:
        """Over the causes of the sensor and all families; worse or mixed if a pair fails that did not."""
        verdicts = {family.verdict for family in self.families if not family.why}
        decided = {changed.verdict for changed in self.changes.causes}
        verdicts |= decided & {"better", "worse"}
        if "changed" in decided:
            verdicts.add("undecided")
        tends_worse = any(family.tendency == "worse" for family in self.families)
        decision = overall(verdicts, tends_worse=tends_worse)
        if not self.failed:
            return decision
        return "mixed" if decision in ("better", "mixed") else "worse"

    @property
    def causes(self) -> pd.DataFrame:
        """One row per cause that changed: amounts before and after, change with its 95 % interval, verdict, setting."""
        return pd.DataFrame(change_rows(self.changes))

    @property
    def table(self) -> pd.DataFrame:
        """One row per score of the world: family, verdict, means before and after, change with its 95 % interval, p."""
        return pd.DataFrame(score_rows(self.families))

    @property
    def scores(self) -> list[ScoreChange]:
        """Those of all families."""
        return [score for family in self.families for score in family.scores]

    @property
    def kinds(self) -> dict[str, int]:
        """Number of real objects by fate."""
        count = self.objects["kind"].value_counts()
        return {kind: int(count.get(kind, 0)) for kind in KINDS}

    def as_dict(self) -> JsonObject:
        """Plain values, for programs."""
        plain = asdict(replace(self, excess=None, changes=Changes()))
        plain |= {"base": str(self.base), "other": str(self.other), "decision": self.decision}
        plain |= {"causes": change_rows(self.changes), "unexplained": self.changes.elsewhere}
        plain["excess"] = None if self.excess is None else [excess.as_dict() for excess in self.excess]
        plain |= {"kinds": self.kinds, "objects": plain_rows(self.objects)}
        plain |= {"by_class": by_class(self.objects), "by_range": by_range(self.objects)}
        del plain["changes"]
        return plain


def compare_runs(
    folders: Sequence[Path],
    *,
    allow_different_settings: bool = False,
    best_case: Path | None = None,
    independent: bool = False,
    reporter: Reporter | None = None,
) -> list[Comparison]:
    """Each run but the first against the first.

    Parameters
    ----------
    independent : treat each pair as independent, also neighbouring frames
    best_case : the run of fidpipe best-case of the same real scans; all runs then need its settings
    reporter : shows the progress over many pairs

    Raises
    ------
    RunError
        A folder is not a finished run, settings that change scores differ and that is not allowed, no pair is
        common, or the best case belongs to other runs.
    """
    base, *others = [FinishedRun(folder) for folder in folders]
    options: dict[str, Any] = {"best_case": best_case, "independent": independent, "reporter": reporter}
    return [compare_two(base, other, allow_different_settings, **options) for other in others]


def compare_two(
    base: FinishedRun,
    other: FinishedRun,
    allow_different_settings: bool = False,
    *,
    best_case: Path | None = None,
    independent: bool = False,
    reporter: Reporter | None = None,
) -> Comparison:
    """One run against another, as `compare_runs` does."""
    differing = settings_changes(base, other, but=OF_SIM_FILES)
    if differing and not allow_different_settings:
        raise RunError(_settings_differ(base, other, differing))
    left_out = pairs_left_out(base, other)
    names = tuple(row["pair_id"] for row in base.scored if row["pair_id"] not in left_out)
    lost = tuple(row["pair_id"] for row in base.scored if row["pair_id"] in left_out)
    tried = {row["pair_id"] for row in other.rows}
    failed = tuple(name for name in lost if name in tried and other.row(name)["status"] != "scored")
    if not names and not failed:
        why = "; ".join(f"{name!r}: {reason}" for name, reason in list(left_out.items())[:3])
        raise RunError(f"runs {base.folder} and {other.folder}: no pair can be compared ({why or 'no pair is scored'})")
    objects, unfollowed = _followed(base, other, names)
    excess = None
    if best_case is not None and names:
        excess = excess_over(base, best_case, names), excess_over(other, best_case, names)
    blocks = np.arange(len(names), dtype=np.int32) if independent else base.places(names)
    n_places = len(np.unique(blocks))
    changes = find_changes(base, other, names, blocks, reporter) if names else Changes()
    by_direction = n_places < min(LEAST_FLIPPED, len(names))
    return Comparison(
        base=base.folder,
        other=other.folder,
        pairs=names,
        left_out=left_out,
        lost=lost,
        failed=failed,
        unfollowed=tuple(unfollowed),
        settings=tuple(differing),
        notes=(*_notes(base, other), *_task_notes(base, other)),
        changes=changes,
        families=_families(base, other, names, blocks, by_direction, excess, changes) if names else (),
        objects=objects,
        n_places=n_places,
        counted=_counted(base, names, n_places, independent=independent),
        by_direction=by_direction,
        on_partition=partition_note((base, other)),
        excess=excess,
    )


def _settings_differ(base: FinishedRun, other: FinishedRun, differing: Sequence[str]) -> str:
    presets = "" if base.preset == other.preset else f"preset {base.preset} and preset {other.preset}: "
    return (
        f"runs {base.folder} and {other.folder}: settings differ ({presets}{'; '.join(differing)}), so that a "
        "difference need not be the simulator's; run both with the same settings, or give --allow-different-settings"
    )


def _families(
    base: FinishedRun,
    other: FinishedRun,
    names: Sequence[str],
    blocks: IntArray,
    by_direction: bool,
    excess: tuple[RunExcess, RunExcess] | None,
    changes: Changes,
) -> tuple[FamilyChange, ...]:
    """The families of scores of the world."""
    rows = {name: (base.row(name), other.row(name)) for name in names}
    sectors = None
    if by_direction:
        sectors = _by_sector(base, other, names, blocks)
        blocks = np.arange(len(names), dtype=np.int32)
    best_cases = {}
    if excess is not None:
        best_cases = {column: score.best_case_from_equal for column, score in excess[0].scores.items()}
    preset = base.preset if base.preset == other.preset else "paper"
    worse = [changed.cause.name for changed in changes.causes if changed.verdict == "worse"]
    return judge_families(preset, rows, blocks, _noise_of_seeds(base, other, names), best_cases, sectors, worse)


def _by_sector(
    base: FinishedRun, other: FinishedRun, names: Sequence[str], blocks: IntArray
) -> tuple[dict[str, tuple[Row, Row]], IntArray]:
    """Rows of all sectors of all pairs before and after, and the block of each: a direction from a place."""
    both = zip(sector_rows(base, names), sector_rows(other, names), strict=True)
    rows = {str(i): pair for i, pair in enumerate(both)}
    of_sectors = N_SECTORS * blocks[:, None] + np.arange(N_SECTORS)
    return rows, of_sectors.ravel().astype(np.int32)


def _noise_of_seeds(base: FinishedRun, other: FinishedRun, names: Sequence[str]) -> dict[str, float]:
    """Difference of two means that Louvain seeds alone make, by column, where both runs were repeated."""
    first, second = _seed_noise(base, names), _seed_noise(other, names)
    return {column: math.hypot(first[column], second[column]) / math.sqrt(2) for column in first if column in second}


def _followed(base: FinishedRun, other: FinishedRun, names: Sequence[str]) -> tuple[pd.DataFrame, list[str]]:
    """Fates of the real objects of the pairs, and the pairs whose real objects differ."""
    parts = zip(_real_objects(base, names), _real_objects(other, names), strict=True)
    changes, unfollowed = [], []
    for before, after in parts:
        followed, differing = follow(before, after)
        changes.append(followed)
        unfollowed += [names[i] for i in differing]
    if not changes:
        return pd.DataFrame(columns=CHANGE_COLUMNS), []
    return pd.concat(changes, ignore_index=True), unfollowed


def _real_objects(run: FinishedRun, names: Sequence[str]) -> Iterator[pd.DataFrame]:
    return object_parts(run.store, names, FOLLOWED_COLUMNS, by_reference=run.is_by_reference, sides=("real",))


def _counted(base: FinishedRun, names: Sequence[str], n_places: int, *, independent: bool) -> str:
    """The numbers of pairs and places, and how the places were recognised."""
    if independent:
        number = "1 pair" if len(names) == 1 else f"{len(names)} pairs"
        return f"{number} (--independent), so that the decision is about these scans only"
    counted = pairs_and_places(len(names), n_places)
    if len(names) < 2:
        return counted
    are_timed = all(name in base.record.times_s for name in names)
    return f"{counted} ({how_found(len(names), n_places, are_timed=are_timed)})"


def _notes(base: FinishedRun, other: FinishedRun) -> list[str]:
    """Other things that can change a number: scans that are not in one frame or place, code of stages, libraries."""
    notes = []
    for run in (base, other):
        unfit = list(run.record.frames)
        if unfit:
            named = unfit[0] if len(unfit) == 1 else f"{unfit[0]} ..."
            notes.append(
                f"{run.folder}: scans are not in one frame or show two places, but count: {len(unfit)} of "
                f"{len(run.scored)} pairs ({named}); see fidpipe show {run.folder}"
            )
    a, b = base.record, other.record
    notes += [f"code of stage {name}: {x} and {y}" for name, x, y in differences(a.stages, b.stages)]
    notes += [f"library {name}: {x} and {y}" for name, x, y in differences(a.libraries, b.libraries)]
    return notes


def _task_notes(base: FinishedRun, other: FinishedRun) -> list[str]:
    """Mean gaps of the tasks that both runs have, over all their pairs; no verdict depends on them."""
    gaps = base.record.task_gaps
    other_gaps = other.record.task_gaps
    if base.record.settings.get("tasks") != other.record.settings.get("tasks"):
        return ["the runs have other settings of tasks: these are not compared"] if gaps and other_gaps else []
    changes = []
    for measure, gap in gaps.items():
        other_gap = other_gaps.get(measure)
        if gap is not None and other_gap is not None:
            changes.append(f"{measure} {gap:.2g} to {other_gap:.2g}")
    return [f"tasks, gaps not decided: {', '.join(changes)}"] if changes else []


def pairs_left_out(base: FinishedRun, other: FinishedRun) -> dict[str, str]:
    """Pairs that cannot be compared, and why."""
    names = {row["pair_id"] for row in (*base.rows, *other.rows)}
    why = {}
    for name in sorted(names):
        hashes = [run.record.inputs.get(name, {}).get("real") for run in (base, other)]
        reason = _unscored(other, name) or _unscored(base, name)
        if reason:
            why[name] = reason
        elif hashes[0] is None or hashes[0] != hashes[1]:
            why[name] = "the real scans differ"
    return why


def _unscored(run: FinishedRun, name: str) -> str:
    """The reason for which a run has no scores of a pair; "" if it has."""
    row = run.rows_by_name.get(name)
    if row is None:
        return f"not in {run.folder}"
    return "" if row["status"] == "scored" else f"failed in {run.folder} ({row['reason']})"


def _seed_noise(run: FinishedRun, names: Sequence[str]) -> dict[str, float]:
    """Difference of two means over the pairs that Louvain seeds alone can cause (95 %), by score.

    Only scores that are known of every pair under the same number of seeds.
    """
    repeats: dict[str, list[list[float]]] = {column: [] for column in SEEDED_SCORES}
    for name in names:
        record = run.store.ledger.jobs(name).get(("seeds", ""))
        if record is None:
            return {}
        for column, scores in repeats.items():
            scores.append(record.metadata["scores"][column])
    noise = {}
    for column, scores in repeats.items():
        n_seeds = {len(repeated) for repeated in scores}
        least = spread(np.array(scores, dtype=np.float64)).least_dataset if len(n_seeds) == 1 else None
        if least is not None:
            noise[column] = least
    return noise
