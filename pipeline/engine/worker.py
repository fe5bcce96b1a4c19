"""What a worker does: jobs of a pair one after the other, or some objects of one; and the tables that they work on.

A table that comes from the job before it and one that comes from the run's folder are the same, value for value.
"""

from __future__ import annotations

import traceback
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import pyarrow as pa

from ...schemas.errors import DiskFullError, FidpipeError, StageError
from ...schemas.tables import TABLES
from ..datasets.readers import read_scan
from ..datasets.readers.scan import Scan
from ..inspect.scan_checks import hash_scan
from ..stage import SCAN, Column, Context, Facts, Grain, Made, Step, Tables, total_steps
from ..storage.tables import JobRecord, TableFolder, plain_facts, table_name
from .costs import CostModel, largest_object
from .plan import Job, JobId, PairPlan
from .time_limit import Clock, OutOfTimeError


@dataclass(frozen=True)
class JobFailure:
    """Why a job came to nothing; `trace` where the fault is ours."""

    stage: str
    part: str
    reason: str
    trace: str = ""


@dataclass(frozen=True)
class BatchResult:
    """What a batch has done for one pair: the jobs that are finished, and those that failed."""

    pair_id: str
    records: tuple[JobRecord, ...] = ()
    failures: tuple[JobFailure, ...] = ()


@dataclass(frozen=True)
class ObjectRows:
    """Rows of some objects of a pair, and the seconds of their steps, by job."""

    tables: dict[JobId, Tables]
    steps: dict[JobId, tuple[tuple[str, float], ...]]


@dataclass(frozen=True)
class PairBatch:
    """Some jobs of a pair, to be run in order.

    jobs : their names
    bytes_for_objects : a batch ends before the first stage over objects where one of them needs more than this
    """

    plan: PairPlan
    jobs: tuple[JobId, ...]
    bytes_for_objects: int | None = None


def run_batch(batches: Sequence[PairBatch], costs: CostModel) -> list[BatchResult]:
    """Makes and writes the jobs of each pair; one broken job does not stop the others that do not need it."""
    results = []
    for batch in batches:
        jobs = [batch.plan.job(name) for name in batch.jobs]
        has_parts = any(job.part not in job.stage.parts for job in jobs)
        tables = _kept_tables(batch.plan) if has_parts else PairTables(batch.plan)
        records: list[JobRecord] = []
        failures: list[JobFailure] = []
        failed: set[JobId] = set()
        try:
            with Clock(batch.plan.limit) as clock:
                for job in jobs:
                    if failed.intersection(job.needs):
                        failed.add(job.name)
                        continue
                    if job.stage.grain is Grain.OBJECT and batch.bytes_for_objects is not None:
                        _, n_keep = largest_object(tables.objects)
                        if costs.object_bytes(n_keep) > batch.bytes_for_objects:
                            break
                    clock.begin(in_words(*job.name))
                    try:
                        records.append(make_job(tables, job))
                    except DiskFullError:
                        raise  # of every pair that comes after
                    except Exception as error:  # one broken pair does not stop a dataset
                        failures.append(_failure(job, error))
                        failed.add(job.name)
                        if is_required(job):
                            break
        except OutOfTimeError as error:
            failures.append(JobFailure(*batch.jobs[0], str(error)))
        results.append(BatchResult(batch.plan.pair_id, tuple(records), tuple(failures)))
    return results


def score_objects(plan: PairPlan, jobs: tuple[JobId, ...], objects: tuple[int, ...]) -> ObjectRows | JobFailure:
    """The rows of some objects, by the stages over objects that are wanted; nothing is written."""
    try:
        with Clock(plan.limit) as clock:
            return _make_rows(plan, jobs, objects, clock)
    except OutOfTimeError as error:
        return JobFailure(*jobs[0], str(error))


def gather_objects(plan: PairPlan, jobs: tuple[JobId, ...], parts: list[ObjectRows | JobFailure]) -> list[BatchResult]:
    """Writes the tables of a pair from the rows of all its objects."""
    failures = tuple(part for part in parts if isinstance(part, JobFailure))
    if failures:
        return [BatchResult(plan.pair_id, failures=failures[:1])]
    rows = [part for part in parts if isinstance(part, ObjectRows)]
    tables = PairTables(plan)
    records: list[JobRecord] = []
    for name in jobs:
        job = plan.job(name)
        context = Context(job.stage, job.part, job.settings, tables, arguments=job.arguments)
        context.steps.extend(step for part in rows for step in part.steps[name])
        try:
            made = {table: [part.tables[name][table] for part in rows] for table in job.stage.gives}
            records.append(_finish_objects(tables, job, context, made))
        except DiskFullError:
            raise  # of every pair that comes after
        except Exception as error:  # one broken pair does not stop a dataset
            return [BatchResult(plan.pair_id, tuple(records), (_failure(job, error),))]
    return [BatchResult(plan.pair_id, tuple(records))]


