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
from ...schemas.errors import ScanError
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
from ..jobs import STAGES, baselines_job
from ..run import select_pairs
from ..stage import JobResult
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
#: Stages whose code the experiments use.
_STAGES = (*STAGES, baselines_job.STAGE)


@dataclass(frozen=True, kw_only=True)
class Experiment:
    """Definition of an experiment.

    name : name of the command
    version : version of its code; increase it when the same request results in other numbers
    sides : sides of a pair whose scans it reads
    tables : names of the tables over all pairs
    summary : name of the table of means over all pairs
    evaluate : from a pair, its scans by side, settings and request: the tables of the pair, with
        metadata; its "warnings" are shown to the user
    summarise : from `tables` of all pairs by name, the rows of `summary`
    """

    name: str
    version: int
    sides: tuple[str, ...]
    tables: tuple[str, ...]
    summary: str
    evaluate: Callable[[ScanPair, Mapping[str, Scan], Settings, Request], JobResult]
    summarise: Callable[[Mapping[str, pa.Table]], list[Row]]

    @property
    def versions(self) -> dict[str, int]:
        """Code versions of the experiment and of the stages, by name."""
        return {self.name: self.version} | {stage.name: stage.version for stage in _STAGES}


@dataclass(frozen=True, kw_only=True)
class ExperimentOutcome:
    """Outcome of an experiment.

    failures : reasons by failed pair
    n_made, n_reused : number of pairs
    metadata : metadata by finished pair
    tables : all tables over all pairs, by name
    """

    folder: Path
    request: Request
    failures: dict[str, str]
    n_made: int
    n_reused: int
    wall_s: float
    metadata: dict[str, dict[str, Any]]
    tables: dict[str, pa.Table]


@dataclass(frozen=True, kw_only=True)
class PairTask:
    """One pair of an experiment, for a worker.

    record : record of the result; its files are not written yet
    folder : folder of the experiment
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
    """
    scan = scan_ref(path)
    if scan.exists:
        folder = scan.file.resolve().parent
        names = read_label_names(folder) or read_label_names(folder.parent)
        dataset = Dataset(path, (ScanPair(scan.stem, scan, None),), names)
    else:
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
    header: dict[str, Any] = {
        "experiment": experiment.name,
        **run_header(source.folder, settings, experiment.versions).as_dict(),
        "request": dict(request),
    }
    with folder.locked():
        before = read_run(out)
        changes = _changes(before, experiment, source, settings, request)
        if has_ended(before) and changes and not replace_finished:
            refuse_overwrite(f"{experiment.name} {out}", "its results", changes)
        tasks, failures = _tasks(experiment, source, folder, settings, request)
        for pair_id, reason in failures.items():
            reporter.fail(f"pair {pair_id}", reason)
        done = _finished(tasks, folder)
        stale = [pair_id for pair_id in folder.ledger.pair_ids() if pair_id not in done]
        if stale or len(done) < len(tasks):
            write_record(out, settings, header, folder.check_token)
        _remove(stale, folder, reporter, "; ".join(changes) or "out of date")
        missing = {pair_id: task for pair_id, task in tasks.items() if pair_id not in done}
        made, failures_of_tasks = map_tasks(
            _evaluate,
            missing,
            reporter,
            n_workers=n_workers,
            memory_gib=settings.machine.memory_gib,
            may_end_workers=may_crash(task.pair for task in missing.values()),
            keep=folder.ledger.put_job,
        )
        failures |= failures_of_tasks
        if failures and scan_ref(source.folder).exists:
            raise ScanError("; ".join(failures.values()))
        records = [(done | made)[name] for name in tasks if name not in failures]
        tables = _write_tables(experiment, folder, records)
        header["scans"] = {record.pair_id: record.metadata for record in records}
        header["failures"] = failures
        header["wall_s"] = perf_counter() - start
        write_record(out, settings, header, folder.check_token)
    for record in records:
        reporter.warn(*record.metadata["warnings"])
    return ExperimentOutcome(
        folder=out,
        request=request,
        failures=failures,
        n_made=len(made),
        n_reused=len(done),
        wall_s=header["wall_s"],
        metadata=header["scans"],
        tables=tables,
    )


def _remove(pair_ids: list[str], folder: RunFolder, reporter: Reporter, why: str) -> None:
    """Remove the results of pairs, and files that belong to no result."""
    if pair_ids:
        reporter.say(f"replacing results of pair {', '.join(pair_ids)}: {why}")
    for pair_id in pair_ids:
        folder.forget(pair_id)
    folder.remove_strays()


def mean_rows(scores: pd.DataFrame, keys: list[str]) -> Iterator[Row]:
    """Keys, n, mean and std (n - 1) of `value` for each group of rows with equal keys."""
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
    for entry, values in (("stages", experiment.versions), ("request", request)):
        last = before.get(entry, {})
        for name, value in values.items():
            if last.get(name, value) != value:
                changes.append(f"{name} was {last[name]}, is {value}")
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
    """The tasks of all pairs with their keys, and the reasons why other pairs cannot be read."""
    libraries = ["numpy", "scipy"]
    for stage in _STAGES:
        libraries += stage.libraries
    request_key = key_of(
        experiment.versions,
        library_versions(libraries),
        {name: str(TABLES[name].schema) for name in experiment.tables},
        settings.model_dump(mode="json", exclude={"machine"}),
        request,
    )
    tasks = {}
    failures = {}
    for pair in source.pairs:
        content = []
        try:
            for side in experiment.sides:
                scan = pair.scans.get(side)
                if scan is None:
                    raise ScanError(pair.fault or f"no {side} scan")
                content.append(scan_content(scan).key(source.label_names, pair.motion(side)))
        except ScanError as error:
            failures[pair.pair_id] = str(error)
            continue
        key = key_of(request_key, content)
        tasks[pair.pair_id] = PairTask(
            experiment=experiment,
            pair=pair,
            label_names=source.label_names,
            settings=settings,
            request=request,
            record=JobRecord(experiment.name, pair.pair_id, "", key, {}, made_by=folder.token),
            folder=folder.folder,
        )
    return tasks, failures


def _finished(tasks: Mapping[str, PairTask], folder: RunFolder) -> dict[str, JobRecord]:
    """The intact results that exist under the keys of tasks, by pair_id."""
    records = {}
    for pair_id, task in tasks.items():
        record = folder.ledger.jobs(pair_id).get(task.record.job)
        if record and record.key == task.record.key and not folder.damaged_files(record):
            records[pair_id] = record
    return records


def _evaluate(task: PairTask) -> JobRecord:
    """Read the scans of a pair, evaluate it and write its tables."""
    scans = {}
    for side in task.experiment.sides:
        columns = task.settings.input.columns_of(side)
        scans[side] = read_scan(task.pair.scans[side], columns, dict(task.label_names))
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
        parts = [folder.read_table(name, record.pair_id) for record in records]
        tables[name] = pa.concat_tables([TABLES[name].schema.empty_table(), *parts])
    tables[experiment.summary] = TABLES[experiment.summary].from_rows(experiment.summarise(tables))
    key = key_of(sorted(record.key for record in records))
    for name, table in tables.items():
        file_name = f"{name}.parquet"
        stored = folder.write_at(folder.folder / file_name, name, table, key)
        folder.ledger.put_job(JobRecord(name, "", "", key, {file_name: stored}))
    return tables
