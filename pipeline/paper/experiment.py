"""Common parts of the experiments perturb and ablate: scans, one task per pair, folder and record.

The tables of a pair are one result with one key: it is reused as long as the key is the same.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa

from ...schemas.columns import Row
from ...schemas.errors import DatasetError, ScanError
from ...schemas.settings import Settings
from ...schemas.tables import TABLES
from ...stages.summary import mean_and_std
from ..datasets.content import scan_content
from ..datasets.pairs import Dataset, ScanPair, may_crash, read_dataset, read_label_names
from ..datasets.readers import read_scan
from ..datasets.readers.scan import Scan
from ..datasets.readers.scan_ref import scan_ref
from ..engine.progress import Reporter
from ..engine.tasks import map_tasks
from ..run import select_pairs
from ..stage import JobResult, Stage
from ..storage.files import key_of
from ..storage.folder import RunFolder, check_folder, refuse_overwrite
from ..storage.run_record import (
    changed_settings,
    has_ended,
    library_versions,
    read_run,
    run_header,
    write_record,
)
from ..storage.table_files import JobRecord, TableFolder, plain_metadata

#: Arguments of an experiment as plain values, which `run.json` keeps.
Request = Mapping[str, Any]


@dataclass(frozen=True, kw_only=True)
class Experiment:
    """Definition of an experiment.

    name : of the command
    version : of its code; increase it when the same request results in other numbers
    sides : sides of a pair whose scans it reads
    stages : stages whose code it uses
    tables : its tables over all pairs
    summary : table of means over all pairs
    evaluate : from a pair, its scans by side, settings and request: the tables of the pair, with
        metadata; "warnings" and "notes" among it are shown to the user
    summarise : from `tables` of all pairs by name, the rows of `summary`
    """

    name: str
    version: int
    sides: tuple[str, ...]
    stages: tuple[Stage, ...]
    tables: tuple[str, ...]
    summary: str
    evaluate: Callable[[ScanPair, Mapping[str, Scan], Settings, Request], JobResult]
    summarise: Callable[[Mapping[str, pa.Table]], list[Row]]

    @property
    def versions(self) -> dict[str, int]:
        """Code versions of the experiment and its stages, by name."""
        return {self.name: self.version} | {stage.name: stage.version for stage in self.stages}


@dataclass(frozen=True, kw_only=True)
class ExperimentOutcome:
    """Outcome of any experiment.

    failures : reasons by failed pair
    n_made, n_reused : number of pairs
    metadata : of each finished pair
    tables : all tables over all pairs, by name
    """

    folder: Path
    failures: dict[str, str]
    n_made: int
    n_reused: int
    wall_s: float
    metadata: dict[str, dict[str, Any]]
    tables: dict[str, pa.Table]


@dataclass(frozen=True, kw_only=True)
class PairTask:
    """One pair of an experiment, for a worker.

    record : of the result; its files are not written yet
    folder : of the experiment
    """

    experiment: Experiment
    pair: ScanPair
    label_names: Mapping[int, str]
    settings: Settings
    request: Request
    record: JobRecord
    folder: Path


def read_source(path: Path, pattern: str | None = None, *, first_only: bool = False) -> Dataset:
    """The pairs of a dataset, or a scan file as a dataset of one pair without a simulated side.

    Parameters
    ----------
    path : a scan file or a dataset folder
    pattern : only pairs whose name matches (shell style)
    first_only : return only the first pair if no pattern is given

    Raises
    ------
    DatasetError
        No dataset exists, it is invalid, or no pair matches.
    ScanError
        The format of the file is unknown.
    """
    scan = scan_ref(path)
    if scan.exists:
        if not scan.format.module:
            raise ScanError(
                f"{path}: not a known scan format; expected a scan file or a dataset folder",
            )
        if pattern is not None:
            raise DatasetError(
                f"--pairs {pattern!r}: {path} is one scan; expected a dataset folder",
            )
        folder = scan.file.resolve().parent
        names = read_label_names(folder) or read_label_names(folder.parent)
        return Dataset(path, (ScanPair(scan.stem, scan, None),), names)
    if not path.exists() and scan.format.module:
        raise ScanError(f"{path}: no such file; expected a scan file or a dataset folder")
    dataset = read_dataset(path)
    pairs = select_pairs(dataset, pattern)
    if first_only and pattern is None:
        pairs = pairs[:1]
    return replace(dataset, pairs=pairs)


def run_experiment(
    experiment: Experiment,
    source: Dataset,
    out: Path,
    settings: Settings,
    reporter: Reporter,
    request: Request,
    *,
    n_workers: int | None = None,
    replace_finished: bool = False,
) -> ExperimentOutcome:
    """Evaluate the pairs that have no current result, and write the tables over all pairs.

    Parameters
    ----------
    source : the pairs
    out : folder of the results
    n_workers : processes; None for one per core
    replace_finished : allow results of a finished experiment to be replaced by another request

    Raises
    ------
    RunError
        The folder holds something else, is in use, or holds a finished experiment of another
        request.
    ScanError
        The only scan cannot be evaluated.
    """
    check_folder(out, source.folder, experiment.name)
    folder = RunFolder(out)
    start = perf_counter()
    with folder.locked():
        before = read_run(out)
        changes = _changes(before, experiment, source, settings, request)
        if has_ended(before) and changes and not replace_finished:
            refuse_overwrite(f"{experiment.name} {out}", "its results", changes)
        tasks, failures = _tasks(experiment, source, folder, settings, request)
        for pair_id, reason in failures.items():
            reporter.fail(f"pair {pair_id}", reason)
        header = {
            "experiment": experiment.name,
            **run_header(source.folder, settings, experiment.versions).as_dict(),
            "request": dict(request),
        }
        done = _finished(tasks, folder)
        stale = [pair_id for pair_id in folder.ledger.pair_ids() if pair_id not in done]
        if stale or len(done) < len(tasks):
            write_record(out, settings, header.items(), folder.check_token)
        _remove(stale, folder, reporter, "; ".join(changes) or "out of date")
        missing = {pair_id: task for pair_id, task in tasks.items() if pair_id not in done}
        failures |= _evaluate_all(missing, folder, reporter, settings.machine.memory_gib, n_workers)
        if scan_ref(source.folder).exists and failures:
            raise ScanError("; ".join(failures.values()))
        records = _finished(tasks, folder)
        metadata = {pair_id: record.metadata for pair_id, record in records.items()}
        _show(metadata, reporter)
        outcome = ExperimentOutcome(
            folder=out,
            failures=failures,
            n_made=len(records) - len(done),
            n_reused=len(done),
            wall_s=perf_counter() - start,
            metadata=metadata,
            tables=_write_tables(experiment, folder, list(records.values())),
        )
        header |= {"scans": metadata, "failures": failures, "wall_s": outcome.wall_s}
        write_record(out, settings, header.items(), folder.check_token)
    return outcome


def _remove(pair_ids: list[str], folder: RunFolder, reporter: Reporter, why: str) -> None:
    """Remove the results of pairs, and files that belong to no result."""
    if pair_ids:
        reporter.say(f"replacing results of pair {', '.join(pair_ids)}: {why}")
    for pair_id in pair_ids:
        folder.forget(pair_id)
    folder.remove_strays()


def _evaluate_all(
    tasks: Mapping[str, PairTask],
    folder: RunFolder,
    reporter: Reporter,
    memory_gib: float | None,
    n_workers: int | None,
) -> dict[str, str]:
    """Evaluate pairs, put the results into the ledger, and return the reasons of failures by pair_id."""
    _, failures = map_tasks(
        _evaluate,
        tasks,
        reporter,
        n_workers=n_workers,
        memory_gib=memory_gib,
        may_end_workers=may_crash(task.pair for task in tasks.values()),
        keep=folder.ledger.put_job,
    )
    return failures


def _show(metadata: Mapping[str, Mapping[str, Any]], reporter: Reporter) -> None:
    """Show the warnings and notes about the pairs."""
    for values in metadata.values():
        reporter.warn(*values.get("warnings", ()))
        for note in values.get("notes", ()):
            reporter.say(note)


def mean_rows(scores: pd.DataFrame, keys: list[str]) -> Iterator[Row]:
    """Keys, n, mean and std (n - 1) of `value` for each group of rows with equal keys, null keys included."""
    for names, values in scores.groupby(keys, dropna=False, sort=False)["value"]:
        mean, std = mean_and_std(values.to_numpy(dtype=np.float64))
        row = dict(zip(keys, names, strict=True))
        yield row | {"n": int(values.notna().sum()), "mean": mean, "std": std}


def _changes(
    before: Mapping[str, Any],
    experiment: Experiment,
    source: Dataset,
    settings: Settings,
    request: Request,
) -> list[str]:
    """Differences from the last record of the folder that change its results, as text."""
    changes = []
    for group, texts in changed_settings(before, settings).items():
        if group != "machine":
            changes += texts
    stages = before.get("stages", {})
    for name, version in experiment.versions.items():
        if stages.get(name, version) != version:
            changes.append(f"code of {name} is new")
    last_request = before.get("request", {})
    for name, value in request.items():
        if last_request.get(name, value) != value:
            changes.append(f"{name} was {last_request[name]}, is {value}")
    pair_ids = {pair.pair_id for pair in source.pairs}
    dropped = [pair_id for pair_id in before.get("scans", {}) if pair_id not in pair_ids]
    if dropped:
        changes.append(f"pairs {', '.join(dropped)} not requested")
    return changes


def _tasks(
    experiment: Experiment,
    source: Dataset,
    folder: RunFolder,
    settings: Settings,
    request: Request,
) -> tuple[dict[str, PairTask], dict[str, str]]:
    """The tasks of all pairs with their keys, and the reasons why other pairs cannot be read, by pair_id."""
    libraries = ["numpy", "scipy"]
    for stage in experiment.stages:
        libraries += stage.libraries
    columns = {name: str(TABLES[name].schema) for name in experiment.tables}
    request_key = key_of(
        experiment.versions,
        library_versions(libraries),
        columns,
        settings.model_dump(mode="json", exclude={"machine"}),
        request,
    )
    tasks = {}
    failures = {}
    for pair in source.pairs:
        try:
            content = _content_keys(pair, experiment.sides, source.label_names)
        except ScanError as error:
            failures[pair.pair_id] = str(error)
            continue
        key = key_of(request_key, content)
        record = JobRecord(experiment.name, pair.pair_id, "", key, {}, content)
        tasks[pair.pair_id] = PairTask(
            experiment=experiment,
            pair=pair,
            label_names=source.label_names,
            settings=settings,
            request=request,
            record=replace(record, made_by=folder.token),
            folder=folder.folder,
        )
    return tasks, failures


def _content_keys(
    pair: ScanPair,
    sides: tuple[str, ...],
    label_names: Mapping[int, str],
) -> tuple[str, ...]:
    """A hash of the content of the scan of each side; `ScanError` if one cannot be read."""
    keys = []
    for side in sides:
        scan = pair.scans.get(side)
        if scan is None:
            raise ScanError(pair.fault or f"no {side} scan")
        keys.append(scan_content(scan).key(label_names, pair.motion(side)))
    return tuple(keys)


def _finished(tasks: Mapping[str, PairTask], folder: RunFolder) -> dict[str, JobRecord]:
    """The intact results that exist under the keys of tasks, by pair_id."""
    records = {}
    for pair_id, task in tasks.items():
        record = folder.ledger.jobs(pair_id).get(task.record.job)
        if record is None or record.key != task.record.key:
            continue
        if not folder.damaged_files(record):
            records[pair_id] = record
    return records


def _evaluate(task: PairTask) -> JobRecord:
    """Read the scans of a pair, evaluate it and write its tables."""
    scans = {}
    for side in task.experiment.sides:
        columns = task.settings.input.columns_of(side)
        scans[side] = read_scan(task.pair.scans[side], columns, dict(task.label_names))
    content = _content_keys(task.pair, task.experiment.sides, task.label_names)
    if content != task.record.reads:
        raise ScanError("the file changed while it was used; run the same command again")
    result = task.experiment.evaluate(task.pair, scans, task.settings, task.request)
    record = replace(task.record, metadata=plain_metadata(result.metadata))
    folder = TableFolder(task.folder, record.made_by)
    return replace(record, files=folder.write_job(record, result.tables))


def _write_tables(
    experiment: Experiment,
    folder: RunFolder,
    records: list[JobRecord],
) -> dict[str, pa.Table]:
    """Join the tables of all pairs, summarise them, and write both; returns them by name."""
    tables = {}
    for name in experiment.tables:
        parts = [TABLES[name].schema.empty_table()]
        parts += [folder.read_table(name, record.pair_id) for record in records]
        tables[name] = pa.concat_tables(parts)
    tables[experiment.summary] = TABLES[experiment.summary].from_rows(experiment.summarise(tables))
    key = key_of(sorted(record.key for record in records))
    for name, table in tables.items():
        file_name = f"{name}.parquet"
        stored = folder.write_at(folder.folder / file_name, name, table, key)
        folder.ledger.put_job(JobRecord(name, "", "", key, {file_name: stored}))
    return tables
