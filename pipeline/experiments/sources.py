"""The scans that an experiment works on, and the first stages on them, which all of its jobs share.

Leaves to others: what is done with them (`perturb`, `ablate`), how the stages are made (`jobs`).
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from ...schemas.errors import DatasetError, ScanError
from ...schemas.settings import Settings
from ..datasets.pairs import ScanPair, read_dataset, read_label_names
from ..datasets.readers import stem_of, suffix_of
from ..datasets.scan_checks import ScanFacts, input_name, inspect_scan, pair_warnings, recall_scan
from ..engine.costs import side_seconds
from ..engine.plan import library_versions, plan_pair, with_whole_results
from ..engine.runner import run_jobs
from ..engine.task import PairTask
from ..run import EXTRAS, STAGES, select_pairs
from ..storage.ledger import JobRecord
from ..storage.store import key_of
from .sweep import Call, Sweep


@dataclass(frozen=True)
class Source:
    """Scans to work on.

    pairs : from a dataset, or one with a real side alone
    label_names : class names by number
    is_scan : whether one scan file was named
    """

    pairs: tuple[ScanPair, ...]
    label_names: dict[int, str]
    is_scan: bool = False


def read_source(path: Path, pattern: str | None, *, first_only: bool = False) -> Source:
    """The scan file at a path, or the pairs of the dataset there.

    Parameters
    ----------
    path : a scan file or a dataset folder
    pattern : only pairs whose name matches (shell style)
    first_only : without a pattern the first pair alone

    Raises
    ------
    DatasetError
        There is nothing, the dataset is wrong, or no pair matches.
    """
    if path.is_file():
        if suffix_of(path) is None:
            raise ScanError(f"{path}: not a known scan format; a scan file or a dataset folder is wanted")
        if pattern is not None:
            raise DatasetError(f"--pairs {pattern!r}: {path} is one scan; a dataset folder is wanted with --pairs")
        folder = path.resolve().parent
        names = read_label_names(folder) or read_label_names(folder.parent)
        return Source((ScanPair(stem_of(path), path, None),), names, is_scan=True)
    dataset = read_dataset(path)
    pairs = select_pairs(dataset, pattern)
    return Source(pairs[:1] if first_only and pattern is None else pairs, dataset.label_names)


def prepare(
    sweep: Sweep, source: Source, settings: Settings, sides: Sequence[str], stages: Sequence[str]
) -> list[PairTask]:
    """The pairs with their first stages done; those that cannot be used are failures of the sweep.

    Parameters
    ----------
    sweep : the experiment's folder
    source : the scans
    settings : in force
    sides : which sides are wanted
    stages : names of the stages that are wanted, the first ones of the pipeline

    Raises
    ------
    ScanError
        One scan file was named, and it cannot be used.
    """
    planned = []
    for pair in source.pairs:
        facts = {side: of for side in sides if (of := _inspect(sweep, pair, side, settings, source)) is not None}
        lacks_scan = any(pair.path(side) is None for side in sides)  # that of a side not wanted may be missing
        faults = [pair.fault] if pair.fault and lacks_scan else [of.fault for of in facts.values() if of.fault]
        if faults and source.is_scan:
            raise ScanError("; ".join(faults))
        if faults:
            sweep.fail(pair.pair_id, "; ".join(faults))
            continue
        for text in pair_warnings(pair, facts):
            sweep.reporter.warn(f"{pair.pair_id}: {text}")
        planned.append(_plan(sweep, pair, facts, settings, source, stages))
    _forget_others(sweep, planned)
    n_points = {task.pair.pair_id: sum(_n_raw(sweep, task, side) for side in sides) for task in planned}
    sweep.call(
        Call(task.pair.pair_id, run_jobs, (task, _open_jobs(task)), side_seconds(n_points[task.pair.pair_id]))
        for task in planned
        if _open_jobs(task)
    )
    done = [with_whole_results(task, sweep.store)[0] for task in planned]
    sweep.n_reused += sum(bool(job.stored) for task in planned for job in task.jobs)
    return [task for task in done if not _open_jobs(task)]


def method_key(settings: Settings, stages: Iterable[str]) -> str:
    """A hash of what some stages compute with: their settings, their code versions and their libraries."""
    chosen = set(stages)
    return key_of(
        [
            [
                stage.name,
                stage.version,
                {group: getattr(settings, group).model_dump(mode="json") for group in stage.settings},
                library_versions(("numpy", "scipy", *stage.libraries(settings))),
            ]
            for stage in (*STAGES, *EXTRAS)
            if stage.name in chosen
        ]
    )


def _inspect(sweep: Sweep, pair: ScanPair, side: str, settings: Settings, source: Source) -> ScanFacts | None:
    """What is known of a scan file; read again only where it changed."""
    path = pair.path(side)
    if path is None:
        return None
    known = recall_scan(sweep.store.inputs, pair, side, settings.input)
    if known is not None:
        return known
    facts = inspect_scan(path, side, pair.T_real_sim, settings.input, source.label_names)
    sweep.store.note_input(input_name(pair, side), facts.as_dict())
    return facts


def _plan(
    sweep: Sweep,
    pair: ScanPair,
    facts: dict[str, ScanFacts],
    settings: Settings,
    source: Source,
    stages: Sequence[str],
) -> PairTask:
    inputs = {side: of.content.key(source.label_names) for side, of in facts.items()}
    wanted = [stage for stage in STAGES if stage.name in stages]
    task = plan_pair(wanted, pair, {"real": "", "sim": ""} | inputs, settings)
    return with_whole_results(
        replace(
            task,
            jobs=tuple(job for job in task.jobs if job.side in facts),
            label_names=source.label_names,
            input_hashes={side: of.sha256 for side, of in facts.items()},
            folder=sweep.out,
            token=sweep.store.token,
        ),
        sweep.store,
    )[0]


def _forget_others(sweep: Sweep, planned: list[PairTask]) -> None:
    wanted = {(job.stage, task.pair.pair_id, job.side): job for task in planned for job in task.jobs}
    unwanted: list[tuple[str, JobRecord]] = []
    for record in sweep.store.records.values():
        if record.stage not in {stage.name for stage in STAGES}:
            continue
        job = wanted.get(record.name)
        if job is None:
            unwanted.append(("not asked for", record))
        elif job.key != record.key:
            unwanted.append(("out of date", record))
        elif not job.stored:
            unwanted.append(("damaged or gone", record))
    sweep.forget(unwanted)
    for path in sweep.store.strays([table for stage in STAGES for table in stage.gives]):
        path.unlink()


def _open_jobs(task: PairTask) -> tuple[tuple[str, str], ...]:
    return tuple((job.stage, job.side) for job in task.jobs if not job.stored)


def _n_raw(sweep: Sweep, task: PairTask, side: str) -> int:
    return int(sweep.store.inputs.get(input_name(task.pair, side), {}).get("n_raw", 0))
