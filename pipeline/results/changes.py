"""Causes that changed from one run to another on the same real scans, with the verdict on each.

Amounts of the pose and the beams are measured between the two simulated scans, of which most surface is the same; all
others are differences of the amounts of both runs. What something outside the catalogue has changed also changes
estimates; so a change of the pose or of the world counts only if undoing it brings the two simulated scans closer.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

import numpy as np
import pandas as pd

from ...schemas.cause_catalogue import CAUSES, FLAT, PARAMETERS, CauseModel
from ...schemas.results import Cause, ChangedCause
from ...stages.arrays import FloatArray, IntArray, transform_of
from ...stages.causes.estimates import estimate_between
from ...stages.causes.gain import Shares, changes
from ...stages.causes.pose import fit_pose
from ...stages.causes.sides import Side, recorded_side
from ...stages.frame_search import FrameCheck
from ...stages.sensor_description import SensorDescription
from ...stages.statistics.bands import evenly
from ...stages.statistics.comparison import block_means
from ..engine.progress import Reporter
from ..engine.tasks import map_tasks
from ..jobs.gains_job import SEED
from ..jobs.points_job import cut_scan
from ..stage import FRAMES
from ..storage.folder import RunFolder
from ..storage.run_record import read_run
from .causes import (
    LEAST_PART_OF_POSE,
    CauseRows,
    cause_words,
    changed_causes,
    independent_blocks,
    read_causes,
    size_words,
)
from .diagnosis import LEAST_PART
from .finished import FinishedRun

Result = TypeVar("Result")
#: Pairs that are compared between the simulated scans, and of which corrections are tried, evenly over all.
MOST_BETWEEN, MOST_CORRECTED = 40, 10
#: Flat surface that is elsewhere than before is reported from this share on, if corrections bring back less than half.
LEAST_ELSEWHERE = 0.03
#: From this number of pairs on, processes are started.
_FEW = 8
#: Changes that must bring the simulated scans closer if they are undone: all that moves surface.
_CONFIRMED = frozenset(
    (
        *PARAMETERS,
        "elevation scale",
        "missing parts",
        "invented parts",
        "moved parts",
        "solid foliage",
        FLAT,
    )
)
#: Folders of two runs, a pair of both, and by cause the amount of the change to undo.
_Task = tuple[Path, Path, str, dict[str, float]]
#: Gains of undoing the changes, and the flat surface elsewhere before and after.
_Undone = tuple[Shares, float, float]
#: Part of the distance between the simulated scans from which a gain counts more than what no correction undoes.
_LEAST_GAIN = 0.1


@dataclass(frozen=True)
class Changes:
    """All causes that changed, those that moved most first.

    doubtful : seen, but undoing them does not bring the two simulated scans closer
    elsewhere : share of the flat surface that is elsewhere than before and that no cause explains; None if little is
    """

    causes: tuple[ChangedCause, ...] = ()
    doubtful: tuple[str, ...] = ()
    elsewhere: float | None = None


def find_changes(
    base: FinishedRun,
    other: FinishedRun,
    names: Sequence[str],
    blocks: IntArray,
) -> Changes:
    """The causes that changed by more than the resolution of their estimates.

    Parameters
    ----------
    names : pairs that both runs have scored
    blocks : (n,) independent place of each pair

    Raises
    ------
    RunError
        A table is damaged or gone.
    """
    before, after = read_causes(base.store, names), read_causes(other.store, names)
    between = _measure_between(base, other, names)
    confirmed = changed_causes(before, after, between, blocks)
    excess = {cause.name: cause.estimate for cause in confirmed}
    corrected = [names[i] for i in evenly(len(names), MOST_CORRECTED)]
    undone = _map_pairs(undo_changes, base, other, corrected, excess).values()
    doubtful: list[Cause] = []
    elsewhere = None
    if undone:
        confirmed, doubtful = confirm_changes(confirmed, [gains for gains, _, _ in undone])
        elsewhere = elsewhere_share([shares for _, *shares in undone])
    changed = [_with_verdict(cause, before, after, blocks) for cause in confirmed]
    return Changes(tuple(changed), tuple(cause.words for cause in doubtful), elsewhere)


def _is_same_scan(base: FinishedRun, other: FinishedRun, name: str) -> bool:
    return bool(base.record.inputs[name]["sim"] == other.record.inputs[name]["sim"])


def _map_pairs(
    function: Callable[[_Task], Result | None],
    base: FinishedRun,
    other: FinishedRun,
    names: Sequence[str],
    excess: dict[str, float],
) -> dict[str, Result]:
    """Results by pair, without those that are empty and those of one simulated scan in both runs."""
    tasks = {}
    for name in names:
        if not _is_same_scan(base, other, name):
            tasks[name] = (base.folder, other.folder, name, excess)
    n_workers = None if len(tasks) > _FEW else 1
    results, _ = map_tasks(function, tasks, Reporter(), n_workers=n_workers)
    return {name: result for name in tasks if (result := results.get(name))}


def _measure_between(
    base: FinishedRun, other: FinishedRun, names: Sequence[str]
) -> dict[str, FloatArray]:
    """By cause, the amounts between the two simulated scans, (n,), NaN for pairs that were not measured."""
    chosen = [names[i] for i in evenly(len(names), MOST_BETWEEN)]
    same = [name for name in chosen if _is_same_scan(base, other, name)]
    measured = _map_pairs(measure_between, base, other, chosen, {})
    if 2 * (len(same) + len(measured)) <= len(chosen):
        return {}
    amounts = pd.DataFrame.from_dict(measured, orient="index", dtype=np.float64)
    causes = amounts.columns.union([*PARAMETERS])
    amounts = amounts.reindex(index=[*names], columns=causes)
    amounts.loc[same] = 0.0
    return {cause: amounts[cause].to_numpy() for cause in causes}


def measure_between(task: _Task) -> dict[str, float]:
    """Amounts between the simulated scans of a pair; empty without enough surface in common, or in another frame."""
    *folders, pair_id, _ = task
    sides = []
    for folder in folders:
        frames = RunFolder(folder).ledger.jobs(pair_id)["sensor", "sim"].metadata.get(FRAMES)
        if frames and FrameCheck(**frames).is_other_frame:
            return {}
        sides.append(_sim_side(folder, pair_id))
    found = estimate_between(*sides)
    return {} if found is None else found[1]


def _sim_side(folder: Path, pair_id: str) -> Side:
    """The simulated side of a pair of a run."""
    store = RunFolder(folder)
    ground = store.read_table("ground", pair_id, "sim")
    jobs = store.ledger.jobs(pair_id)
    sensor = SensorDescription(**jobs["sensor", "sim"].metadata["sensor"])
    moved = jobs["ground", "sim"].metadata["T_real_sim"]
    settings = read_run(folder)["settings"]["input"]
    return recorded_side(
        cut_scan(ground),
        sensor,
        transform_of(moved),
        settings.get("sensor_position"),
        settings.get("voxel_m"),
    )


def confirm_changes(
    found: Sequence[Cause], gains: Sequence[Shares]
) -> tuple[list[Cause], list[Cause]]:
    """The changes that are not feigned by another one, and the others.

    First are those whose undoing removes a tenth of the distance between the simulated scans or more, by this gain;
    then those that no correction undoes; last the others. What moves surface is feigned if undoing it explains too
    little of the distance that the others leave.

    Parameters
    ----------
    found : from `changed_causes`
    gains : of undoing the changes, of each pair
    """
    before_m = float(np.mean([pair.before_m for pair in gains]))
    after_m = float(np.mean([pair.after_m for pair in gains]))
    rank: dict[str, float] = {}
    doubtful = []
    for cause in found:
        if cause.name not in gains[0].by_cause:
            rank[cause.name] = _LEAST_GAIN
            continue
        gain_m = float(np.mean([pair.by_cause[cause.name] for pair in gains]))
        rank[cause.name] = gain_m / max(before_m, 1e-9)
        least = LEAST_PART_OF_POSE if cause.name in PARAMETERS else LEAST_PART
        if cause.name in _CONFIRMED and gain_m <= least * (gain_m + after_m):
            doubtful.append(cause)
    confirmed = [cause for cause in found if cause not in doubtful]
    return sorted(confirmed, key=lambda cause: -rank[cause.name]), doubtful


def elsewhere_share(shares: Sequence[Sequence[float]]) -> float | None:
    """Share of flat surface that remains elsewhere after all corrections; None if little, or less than half, does.

    Parameters
    ----------
    shares : of each pair, before and after all corrections
    """
    before, after = np.mean(shares, axis=0).tolist()
    return after if after >= LEAST_ELSEWHERE and after > before / 2 else None


def undo_changes(task: _Task) -> _Undone | None:
    """Gains of undoing the changes of a pair, and the flat surface elsewhere before and after."""
    base_folder, other_folder, pair_id, excess = task
    base, sim = _sim_side(base_folder, pair_id), _sim_side(other_folder, pair_id)
    fit = fit_pose(base, sim)
    if fit is None:
        return None
    return changes(base, sim, fit[0], excess, np.random.default_rng(SEED))


def _with_verdict(
    cause: Cause, before: CauseRows, after: CauseRows, blocks: IntArray
) -> ChangedCause:
    """A change with the amounts of both runs, its verdict, and both amounts in its words if there was one before."""
    resolution = CAUSES[cause.name].resolution
    first = _mean(before[cause.name], blocks)
    last = _mean(after[cause.name], blocks)
    if cause.name in PARAMETERS:
        last = None if first is None else first + cause.estimate
    verdict = _verdict(first, last, resolution) if cause.kind == "sensor" else ""
    words = cause.words
    if first is not None and last is not None and abs(first) > resolution:
        words = _words_of_both(CAUSES[cause.name], first, last)
    update = {"before": first, "after": last, "verdict": verdict, "words": words}
    return ChangedCause(**cause.model_dump(exclude_unset=True) | update)


def _words_of_both(model: CauseModel, before: float, after: float) -> str:
    """A cause with its amounts in both runs."""
    if abs(after) <= model.resolution:
        sign = "-" if before < 0 else "+"
        return (
            f"{model.name}: no difference left, before {sign}{size_words(before, model.unit)}"
        )
    is_alike = (before < 0) == (after < 0)
    size = size_words(before, model.unit) if is_alike else cause_words(model, before)
    return f"{cause_words(model, after)}, before {size}"


def _mean(rows: pd.DataFrame, blocks: IntArray) -> float | None:
    """Mean over places of the amounts of a cause that are known; None if none is."""
    means = block_means(rows["amount"].to_numpy(), independent_blocks(blocks))
    return None if np.isnan(means).all() else float(np.nanmean(means))


def _verdict(before: float | None, after: float | None, resolution: float) -> str:
    """Worse or better by the distance from no flaw."""
    if after is None:
        return "changed"
    if before is None:
        return "worse" if abs(after) > resolution else "changed"
    nearer = abs(before) - abs(after)
    if abs(nearer) <= resolution / 2:
        return "changed"
    return "better" if nearer > 0 else "worse"
