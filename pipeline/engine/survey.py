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
    redo: frozenset[str] = frozenset(),
    complete: Callable[[PairPlan], None] = lambda _: None,
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
    names = set()
    for pair in pairs:
        names.add(pair.pair_id)
        if pair.pair_id not in files.contents or pair.pair_id in files.faults:
            continue
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
    for pair_id in folder.ledger.pair_ids():
        if pair_id in names and pair_id not in files.faults:
            continue
        reason = "the input cannot be used" if pair_id in files.faults else _GONE
        for record in folder.ledger.jobs(pair_id).values():
            survey.stale[record.name] = reason
    return survey


def refuse_replacing(
    survey: Survey,
    name: str,
    before: Mapping[str, Any],
    stages: Iterable[Stage],
    settings: Settings,
) -> None:
    """Raise `RunError` if finished results would be replaced because of settings or version.

    Those recomputed because of other input files or libraries are replaced too.

    Parameters
    ----------
    name : of the results, for the error
    before : last record of the folder
    stages : of the run, with `settings`
    """
    lost = [job for job, reason in survey.stale.items() if reason == OUT_OF_DATE]
    if not lost or not has_ended(before):
        return
    names = {stage for stage, _, _ in lost}
    stages = [stage for stage in stages if stage.name in names]
    why = _reasons(before, stages, settings)
    if why:
        n_pairs = len({pair_id for _, pair_id, _ in lost})
        listed = _in_order(names, stages)
        refuse_overwrite(name, f"{listed} of {n_pairs} pair{'s' if n_pairs > 1 else ''}", why)


def _reasons(before: Mapping[str, Any], stages: Sequence[Stage], settings: Settings) -> list[str]:
    """Changes of preset, settings and code since the last record that concern some stages, as text."""
    groups = {group for stage in stages for group in stage.settings}
    why = []
    for group, texts in changed_settings(before, settings).items():
        if group in groups:
            why += texts
    preset = preset_of(settings)
    if why and before.get("preset", preset) != preset:
        why.insert(0, f"preset was {before['preset']}, is {preset}")
    versions = before.get("stages", {})
    old = [
        stage.name for stage in stages if versions.get(stage.name, stage.version) != stage.version
    ]
    if old:
        written = f"fidpipe {before.get('fidpipe')} on {before.get('written', '')[:10]}"
        why.append(f"{written} had other code of {', '.join(old)}")
    return why


def remove_stale(
    survey: Survey,
    folder: RunFolder,
    stages: Sequence[Stage],
    reporter: Reporter,
    changes: Sequence[str] = (),
) -> None:
    """Report which results are replaced or removed and why, and remove them.

    Parameters
    ----------
    stages : in the order in which they are named
    changes : since the last run, as text
    """
    by_reason: dict[str, defaultdict[str, set[JobId]]] = {}
    for (stage, pair_id, part), reason in survey.stale.items():
        jobs_of_pairs = by_reason.setdefault(reason, defaultdict(set))
        jobs_of_pairs[pair_id].add((stage, part))
    for reason, jobs_of_pairs in by_reason.items():
        names = {stage for jobs in jobs_of_pairs.values() for stage, _ in jobs}
        why = reason
        if reason == OUT_OF_DATE:
            why = f"{reason} ({'; '.join(changes) or 'the input files changed'})"
        n_pairs = len(jobs_of_pairs)
        pairs = f"{n_pairs} pair{'s' if n_pairs > 1 else ''}"
        reporter.say(f"replacing {_in_order(names, stages)} of {pairs}: {why}")
        for pair_id, jobs in jobs_of_pairs.items():
            folder.forget(pair_id, jobs)
    n_strays = folder.remove_strays()
    if n_strays:
        files = f"{n_strays} file{'s' if n_strays > 1 else ''}"
        reporter.say(f"removing {files} that no finished job accounts for")
    folder.ledger.save_hashes()


def _in_order(names: set[str], stages: Iterable[Stage]) -> str:
    """Names of stages in the order of the run, then those that it does not know."""
    known = [stage.name for stage in stages if stage.name in names]
    return ", ".join([*known, *sorted(names - set(known))])
