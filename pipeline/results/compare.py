"""Compares finished runs of the same real scans: simulator versions, the first one being the base of the others.

Pairs are the same if they have the same name and the same real scan, by content. CDC and r_lambda are also compared
over those objects alone that both runs have matched (`followed`).
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Container, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np

from ...schemas.errors import DatasetError, RunError
from ...schemas.metrics import METRIC, SEEDED_SCORES, metric_of
from ...schemas.results import JsonObject
from ...stages.arrays import IntArray
from ...stages.statistics.comparison import (
    KINDS,
    Difference,
    blocks_of,
    direction,
    far_beyond_noise,
    holm,
    judge,
    paired_difference,
)
from ...stages.statistics.spread import spread
from ..datasets.pairs import read_dataset
from ..storage.tables import table_name
from .finished import FinishedRun, differences, partition_note, settings_changes
from .floor import RunExcess, excess_over
from .followed import SHARED_SCORES, GroupChange, ObjectChange, by_class, by_range, follow, same_real_side

#: What is compared: columns of `pairs`.
SCORES = (
    "match_rate",
    "n_missing",
    "n_hallucinated",
    "cdc_mean",
    "r_lambda_mean",
    "r_gap_mean",
    "centroid_distance_m_mean",
    "alignment_rms_m_mean",
    "covered_real_0p3m",
    "covered_sim_0p3m",
)
#: So many runs fit into one table, and into one look.
MOST_RUNS = 8


@dataclass(frozen=True)
class ScoreChange:
    """A score of the dataset before and after.

    of_pairs : by pair, after less before; None where a value is null
    verdict : better, worse, same or undecided; over all scores together it is by chance in under 5 % of the cases
    p : how often chance makes so large a difference of one of all the scores (Holm); None without an interval
    floor : what measuring again does to the score: how far the floor's mean is from equal scans; None where unknown
    is_far : whether it moved farther than any noise that is known, however few pairs there are
    seed_noise : by so much the two means differ at most in 95 % of the cases through Louvain seeds alone; where both
        runs have `seeds`. Too large rather than too small, for the runs share the real side's communities
    """

    name: str
    higher_is_better: bool
    difference: Difference
    verdict: str
    of_pairs: dict[str, float | None]
    seed_noise: float | None = None
    p: float | None = None
    is_far: bool = False
    floor: float | None = None

    @property
    def direction(self) -> str:
        """Which way it moved, better or worse, whether that is decided or not; "" where it did not."""
        change = self.difference.difference
        return direction(change, self.higher_is_better) if change else ""

    @property
    def called(self) -> str:
        """The verdict; also worse where it moved to the worse far beyond the noise, though too few pairs decide.

        That is not enough for better: a simulator that loses objects also invents fewer.
        """
        return "worse" if self.is_far and self.direction == "worse" else self.verdict

    @property
    def beyond_seeds(self) -> bool | None:
        """Whether the difference is more than seeds make; None where that is not known."""
        if self.seed_noise is None or self.difference.difference is None:
            return None
        return abs(self.difference.difference) > self.seed_noise

    @property
    def beyond_floor(self) -> bool | None:
        """Whether the difference is more than measuring again makes; None where that is not known."""
        if self.floor is None or self.difference.difference is None:
            return None
        return abs(self.difference.difference) > self.floor


@dataclass(frozen=True)
class Comparison:
    """One run against the base.

    pairs : names of the pairs that are compared
    left_out : by pair, why it is not compared
    lost : of these, the pairs that the base has scored
    failed : of these, the pairs that failed in the other run, whose means would else look better without them
    unfollowed : pairs whose real communities differ, so that their objects cannot be followed
    settings : settings that differ, in words
    notes : what else differs
    n_blocks : independent pairs: copies of a scan, and scans within 10 s, count once
    has_times : whether the dataset says when its scans were taken
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
    scores: tuple[ScoreChange, ...]
    objects: tuple[ObjectChange, ...]
    n_blocks: int
    has_times: bool
    on_partition: str
    excess: tuple[RunExcess, RunExcess] | None = None

    @property
    def decision(self) -> str:
        """Of all scores together: worse where one is or a pair fails that did not, else better, same or undecided."""
        called = {score.called for score in self.scores}
        if self.failed or "worse" in called:
            return "worse"
        return "better" if "better" in called else "same" if called == {"same"} else "undecided"

    @property
    def kinds(self) -> dict[str, int]:
        """How many real objects have become what."""
        count = Counter(change.kind for change in self.objects)
        return {kind: count[kind] for kind in KINDS}

    @property
    def by_class(self) -> tuple[GroupChange, ...]:
        """What has become of the real objects of each class, or shape."""
        return by_class(self.objects)

    @property
    def by_range(self) -> tuple[GroupChange, ...]:
        """What has become of the real objects of each band of range."""
        return by_range(self.objects)

    def as_dict(self) -> JsonObject:
        """Plain values, for programs."""
        excess = None if self.excess is None else [each.as_dict() for each in self.excess]
        groups = {"by_class": self.by_class, "by_range": self.by_range}
        return (
            asdict(replace(self, excess=None))
            | {"base": str(self.base), "other": str(self.other), "decision": self.decision}
            | {"kinds": self.kinds, "excess": excess}
            | {name: [asdict(group) for group in own] for name, own in groups.items()}
        )