def make_job(tables: PairTables, job: Job) -> JobRecord:
    """Makes one job of a pair and writes what it gives; raises what its stage raises."""
    objects = [number for number, _ in tables.objects] if job.stage.grain is Grain.OBJECT else []
    context = Context(job.stage, job.part, job.settings, tables, objects, job.arguments)
    made = job.stage.make(context)
    if job.stage.grain is Grain.OBJECT:
        return _finish_objects(tables, job, context, {name: [rows] for name, rows in made.tables.items()})
    return tables.finish(job, context, made)


class PairTables:
    """The tables of one pair while jobs run on it: those just made, and those that are read when first asked for."""

    def __init__(self, plan: PairPlan, scans: Mapping[str, Scan] | None = None) -> None:
        self.pair_id = plan.pair_id
        self.T_real_sim = plan.pair.T_real_sim
        self._plan = plan
        self._scans = dict(scans or {})
        self._folder = None if plan.folder is None else TableFolder(plan.folder, plan.token)
        self._tables: dict[tuple[str, str], pa.Table] = {}
        self._parts: dict[tuple[str, str, tuple[str, ...]], pa.Table] = {}
        self._records = {job.name: job.record for job in plan.jobs if job.record is not None}
        self._memory: dict[str, tuple[Any, set[Column]]] = {}

    @property
    def objects(self) -> list[tuple[int, int]]:
        """Id and nodes of each matched object; none where nothing lists them."""
        return self._plan.with_records(self._records.values()).objects or []

    def table(self, name: str, side: str, columns: tuple[str, ...], step: Step) -> pa.Table:
        """Columns of a table, all where none is named; `step` is entered while a file is read."""
        if (name, side) in self._tables:
            rows = self._tables[name, side]
            return rows.select(columns) if columns else rows
        if (name, side, columns) not in self._parts:
            if self._folder is None:
                raise RuntimeError(f"table {name} of side {side!r} is asked for before its job is done")
            record = self._maker(name, side)
            file = table_name(name, self.pair_id, side)
            with step("read"):
                rows = self._folder.read(name, record.files[file], file, list(columns) or None)
                self._parts[name, side, columns] = rows
        return self._parts[name, side, columns]

    def whole_table(self, name: str, side: str = "") -> pa.Table:
        """A table that was made here, with plain strings."""
        return TABLES[name].plain(self._tables[name, side])

    def facts(self, table: str, side: str = "") -> Facts:
        """The facts of the job that gave a table."""
        return self._maker(table, side).facts

    def memory(self) -> dict[str, tuple[Any, set[Column]]]:
        """What jobs of this pair keep for each other, each with the columns that it was made of."""
        return self._memory

    def is_by_object(self, table: str) -> bool:
        """Whether a stage over objects gives the table."""
        return any(table in job.stage.gives for job in self._plan.jobs if job.stage.grain is Grain.OBJECT)

    def learn(self, plan: PairPlan) -> None:
        """Takes over what is known of the pair by now: which jobs are done."""
        self._plan = plan
        self._records |= {job.name: job.record for job in plan.jobs if job.record is not None}

    def scan(self, side: str) -> Scan:
        """The scan of a side, whose file must be the one that the keys were made of."""
        if side not in self._scans:
            self._scans[side] = self._read_scan(side)
        return self._scans[side]

    def _read_scan(self, side: str) -> Scan:
        path = self._plan.pair.path(side)
        if path is None:
            raise StageError(f"no {side} scan")
        columns = next(job.settings for job in self._plan.jobs).input.columns_of(side)
        scan = read_scan(path, columns, dict(self._plan.label_names))
        if hash_scan(path)[0] != self._plan.inputs[side].sha256:
            raise StageError(f"{path}: the file changed while the run was using it; run the same command again")
        return scan

    def finish(self, job: Job, context: Context, made: Made) -> JobRecord:
        """Keeps and writes what a job has made.

        Raises
        ------
        ValueError
            The tables are not those that the stage gives.
        """
        if set(made.tables) != set(job.stage.gives):
            raise ValueError(f"stage {job.stage.name} gives {', '.join(made.tables)}; it declares {job.stage.gives}")
        record = JobRecord(
            job.stage.name,
            self.pair_id,
            job.part,
            job.key,
            {},
            job.reads,
            plain_facts(made.facts),
            total_steps(context.steps),
            self._plan.token,
        )
        if self._folder is not None:
            with context.step("write"):
                files = self._folder.write_job(record, made.tables)
            record = replace(record, files=files, steps=total_steps(context.steps))
        self._tables |= {(name, job.part): rows for name, rows in made.tables.items()}
        self._records[job.name] = record
        readers = {own.name for own in self._plan.jobs if SCAN in own.stage.takes and own.part == job.part}
        if self._folder is not None and self._records.keys() >= readers:
            self._scans.pop(job.part, None)  # no later job reads it
        return record

    def _maker(self, table: str, side: str) -> JobRecord:
        for job in self._plan.jobs:
            if table in job.stage.gives and job.part == side and job.name in self._records:
                return self._records[job.name]
        raise RuntimeError(f"table {table} of side {side!r} is asked for before its job is done")


