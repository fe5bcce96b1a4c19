"""What a run has to do: its input files, the jobs without a result, and results that are stale."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from ...schemas.columns import SIDES
from ...schemas.errors import ScanError
from ...schemas.settings import Settings, preset_of
from ..datasets.content import ScanContent, scan_content
from ..datasets.pairs import ScanPair
from ..stage import Stage
from ..storage.folder import RunFolder
from ..storage.run_record import changed_settings
from ..storage.table_files import JobId, JobName
from .plan import OUT_OF_DATE, PairPlan
from .progress import Reporter

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
    failures : reasons by pair_id of other pairs, which failed in an earlier run
    """

    usable: list[ScanPair] = field(default_factory=list)
    todo: list[ScanPair] = field(default_factory=list)
    stale: dict[JobName, str] = field(default_factory=dict)
    n_jobs: int = 0
    failures: dict[str, str] = field(default_factory=dict)


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


def what_changed(
    before: Mapping[str, Any], settings: Settings, stages: Iterable[Stage]
) -> list[str]:
    """Changes of preset, settings and code since the last record that concern some stages, as text."""
    by_group = changed_settings(before, settings)
    versions = before.get("stages", {})
    made_by = f"fidpipe {before.get('fidpipe')} on {before.get('written', '')[:10]}"
    changes = []
    for stage in stages:
        for group in stage.settings:
            changes += by_group.pop(group, [])
        if versions.get(stage.name, stage.version) != stage.version:
            changes.append(f"{made_by} had other code of stage {stage.name}")
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
        reporter.say(f"replacing {jobs_in_words(names)}: {why}")
        jobs_of_pairs: defaultdict[str, set[JobId]] = defaultdict(set)
        for stage, pair_id, part in names:
            jobs_of_pairs[pair_id].add((stage, part))
        for pair_id, jobs in jobs_of_pairs.items():
            folder.forget(pair_id, jobs)
    n_strays = folder.remove_strays()
    if n_strays:
        reporter.say(f"removing files that no finished job accounts for: {n_strays}")
    folder.ledger.save_hashes()


def jobs_in_words(names: Sequence[JobName]) -> str:
    """Stages of jobs in their order, and the number of their pairs."""
    stages = dict.fromkeys(stage for stage, _, _ in names)
    n_pairs = len({pair_id for _, pair_id, _ in names})
    return f"{', '.join(stages)} of {n_pairs} pair{'s' if n_pairs > 1 else ''}"