def compare_runs(
    folders: Sequence[Path], *, allow_different_settings: bool = False, floor: Path | None = None
) -> list[Comparison]:
    """Each run but the first against the first.

    Parameters
    ----------
    floor : the run of fidpipe floor of the same real scans; all runs then need its settings

    Raises
    ------
    RunError
        A folder is no finished run, settings that change scores differ and that is not allowed, no pair is common, or
        the floor is another's.
    """
    base, *others = [FinishedRun(folder) for folder in folders]
    return [compare_two(base, other, allow_different_settings, floor) for other in others]


def compare_two(
    base: FinishedRun,
    other: FinishedRun,
    allow_different_settings: bool = False,
    floor: Path | None = None,
    only: Container[str] | None = None,
) -> Comparison:
    """One run against another, as `compare_runs` does.

    Parameters
    ----------
    only : names of pairs to compare; by default all that can be
    """
    differing = settings_changes(base, other)
    if differing and not allow_different_settings:
        raise RunError(
            f"runs {base.folder} and {other.folder}: settings differ ({'; '.join(differing)}), so that a "
            "difference need not be the simulator's; evaluate both alike, or give --allow-different-settings"
        )
    left_out = pairs_left_out(base, other)
    comparable = [row["pair_id"] for row in base.scored if row["pair_id"] not in left_out]
    names = tuple(name for name in comparable if only is None or name in only)
    lost = tuple(row["pair_id"] for row in base.scored if row["pair_id"] in left_out)
    tried = {row["pair_id"] for row in other.rows}
    failed = tuple(name for name in lost if name in tried and other.row(name)["status"] != "scored")
    if not comparable and not failed:
        why = "; ".join(f"{name!r}: {reason}" for name, reason in list(left_out.items())[:3])
        raise RunError(f"runs {base.folder} and {other.folder}: no pair can be compared ({why or 'none is scored'})")
    changes: dict[str, list[ObjectChange]] = {}
    for name in names:
        before, after = base.objects_of(name), other.objects_of(name)
        if same_real_side(before, after):
            changes[name] = follow(name, before, after)
    excess = None if floor is None or not names else (excess_over(base, floor, names), excess_over(other, floor, names))
    times_s = recorded_times_s(base, other)
    blocks = blocks_of([base.record.inputs[name]["real"] for name in names], [times_s.get(name) for name in names])
    scores = [
        *(_score_change(base, other, names, column, blocks, excess and excess[0]) for column in SCORES),
        *(_shared_change(score, {name: changes.get(name, []) for name in names}, blocks) for score in SHARED_SCORES),
    ]
    return Comparison(
        base=base.folder,
        other=other.folder,
        pairs=names,
        left_out=left_out,
        lost=lost,
        failed=failed,
        unfollowed=tuple(name for name in names if name not in changes),
        settings=tuple(differing),
        notes=tuple(_notes(base, other)),
        scores=tuple(_judged(scores)),
        objects=tuple(change for own in changes.values() for change in own),
        n_blocks=len(np.unique(blocks)),
        has_times=bool(times_s),
        on_partition=partition_note((base, other)),
        excess=excess,
    )


