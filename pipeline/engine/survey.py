"""What a run has to do: its input files, the jobs without a result, and results that are stale."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping, Sequence
from itertools import chain
from typing import Any

from ...schemas.errors import ScanError
from ...schemas.settings import Settings, preset_of
from ..datasets.content import ScanContent, scan_content
from ..datasets.pairs import ScanPair
from ..stage import Stage
from ..storage.folder import RunFolder
from ..storage.table_files import JobId, JobName
from .plan import OUT_OF_DATE, PairPlan
from .progress import Reporter

PlanPair = Callable[[ScanPair], PairPlan]
Contents = dict[str, dict[str, ScanContent]]  #: of files, by pair_id and side


def hash_files(pairs: Iterable[ScanPair], folder: RunFolder) -> tuple[Contents, dict[str, str]]:
    """Contents of the files of pairs by hash, without parsing them; and reasons why pairs cannot be evaluated."""
    all_contents = {}
    faults = {}
    for pair in pairs:
        contents = {}
        reasons = [pair.fault] if pair.fault else []
        for side, scan in pair.scans.items():
            try:
                contents[side] = scan_content(scan, folder.ledger.input_hash)
            except ScanError as error:
                reasons.append(str(error))
        if len(contents) == len(pair.scans):
            all_contents[pair.pair_id] = contents
        if reasons:
            faults[pair.pair_id] = "; ".join(reasons)
    return all_contents, faults


def what_changed(
    before: Mapping[str, Any], settings: Settings, stages: Sequence[Stage]
) -> list[str]:
    """Changes of preset, settings and code since the last record that concern some stages, as text."""
    changes = []
    for group in dict.fromkeys(chain.from_iterable(stage.settings for stage in stages)):
        was = before.get("settings", {}).get(group, {})
        for name, value in getattr(settings, group).model_dump(mode="json").items():
            if was.get(name) != value:
                changes.append(f"{group}.{name} was {was.get(name)}, is {value}")
    versions = before.get("stages", {})
    made_by = f"fidpipe {before.get('fidpipe')} on {before.get('written', '')[:10]}"
    for stage in stages:
        if versions.get(stage.name, stage.version) != stage.version:
            changes.append(f"{made_by} had other code of stage {stage.name}")
    preset = preset_of(settings)
    if changes and before.get("preset", preset) != preset:
        changes.insert(0, f"preset was {before['preset']}, is {preset}")
    return changes


def remove_stale(
    stale: Mapping[JobName, str], folder: RunFolder, reporter: Reporter, changes: Sequence[str]
) -> None:
    """Report which results are replaced and why, and remove them, along with files of no finished job.

    Parameters
    ----------
    stale : finished jobs whose results are no longer valid, each with the reason
    changes : changes since the last run, as text
    """
    jobs_of_pairs: defaultdict[str, set[JobId]] = defaultdict(set)
    for stage, pair_id, part in stale:
        jobs_of_pairs[pair_id].add((stage, part))
    for reason in dict.fromkeys(stale.values()):
        why = reason
        if reason == OUT_OF_DATE:
            why = f"{reason} ({'; '.join(changes) or 'the input files or libraries changed'})"
        names = [name for name in stale if stale[name] == reason]
        reporter.say(f"replacing {jobs_in_words(names)}: {why}")
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