class _WithRows:
    """The tables of a pair, with the rows of some objects in place of tables that are not written yet."""

    def __init__(self, tables: PairTables, rows: Mapping[tuple[str, str], pa.Table]) -> None:
        self._tables, self._rows = tables, rows
        self.pair_id, self.T_real_sim = tables.pair_id, tables.T_real_sim
        self.facts, self.scan, self.memory = tables.facts, tables.scan, tables.memory
        self.is_by_object = tables.is_by_object

    def table(self, name: str, side: str, columns: tuple[str, ...], step: Step) -> pa.Table:
        """See `PairTables`."""
        rows = self._rows.get((name, side))
        return self._tables.table(name, side, columns, step) if rows is None else rows.select(columns)


def is_required(job: Job) -> bool:
    """Whether its pair comes to nothing without it: neither an extra nor a part of an experiment."""
    return not job.stage.is_extra and job.part in job.stage.parts


def _make_rows(
    plan: PairPlan, jobs: tuple[JobId, ...], objects: tuple[int, ...], clock: Clock
) -> ObjectRows | JobFailure:
    """See `score_objects`."""
    tables = _kept_tables(plan)
    made: dict[JobId, Tables] = {}
    steps: dict[JobId, tuple[tuple[str, float], ...]] = {}
    beside: dict[tuple[str, str], pa.Table] = {}
    for name in jobs:
        job = plan.job(name)
        clock.begin(in_words(*name))
        source = _WithRows(tables, beside)
        context = Context(job.stage, job.part, job.settings, source, objects, job.arguments)
        try:
            made[name] = job.stage.make(context).tables
        except Exception as error:  # one broken pair does not stop a dataset
            return _failure(job, error)
        steps[name] = total_steps(context.steps)
        beside |= {(table, ""): rows for table, rows in made[name].items()}
    return ObjectRows(made, steps)


def _finish_objects(tables: PairTables, job: Job, context: Context, made: Mapping[str, list[pa.Table]]) -> JobRecord:
    """Keeps and writes the rows of all objects, in the order of the table's keys."""
    whole = {}
    for name, parts in made.items():
        schema = TABLES[name]
        rows = pa.concat_tables([schema.schema.empty_table(), *parts])
        whole[name] = rows.sort_by([(key, "ascending") for key in schema.keys]).combine_chunks()
    facts = job.stage.gather(context, whole) if job.stage.gather is not None else {}
    return tables.finish(job, context, Made(whole, facts))


def _kept_tables(plan: PairPlan) -> PairTables:
    """The tables of a pair that has several batches, by object or by part; a process keeps the last two."""
    name = plan.token, tuple(job.key for job in plan.jobs)
    if name not in _KEPT:
        while len(_KEPT) >= 2:
            del _KEPT[next(iter(_KEPT))]
        _KEPT[name] = PairTables(plan)
    _KEPT[name].learn(plan)
    return _KEPT[name]


_KEPT: dict[tuple[str, tuple[str, ...]], PairTables] = {}


def _failure(job: Job, error: Exception) -> JobFailure:
    if isinstance(error, FidpipeError):
        return JobFailure(*job.name, str(error))
    if isinstance(error, MemoryError):
        return JobFailure(*job.name, f"out of memory ({error})")
    trace = "".join(traceback.format_exception(error))
    return JobFailure(*job.name, f"internal error: {type(error).__name__}: {error}", trace)


def failures_in_words(failures: Iterable[JobFailure]) -> str:
    """Where jobs failed and why, in one line."""
    return "; ".join(f"{in_words(failure.stage, failure.part)}: {failure.reason}" for failure in failures)


def in_words(stage: str, part: str) -> str:
    """What a job is called where people read it."""
    return f"stage {stage}{', ' + part if part else ''}"