def recorded_times_s(*runs: FinishedRun) -> dict[str, float]:
    """When the real scans were taken, by pair; {} where no dataset that says so is on this machine."""
    times_s: dict[str, float] = {}
    for run in runs:
        try:
            pairs = read_dataset(Path(run.record.dataset)).pairs
        except (DatasetError, OSError):
            continue
        times_s |= {pair.pair_id: pair.timestamp_s for pair in pairs if pair.timestamp_s is not None}
    return times_s


def _judged(scores: Sequence[ScoreChange]) -> list[ScoreChange]:
    """The scores with their verdicts, which stand together: the more scores, the more chances to differ by chance."""
    p_values = holm([score.difference.p for score in scores])
    far = far_beyond_noise([score.difference for score in scores], [score.seed_noise for score in scores])
    return [
        replace(
            score,
            verdict=judge(score.difference, score.higher_is_better, p, score.seed_noise),
            p=p,
            is_far=is_far,
        )
        for score, p, is_far in zip(scores, p_values, far, strict=True)
    ]


def _notes(base: FinishedRun, other: FinishedRun) -> list[str]:
    """What else differs and can change a number: stage code and libraries."""
    a, b = base.record, other.record
    stages = [f"code of stage {name}: {x} and {y}" for name, x, y in differences(a.stages, b.stages)]
    return stages + [f"library {name}: {x} and {y}" for name, x, y in differences(a.libraries, b.libraries)]


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


def _score_change(
    base: FinishedRun,
    other: FinishedRun,
    names: Sequence[str],
    column: str,
    blocks: IntArray,
    excess: RunExcess | None,
) -> ScoreChange:
    values = {name: (base.row(name)[column], other.row(name)[column]) for name in names}
    a, b = (_seed_noise(run, names, column) for run in (base, other))
    noise = None if a is None or b is None else float(np.hypot(a, b) / np.sqrt(2))
    metric = metric_of(column)
    change = _change(metric.label, metric.higher_is_better, values, blocks, noise)
    return replace(change, floor=None if excess is None else excess.scores[column].floor_from_equal)


def _shared_change(score: str, changes: Mapping[str, Sequence[ObjectChange]], blocks: IntArray) -> ScoreChange:
    """The means of a score by pair over the objects that have it in both runs."""
    means: dict[str, tuple[float | None, float | None]] = {}
    for name, own in changes.items():
        both = [(getattr(change, f"{score}_before"), getattr(change, f"{score}_after")) for change in own]
        known = [values for values in both if None not in values]
        before, after = (float(np.mean(values)) for values in zip(*known, strict=True)) if known else (None, None)
        means[name] = before, after
    metric = METRIC[score]
    return _change(f"{metric.label} (objects in both)", metric.higher_is_better, means, blocks)


def _change(
    heading: str,
    higher_is_better: bool,
    values: dict[str, tuple[float | None, float | None]],
    blocks: IntArray,
    seed_noise: float | None = None,
) -> ScoreChange:
    """The change of a score, yet without a verdict."""
    before, after = np.array([*values.values()], dtype=np.float64).reshape(-1, 2).T  # None becomes NaN
    difference = paired_difference(before, after, blocks)
    of_pairs = {name: None if a is None or b is None else b - a for name, (a, b) in values.items()}
    return ScoreChange(heading, higher_is_better, difference, "undecided", of_pairs, seed_noise)


def _seed_noise(run: FinishedRun, names: Sequence[str], column: str) -> float | None:
    """What two means over the pairs may differ by through Louvain seeds alone (95 %); None without repeats of all."""
    if column not in SEEDED_SCORES or not names:
        return None
    records = [run.store.ledger.job_of_file(table_name("seeds", name)) for name in names]
    repeats = [record.facts["scores"][column] for record in records if record is not None]
    n_seeds = {len(scores) for scores in repeats}
    if len(repeats) < len(names) or len(n_seeds) != 1:
        return None
    return spread(np.array(repeats, dtype=np.float64)).least_dataset
