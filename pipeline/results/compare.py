"""Compares finished runs of the same real scans: simulator versions, each with a base.

Pairs are the same if they have the same name and the same real scan, by content. What is decided is in `families`; the
objects are followed from run to run (`followed`) as a description.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
import pandas as pd

from ...schemas.cause_catalogue import CAUSES
from ...schemas.errors import RunError
from ...schemas.metric_catalogue import SEEDED_SCORES
from ...schemas.results import CauseEstimate, JsonObject
from ...stages.arrays import FloatArray, IntArray
from ...stages.statistics.comparison import (
    BLOCK_S,
    KINDS,
    LEAST_FLIPPED,
    LEAST_PAIRS,
    Difference,
    blocks_of,
    paired_difference,
)
from ...stages.statistics.neighbours import neighbours
from ...stages.statistics.spread import spread
from ..storage.table_files import table_name
from .causes import CAUSE_KINDS, CauseKind, Columns
from .diagnosis import read_diagnosis
from .displaced import MovedWorld, find_moved
from .families import FamilyChange, ScoreChange, judge_families, overall
from .finished import FinishedRun, differences, partition_note, settings_changes
from .floor import RunExcess, excess_over
from .followed import CHANGE_COLUMNS, FOLLOWED_COLUMNS, by_class, by_range, follow
from .object_frame import object_parts, plain_rows
from .sectors import N_SECTORS, sector_rows

#: Largest number of runs in one command.
MOST_RUNS = 8
#: A cause changed if its estimate moved by more than this share of the tolerance within which it is not named.
_LEAST_OF_TOLERANCE = 0.1
#: A cause, its estimates before and after, the least change that matters, that without an interval, and the unit of
#: the changes by which causes are ordered.
_Estimates = tuple[CauseKind | CauseEstimate, FloatArray, FloatArray, float, float, float]


@dataclass(frozen=True)
class CauseChange:
    """The estimate of a cause in both runs, with the interval of its change.

    unit, setting : see `causes.CauseKind`
    """

    name: str
    unit: str
    setting: str
    difference: Difference


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
    families : what is decided, see `families`
    causes : those whose estimate changed by more than a tenth of its tolerance: the interval excludes 0, or if there is
        none, the change exceeds the tolerance; displacements only if `find_moved` confirms them
    objects : the real objects and their fates, see `followed.follow`
    n_blocks : independent pairs: copies and neighbouring frames count once
    blocking : one sentence on how they were found
    by_direction : True if few blocks are left, so that changes must be consistent over frames and over directions
    on_partition : what chance does to scores of the paper's partition; "" of reference objects
    excess : of the base and of the other run over the floor; None without one
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
    families: tuple[FamilyChange, ...]
    causes: tuple[CauseChange, ...]
    objects: pd.DataFrame
    n_blocks: int
    blocking: str
    by_direction: bool
    on_partition: str
    excess: tuple[RunExcess, RunExcess] | None = None

    @property
    def is_small(self) -> bool:
        """True if so few pairs are compared that only changes far beyond the noise are decided."""
        return (len(self.pairs) if self.by_direction else self.n_blocks) < LEAST_PAIRS

    @property
    def decision(self) -> str:
        """Over all families (`overall`); worse or mixed if a pair fails that did not."""
        found = overall(self.families)
        return found if not self.failed else "mixed" if found in ("better", "mixed") else "worse"

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
        excess = None if self.excess is None else [each.as_dict() for each in self.excess]
        return (
            asdict(replace(self, excess=None))
            | {"base": str(self.base), "other": str(self.other), "decision": self.decision}
            | {"kinds": self.kinds, "excess": excess, "objects": plain_rows(self.objects)}
            | {"by_class": by_class(self.objects), "by_range": by_range(self.objects)}
        )


def compare_runs(
    folders: Sequence[Path],
    *,
    allow_different_settings: bool = False,
    floor: Path | None = None,
    independent: bool = False,
) -> list[Comparison]:
    """Each run but the first against the first.

    Parameters
    ----------
    independent : treat each pair as independent, also neighbouring frames
    floor : the run of fidpipe floor of the same real scans; all runs then need its settings

    Raises
    ------
    RunError
        A folder is not a finished run, settings that change scores differ and that is not allowed, no pair is
        common, or the floor belongs to other runs.
    """
    base, *others = [FinishedRun(folder) for folder in folders]
    return [compare_two(base, other, allow_different_settings, floor, independent=independent) for other in others]


def compare_two(
    base: FinishedRun,
    other: FinishedRun,
    allow_different_settings: bool = False,
    floor: Path | None = None,
    independent: bool = False,
) -> Comparison:
    """One run against another, as `compare_runs` does."""
    differing = settings_changes(base, other)
    if differing and not allow_different_settings:
        presets = "" if base.preset == other.preset else f"preset {base.preset} and preset {other.preset}: "
        raise RunError(
            f"runs {base.folder} and {other.folder}: settings differ ({presets}{'; '.join(differing)}), so that a "
            "difference need not be the simulator's; run both with the same settings, or give "
            "--allow-different-settings"
        )
    left_out = pairs_left_out(base, other)
    names = tuple(row["pair_id"] for row in base.scored if row["pair_id"] not in left_out)
    lost = tuple(row["pair_id"] for row in base.scored if row["pair_id"] in left_out)
    tried = {row["pair_id"] for row in other.rows}
    failed = tuple(name for name in lost if name in tried and other.row(name)["status"] != "scored")
    if not names and not failed:
        why = "; ".join(f"{name!r}: {reason}" for name, reason in list(left_out.items())[:3])
        raise RunError(f"runs {base.folder} and {other.folder}: no pair can be compared ({why or 'no pair is scored'})")
    changes, unfollowed = _followed(base, other, names)
    excess = None if floor is None or not names else (excess_over(base, floor, names), excess_over(other, floor, names))
    blocks, blocking = _blocks(base, other, names, independent)
    rows = {name: (base.row(name), other.row(name)) for name in names}
    n_blocks, sectors = len(np.unique(blocks)), None
    if n_blocks < min(LEAST_FLIPPED, len(names)):
        of_runs = zip(sector_rows(base, names), sector_rows(other, names), strict=True)
        parts = {f"{i}": rows_of_sector for i, rows_of_sector in enumerate(of_runs)}
        sectors = parts, (N_SECTORS * blocks[:, None] + np.arange(N_SECTORS)).ravel().astype(np.int32)
        blocks = np.arange(len(names), dtype=np.int32)
    seeds, others = (_seed_noise(run, names) for run in (base, other))
    noise = {
        column: math.hypot(own, others[column]) / math.sqrt(2) for column, own in seeds.items() if column in others
    }
    floors = {} if excess is None else {column: own.floor_from_equal for column, own in excess[0].scores.items()}
    preset = base.preset if base.preset == other.preset else "paper"
    moved = find_moved(base, other, names, blocks)
    causes = _changed(_diagnosed(base, other, names), blocks) or _changed(_estimated(base, other, names), blocks)
    return Comparison(
        base=base.folder,
        other=other.folder,
        pairs=names,
        left_out=left_out,
        lost=lost,
        failed=failed,
        unfollowed=tuple(unfollowed),
        settings=tuple(differing),
        notes=tuple(_notes(base, other)),
        families=judge_families(preset, rows, blocks, noise, floors, sectors, moved) if names else (),
        causes=_confirmed(causes, moved),
        objects=changes,
        n_blocks=n_blocks,
        blocking=blocking,
        by_direction=sectors is not None,
        on_partition=partition_note((base, other)),
        excess=excess,
    )


def _followed(base: FinishedRun, other: FinishedRun, names: Sequence[str]) -> tuple[pd.DataFrame, list[str]]:
    """Fates of the real objects of the pairs, and the pairs whose real objects differ."""
    parts = (
        object_parts(run.store, names, FOLLOWED_COLUMNS, by_reference=run.is_by_reference, sides=("real",))
        for run in (base, other)
    )
    found = [follow(before, after) for before, after in zip(*parts, strict=True)]
    none = pd.DataFrame(columns=CHANGE_COLUMNS)
    changes = pd.concat([own for own, _ in found], ignore_index=True) if found else none
    return changes, [names[i] for _, own in found for i in own]


def _blocks(base: FinishedRun, other: FinishedRun, names: Sequence[str], independent: bool) -> tuple[IntArray, str]:
    """The block of each pair, and how these were found.

    Neighbouring frames are recognised by their time stamps; real scans without one, by comparing them.
    """
    n, unit = len(names), "pair" if len(names) == 1 else "pairs"
    if independent:
        return np.arange(n, dtype=np.int32), (
            f"{n} {unit}, each counted as independent (--independent): the decision is about these scans only, not "
            "about other places"
        )
    known = base.record.times_s | other.record.times_s
    times_s = [known.get(name) for name in names]
    untimed = [i for i, time_s in enumerate(times_s) if time_s is None]
    links = neighbours(base.object_points(names[i]) for i in untimed)
    contents = [base.record.inputs[name]["real"] for name in names]
    blocks = blocks_of(contents, times_s, [(untimed[i], untimed[j]) for i, j in links])
    n_blocks = len(np.unique(blocks))
    found_by = "by comparing the scans" if untimed else "by time stamps"
    if n_blocks < n:
        return blocks, f"{n} {unit} form {n_blocks} block{'s' * (n_blocks != 1)} of neighbouring frames ({found_by})"
    why = "no time stamps, and no two scans show the same place" if untimed else f"{BLOCK_S:g} s apart or more"
    return blocks, f"{n} {unit}, taken as independent ({why})"


def _estimated(base: FinishedRun, other: FinishedRun, names: Sequence[str]) -> Iterator[_Estimates]:
    before, after = (Columns(run.row(name) for name in names) for run in (base, other))
    for kind in CAUSE_KINDS.values():
        real = np.abs(kind.sides(before)[0])
        real = real[~np.isnan(real)]
        tolerance = kind.tolerance + kind.relative * float(real.mean() if len(real) else 0.0)
        least, scale = _LEAST_OF_TOLERANCE * tolerance, kind.tolerance or 1.0
        yield kind, kind.value(before), kind.value(after), least, kind.tolerance, scale


def _diagnosed(base: FinishedRun, other: FinishedRun, names: Sequence[str]) -> Iterator[_Estimates]:
    found = [read_diagnosis(run.folder, run.record) for run in (base, other)]
    if not (found[0] and found[1]):
        return
    first = {estimate.name: estimate for estimate in found[0].estimates}
    for own in found[1].estimates:
        if own.name in first:
            before, after = (
                np.array([each.values.get(name, np.nan) for name in names]) for each in (first[own.name], own)
            )
            yield own, before, after, own.resolution, 0.0, own.resolution


def _changed(estimates: Iterable[_Estimates], blocks: IntArray) -> tuple[CauseChange, ...]:
    found = []
    for cause, before, after, least, without_interval, scale in estimates:
        own = paired_difference(before, after, blocks)
        if own.size > max(least, without_interval if own.half_width is None else own.half_width):
            found.append((own.size / scale, CauseChange(cause.name, cause.unit, cause.setting, own)))
    return tuple(change for _, change in sorted(found, key=lambda each: -each[0]))


def _confirmed(causes: tuple[CauseChange, ...], moved: MovedWorld | None) -> tuple[CauseChange, ...]:
    """The causes with what moved between the simulated scans, without displacements that these exclude."""
    if moved is None:
        return causes
    seen = [
        own
        for own in causes
        if own.name not in moved.measured or moved.allows(own.name, own.difference.difference or 0.0)
    ]
    known = {own.name for own in seen}
    first = [
        CauseChange(name, CAUSES[name].unit, CAUSES[name].setting, own)
        for name, own in moved.changes.items()
        if name not in known
    ]
    return (*first, *seen)


def _notes(base: FinishedRun, other: FinishedRun) -> list[str]:
    """Other things that can change a number: scans that are not in one frame or place, code of stages, libraries."""
    a, b = base.record, other.record
    unfit = [
        f"{run.folder}: the scans of {n} pair{'s' * (n > 1)} are not in one frame or show two places, but count "
        f"({next(iter(run.record.frames))}{' ...' * (n > 1)}); see fidpipe show {run.folder}"
        for run in (base, other)
        if (n := len(run.record.frames))
    ]
    stages = [f"code of stage {name}: {x} and {y}" for name, x, y in differences(a.stages, b.stages)]
    libraries = [f"library {name}: {x} and {y}" for name, x, y in differences(a.libraries, b.libraries)]
    return unfit + stages + libraries


def pairs_left_out(base: FinishedRun, other: FinishedRun) -> dict[str, str]:
    """Pairs that cannot be compared, and why."""
    rows = [{row["pair_id"]: row for row in run.rows} for run in (base, other)]
    why = {}
    for name in sorted(rows[0].keys() | rows[1].keys()):
        for run, own in zip((base, other), rows, strict=True):
            if name not in own:
                why[name] = f"not in {run.folder}"
            elif own[name]["status"] != "scored":
                why[name] = f"failed in {run.folder} ({own[name]['reason']})"
        if name not in why:
            a, b = (run.record.inputs.get(name, {}).get("real") for run in (base, other))
            if a is None or a != b:
                why[name] = "the real scans differ"
    return why


def _seed_noise(run: FinishedRun, names: Sequence[str]) -> dict[str, float]:
    """Difference of two means over the pairs that Louvain seeds alone can cause (95 %), by score.

    Only scores that are known of every pair under the same number of seeds.
    """
    repeats: dict[str, list[list[float]]] = {column: [] for column in SEEDED_SCORES}
    for name in names:
        record = run.store.ledger.job_of_file(table_name("seeds", name))
        if record is None:
            return {}
        for column, scores in repeats.items():
            scores.append(record.metadata["scores"][column])
    noise = {
        column: spread(np.array(scores, dtype=np.float64)).least_dataset
        for column, scores in repeats.items()
        if len({len(own) for own in scores}) == 1
    }
    return {column: least for column, least in noise.items() if least is not None}
