"""Compares finished runs of the same real scans: simulator versions, each with a base.

Pairs are the same if they have the same name and the same real scan, by content. Causes of the sensor and its pose are
decided by their precision (`changes`), the world by families of scores over independent places (`families`); the
objects are followed from run to run (`followed`) as a description.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path

import numpy as np
import pandas as pd

from ...schemas.errors import RunError
from ...schemas.results import JsonObject
from ...stages.arrays import IntArray
from ...stages.statistics.comparison import LEAST_FLIPPED, LEAST_PAIRS
from .changes import Changes, find_changes
from .families import FamilyChange, ScoredPairs, judge_families, overall
from .finished import (
    FinishedRun,
    pairs_left_out,
    partition_note,
    settings_changes,
    version_changes,
)
from .followed import CHANGE_COLUMNS, FOLLOWED_COLUMNS, KINDS, follow
from .independence import pairs_and_places
from .object_frame import plain_rows
from .sectors import N_SECTORS, sector_frame


@dataclass
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
    """

    base: Path
    other: Path
    pairs: tuple[str, ...]
    left_out: dict[str, str]
    lost: tuple[str, ...]
    failed: tuple[str, ...]
    settings: tuple[str, ...]
    notes: tuple[str, ...]
    n_places: int
    counted: str
    by_direction: bool
    on_partition: str
    unfollowed: tuple[str, ...] = ()
    changes: Changes = field(default_factory=Changes)
    families: tuple[FamilyChange, ...] = ()
    objects: pd.DataFrame = field(default_factory=lambda: pd.DataFrame(columns=CHANGE_COLUMNS))

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
        return pd.DataFrame([cause.as_dict() for cause in self.changes.causes])

    @property
    def table(self) -> pd.DataFrame:
        """One row per score of the world: family, verdict, means before and after, change with its 95 % interval, p."""
        rows = []
        for family in self.families:
            for score in family.scores:
                rows.append({"family": family.name} | vars(score) | vars(score.difference))
        return pd.DataFrame(rows)

    @property
    def kinds(self) -> dict[str, int]:
        """Number of real objects by fate."""
        count = self.objects["kind"].value_counts()
        return {kind: int(count.get(kind, 0)) for kind in KINDS}

    def as_dict(self) -> JsonObject:
        """Plain values, for programs."""
        plain = vars(self) | {
            "base": str(self.base),
            "other": str(self.other),
            "decision": self.decision,
            "causes": [cause.as_dict() for cause in self.changes.causes],
            "unexplained": self.changes.elsewhere,
            "families": [asdict(family) for family in self.families],
            "kinds": self.kinds,
            "objects": plain_rows(self.objects),
        }
        del plain["changes"]
        return plain


def compare_runs(
    folders: Sequence[Path],
    *,
    allow_different_settings: bool = False,
    independent: bool = False,
) -> list[Comparison]:
    """Each run but the first against the first.

    Parameters
    ----------
    independent : treat each pair as independent, also neighbouring frames

    Raises
    ------
    RunError
        A folder is not a finished run, settings that change scores differ and that is not allowed, no pair is
        common.
    """
    base, *others = [FinishedRun(folder) for folder in folders]
    comparisons = []
    for other in others:
        settings = settings_changes(base, other)
        if settings and not allow_different_settings:
            raise RunError(
                f"runs {base.folder} and {other.folder}: settings differ ({'; '.join(settings)}), "
                "so that a difference need not be the simulator's; run both with the same "
                "settings, or give --allow-different-settings"
            )
        comparisons.append(_comparison(base, other, settings, independent=independent))
    return comparisons


def _comparison(
    base: FinishedRun,
    other: FinishedRun,
    settings: Sequence[str],
    *,
    independent: bool,
) -> Comparison:
    """A run against the base; `settings` are those that differ."""
    left_out = pairs_left_out(base, other)
    names = [name for name in base.names if name not in left_out]
    blocks = np.arange(len(names), dtype=np.int32) if independent else base.places(names)
    n_places = len(np.unique(blocks))
    lost = [name for name in base.names if name in left_out]
    failed = {row["pair_id"] for row in other.rows if row["status"] == "failed"}
    comparison = Comparison(
        base=base.folder,
        other=other.folder,
        pairs=tuple(names),
        left_out=left_out,
        lost=tuple(lost),
        failed=tuple(name for name in lost if name in failed),
        settings=tuple(settings),
        notes=tuple(_notes(base, other)),
        n_places=n_places,
        counted=_counted(base, names, n_places, independent=independent),
        by_direction=n_places < min(LEAST_FLIPPED, len(names)),
        on_partition=partition_note((base, other)),
    )
    if names:
        _compare(comparison, base, other, blocks)
    elif not comparison.failed:
        reasons = [f"{name!r}: {reason}" for name, reason in left_out.items()]
        why = "; ".join(reasons[:3]) or "no pair is scored"
        raise RunError(
            f"runs {base.folder} and {other.folder}: no pair can be compared ({why})"
        )
    return comparison


def _compare(
    comparison: Comparison, base: FinishedRun, other: FinishedRun, blocks: IntArray
) -> None:
    """Add the causes, families and objects to a comparison."""
    runs = (base, other)
    names = comparison.pairs
    changes = comparison.changes = find_changes(base, other, names, blocks)
    sectors = None
    if comparison.by_direction:
        directions = (
            (N_SECTORS * blocks[:, None] + np.arange(N_SECTORS)).ravel().astype(np.int32)
        )
        sectors = ScoredPairs([sector_frame(run, names) for run in runs], directions)
        blocks = np.arange(len(names), dtype=np.int32)
    scores = [run.scores.loc[[*names]] for run in runs]
    comparison.families = judge_families(
        base.preset if base.preset == other.preset else "paper",
        ScoredPairs(scores, blocks),
        sectors=sectors,
        worse_causes=[cause.name for cause in changes.causes if cause.verdict == "worse"],
    )
    real_objects = [run.objects_of(names, FOLLOWED_COLUMNS, ("real",)) for run in runs]
    comparison.objects, unfollowed = follow(*real_objects)
    comparison.unfollowed = tuple(unfollowed)


def _counted(
    base: FinishedRun, names: Sequence[str], n_places: int, *, independent: bool
) -> str:
    """The numbers of pairs and places, and how the places were recognised."""
    if independent:
        number = "1 pair" if len(names) == 1 else f"{len(names)} pairs"
        return f"{number} (--independent), so that the decision is about these scans only"
    counted = pairs_and_places(len(names), n_places)
    if len(names) < 2:
        return counted
    are_timed = all(name in base.record.times_s for name in names)
    return f"{counted} ({'by time stamps' if are_timed else 'by comparing the scans'})"


def _notes(base: FinishedRun, other: FinishedRun) -> list[str]:
    """Other things that can change a number: scans that are not in one frame or place, code of stages, libraries."""
    notes = []
    for run in (base, other):
        n_unfit = len(run.record.frames)
        if n_unfit:
            notes.append(
                f"{run.folder}: {n_unfit} of {len(run.scored)} pairs are not in one frame or show "
                f"two places, but count; see fidpipe show {run.folder}"
            )
    return notes + version_changes(base, other)
