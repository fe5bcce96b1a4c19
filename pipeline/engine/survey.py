"""What a run has to do: its input files, the jobs without a result, and results that are stale."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Container, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from ...schemas.columns import SIDES
from ...schemas.errors import ScanError
from ...schemas.settings import Settings, preset_of
from ..datasets.content import ScanContent, scan_content
from ..datasets.pairs import ScanPair
from ..stage import Stage
from ..storage.folder import RunFolder, refuse_overwrite
from ..storage.run_record import changed_settings, has_ended
from ..storage.table_files import JobId, JobName
from .plan import OUT_OF_DATE, PairPlan, with_results
from .progress import Reporter

_GONE = "no longer in the dataset"

PlanPair = Callable[[ScanPair], PairPlan]


@dataclass
class InputFiles:
    """The input files of pairs.

    contents : by pair_id and side, of pairs whose existing files can all be hashed
    faults : reasons why pairs cannot be evaluated, by pair_id
    """

    contents: dict[str, dict[str, ScanContent]] = field(default_factory=dict)
    faults: dict[str, str] = field(default_factory=dict)

    def n_points(self, pair: ScanPair) -> int:
        """Points of both files of a pair, estimated from their size."""
        contents = self.contents[pair.pair_id].values()
        return sum(content.approximate_points for content in contents)


@dataclass
class Survey:
    """Comparison of existing results with the plan.

    usable : pairs whose files exist
    todo : selected pairs among them that have jobs to do
    stale : finished jobs whose results are no longer needed, each with the reason
    n_jobs : jobs to do, of the pairs in `todo`
    """

    usable: list[ScanPair] = field(default_factory=list)
    todo: list[ScanPair] = field(default_factory=list)
    stale: dict[JobName, str] = field(default_factory=dict)
    n_jobs: int = 0


def hash_files(pairs: Iterable[ScanPair], folder: RunFolder) -> InputFiles:
    """The contents of the files of pairs, none of which is parsed; a pair with a missing or empty file has a fault."""
    files = InputFiles()
    for pair in pairs:
        contents = {}
        reasons = []
        for side in SIDES:
            scan = pair.scans.get(side)
            try:
                if scan is not None:
                    contents[side] = scan_content(scan, folder.ledger.input_hash)
                elif pair.fault and pair.fault not in reasons:
                    reasons.append(pair.fault)
            except ScanError as error:
                reasons.append(str(error))
        if len(contents) == len(pair.scans):
            files.contents[pair.pair_id] = contents
        if reasons:
            files.faults[pair.pair_id] = "; ".join(reasons)
    return files


def survey_results(
    pairs: Iterable[ScanPair],
    files: InputFiles,
    plan_pair: PlanPair,
    folder: RunFolder,
    *,
    selected: Container[str],
    redo: frozenset[str],
    complete: Callable[[PairPlan], None],
) -> Survey:
    """Compare existing results with the plan.

    Parameters
    ----------
    pairs : all pairs that may have results
    files : of those that are selected or have results
    plan_pair : returns the plan of a pair
    selected : names of the pairs to work on
    redo : stages of the selected pairs to recompute regardless of their keys
    complete : called with the plan of each pair without jobs to do, so that its records are read
        once
    """
    survey = Survey()
    reasons = dict.fromkeys(folder.ledger.pair_ids(), _GONE)
    for pair in pairs:
        reasons.pop(pair.pair_id, None)
        if pair.pair_id in files.faults:
            reasons[pair.pair_id] = "the input cannot be used"
        elif pair.pair_id in files.contents:
            survey.usable.append(pair)
            is_selected = pair.pair_id in selected
            redone = redo if is_selected else frozenset[str]()
            plan, stale = with_results(plan_pair(pair), folder, redone)
            survey.stale |= stale
            if not plan.todo:
                complete(plan)
            elif is_selected:
                survey.todo.append(pair)
                survey.n_jobs += len(plan.todo)
    for pair_id, reason in reasons.items():
        for record in folder.ledger.jobs(pair_id).values():
            survey.stale[record.name] = reason
    return survey


def refuse_replacing(
    survey: Survey,
    folder: RunFolder,
    before: Mapping[str, Any],
    stages: Iterable[Stage],
    settings: Settings,
) -> None:
    """Raise `RunError` if finished results would be replaced because of settings or version.

    Those recomputed because of other input files or libraries are replaced too.

    Parameters
    ----------
    before : last record of the folder
    stages : of the run, with `settings`
    """
    lost = [name for name, reason in survey.stale.items() if reason == OUT_OF_DATE]
    if lost and has_ended(before):
        names = {stage for stage, _, _ in lost}
        why = what_changed(before, settings, [stage for stage in stages if stage.name in names])
        if why:
            refuse_overwrite(f"run {folder.folder}", _jobs_in_words(lost), why)


def what_changed(
    before: Mapping[str, Any], settings: Settings, stages: Iterable[Stage]
) -> list[str]:
    """Changes of preset, settings and code since the last record that concern some stages, as text."""
    by_group = changed_settings(before, settings)
    versions = before.get("stages", {})
    changes = []
    for stage in stages:
        for group in stage.settings:
            changes += by_group.pop(group, [])
        if versions.get(stage.name, stage.version) != stage.version:
            changes.append(f"code of stage {stage.name} is new")
    preset = preset_of(settings)
    if changes and before.get("preset", preset) != preset:
        changes.insert(0, f"preset was {before['preset']}, is {preset}")
    return changes


def remove_stale(
    survey: Survey, folder: RunFolder, reporter: Reporter, changes: Sequence[str]
) -> None:
    """Report which results are replaced or removed and why, and remove them.

    Parameters
    ----------
    changes : since the last run, as text
    """
    by_reason: defaultdict[str, list[JobName]] = defaultdict(list)
    for name, reason in survey.stale.items():
        by_reason[reason].append(name)
    for reason, names in by_reason.items():
        why = reason
        if reason == OUT_OF_DATE:
            why = f"{reason} ({'; '.join(changes) or 'the input files or libraries changed'})"
        reporter.say(f"replacing {_jobs_in_words(names)}: {why}")
        jobs_of_pairs: defaultdict[str, set[JobId]] = defaultdict(set)
        for stage, pair_id, part in names:
            jobs_of_pairs[pair_id].add((stage, part))
        for pair_id, jobs in jobs_of_pairs.items():
            folder.forget(pair_id, jobs)
    n_strays = folder.remove_strays()
    if n_strays:
        reporter.say(f"removing files that no finished job accounts for: {n_strays}")
    folder.ledger.save_hashes()


def _jobs_in_words(names: Sequence[JobName]) -> str:
    """Stages of jobs in their order, and the number of their pairs."""
    stages = dict.fromkeys(stage for stage, _, _ in names)
    n_pairs = len({pair_id for _, pair_id, _ in names})
    return f"{', '.join(stages)} of {n_pairs} pair{'s' if n_pairs > 1 else ''}"
