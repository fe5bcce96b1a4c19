"""Work of a worker: jobs of a pair one after the other, or some objects of one; and the tables that they work on.

A table that comes from the job before it and one that comes from the run's folder are the same, value for value.
"""

from __future__ import annotations

import traceback
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from types import SimpleNamespace
from typing import cast

import pyarrow as pa

from ...schemas.errors import DiskFullError, FidpipeError, StageError
from ...schemas.settings import Settings
from ...schemas.tables import TABLES
from ..datasets.content import scan_content
from ..datasets.readers import read_scan
from ..datasets.readers.scan import Scan
from ..stage import SCAN, Grain, Inputs, JobResult, Memo, Steps, Tables
from ..storage.remote_dataset import restored_scan
from ..storage.scratch import temporary_space
from ..storage.table_files import JobId, JobRecord, plain_metadata, table_name, tables_of_run
from .costs import CostModel, largest_object
from .plan import Job, PairPlan
from .time_limit import OutOfTimeError, limited


@dataclass(frozen=True)
class JobFailure:
    """Reason why a job failed; with the traceback if it is a bug."""

    job: JobId
    reason: str
    trace: str = ""


@dataclass(frozen=True)
class BatchResult:
    """Outcome of a batch for one pair: finished and failed jobs."""

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
    most_bytes : a batch ends before a job that may need more than this
    rows : of all objects, made by `score_objects`, from which the jobs write their tables; None if they are to be made
    """

    plan: PairPlan
    jobs: tuple[JobId, ...]
    most_bytes: int | None = None
    rows: tuple[ObjectRows | JobFailure, ...] | None = None


def run_batch(batches: Sequence[PairBatch], costs: CostModel) -> list[BatchResult]:
    """Run the jobs of each pair and write their results; a failed job does not stop those that do not need it."""
    results = []
    for batch in batches:
        jobs = [batch.plan.jobs[name] for name in batch.jobs]
        tables = PairTables(batch.plan)
        records: list[JobRecord] = []
        failures = [part for part in batch.rows or () if isinstance(part, JobFailure)][:1]
        failed: set[JobId] = set()
        try:
            with limited(batch.plan.limit) as note:
                for job in [] if failures else jobs:
                    if failed.intersection(job.needs):
                        failed.add(job.name)
                        continue
                    if (
                        batch.most_bytes is not None
                        and tables.bytes_needed(job, costs) > batch.most_bytes
                    ):
                        break
                    note(job_title(*job.name))
                    try:
                        with temporary_space():
                            records.append(make_job(tables, job, batch.rows))
                    except DiskFullError:
                        raise  # of every pair that comes after
                    except Exception as error:  # one broken pair does not stop a dataset
                        failures.append(_failure(job, error))
                        failed.add(job.name)
                        if not job.stage.is_extra:
                            break
        except OutOfTimeError as error:
            failures.append(JobFailure(batch.jobs[0], str(error)))
        results.append(BatchResult(batch.plan.pair_id, tuple(records), tuple(failures)))
    return results


def score_objects(
    plan: PairPlan, jobs: tuple[JobId, ...], objects: tuple[int, ...]
) -> ObjectRows | JobFailure:
    """The rows of some objects, by the requested stages over objects; nothing is written."""
    tables = _kept_tables(plan)
    made: dict[JobId, Tables] = {}
    steps: dict[JobId, tuple[tuple[str, float], ...]] = {}
    rows: dict[tuple[str, str], pa.Table] = {}
    job = plan.jobs[jobs[0]]
    try:
        with limited(plan.limit) as note:
            for job in (plan.jobs[name] for name in jobs):
                note(job_title(*job.name))
                inputs = tables.inputs(job, objects, rows)
                with temporary_space():
                    made[job.name] = job.stage.make(inputs).tables
                steps[job.name] = inputs.step.total()
                rows |= {(table, ""): own for table, own in made[job.name].items()}
    except DiskFullError:
        raise  # of every pair that comes after
    except Exception as error:  # one broken pair does not stop a dataset
        return _failure(job, error)
    return ObjectRows(made, steps)


def make_job(
    tables: PairTables, job: Job, rows: tuple[ObjectRows | JobFailure, ...] | None = None
) -> JobRecord:
    """Run one job of a pair and write its results; errors of its stage are raised unchanged.

    Parameters
    ----------
    rows : see `PairBatch`
    """
    if rows is not None:
        parts = [part for part in rows if isinstance(part, ObjectRows)]
        inputs = tables.inputs(
            job, step=Steps(step for part in parts for step in part.steps[job.name])
        )
        made = {
            table: [part.tables[job.name][table] for part in parts] for table in job.stage.gives
        }
        return _finish_objects(tables, job, inputs, made)
    objects = (
        tuple(number for number, _ in tables.plan.objects or ())
        if job.stage.grain is Grain.OBJECT
        else ()
    )
    inputs = tables.inputs(job, objects)
    result = job.stage.make(inputs)
    if job.stage.grain is Grain.OBJECT:
        return _finish_objects(
            tables, job, inputs, {name: [own] for name, own in result.tables.items()}
        )
    return tables.finish(job, inputs, result)


class PairTables:
    """The tables of one pair while jobs run on it: new ones, and those that are read when first requested."""

    def __init__(self, plan: PairPlan) -> None:
        self._folder = tables_of_run(plan.folder, plan.token, plan.url)
        self._scans: dict[str, Scan] = {}
        self._tables: dict[tuple[str, str], pa.Table] = {}
        self._parts: dict[tuple[str, str, tuple[str, ...]], pa.Table] = {}
        self._memo = Memo()
        self.plan = plan

    def bytes_needed(self, job: Job, costs: CostModel) -> int:
        """Memory that a job may need, bytes, estimated from the counts known so far."""
        n_bytes = costs.pair_bytes(self.plan.n_raw)
        if job.stage.grain is Grain.OBJECT:
            n_bytes += costs.object_bytes(largest_object(self.plan.objects or [])[1])
        return n_bytes

    def inputs(
        self,
        job: Job,
        objects: tuple[int, ...] = (),
        rows: Mapping[tuple[str, str], pa.Table] | None = None,
        step: Steps | None = None,
    ) -> Inputs:
        """The argument of a job: the inputs that its stage declares.

        Parameters
        ----------
        objects : of grain OBJECT, the ids of the matched objects to be scored
        rows : of these objects, in place of tables that are not written yet
        step : times the steps of the job
        """
        step, rows, stage = step or Steps(), rows or {}, job.stage
        tables: dict[tuple[str, str], Callable[[], pa.Table]] = {}
        outputs, scans = {}, {}
        for source in job.sources:
            name = source.table, source.side
            if source.maker is None:
                scans[source.side] = partial(self._scan, source.side)
                continue
            if source.columns:
                read = partial(self._read, *source[:3], source.maker, step)
                tables[name] = partial(rows[name].select, source.columns) if name in rows else read
            is_by_object = self.plan.jobs[source.maker].stage.grain is Grain.OBJECT
            if not (
                is_by_object and stage.grain is Grain.OBJECT
            ):  # they are gathered when all objects are done
                outputs[name] = self.plan.records[source.maker].metadata
        return Inputs(
            pair_id=self.plan.pair_id,
            part=job.part,
            settings=cast(
                Settings,
                SimpleNamespace(
                    **{group: getattr(job.settings, group) for group in stage.settings}
                ),
            ),
            tables=tables,
            outputs=outputs,
            scans=scans,
            T_real_sim=self.plan.pair.T_real_sim if "sim" in scans else None,
            objects=objects,
            arguments=job.stage.arguments,
            step=step,
            memo=self._memo,
        )

    def _read(
        self, name: str, side: str, columns: tuple[str, ...], maker: JobId, step: Steps
    ) -> pa.Table:
        """The declared columns of a table that was made here or is in the run's folder."""
        if (name, side, columns) not in self._parts:
            if (name, side) in self._tables:
                rows = self._tables[name, side].select(columns)
            else:
                path = table_name(name, self.plan.pair_id, side)
                with step("read"):
                    rows = self._folder.read(
                        name, self.plan.records[maker].files[path], path, list(columns)
                    )
            self._parts[name, side, columns] = rows
        return self._parts[name, side, columns]

    def _scan(self, side: str) -> Scan:
        """The scan of a side, whose file must be the one that the keys were made of."""
        if side not in self._scans:
            path = self.plan.pair.path(side)
            if path is None:
                raise StageError(f"no {side} scan")
            if self.plan.stubs:
                path = restored_scan(path, self.plan.stubs)
            columns = next(iter(self.plan.jobs.values())).settings.input.columns_of(side)
            scan = read_scan(path, columns, dict(self.plan.label_names))
            if scan_content(path) != self.plan.inputs[side]:
                raise StageError(
                    f"{path}: the file changed while the run was using it; run the same command again"
                )
            self._scans[side] = scan
        return self._scans[side]

    def finish(self, job: Job, inputs: Inputs, result: JobResult) -> JobRecord:
        """Keep and write the results of a job.

        Raises
        ------
        ValueError
            The tables are not those that the stage declares.
        """
        if set(result.tables) != set(job.stage.gives):
            raise ValueError(
                f"stage {job.stage.name}: expected tables {job.stage.gives}, got {', '.join(result.tables)}"
            )
        record = JobRecord(
            job.stage.name,
            self.plan.pair_id,
            job.part,
            self.plan.keys[job.name],
            {},
            self.plan.reads(job),
            plain_metadata(result.metadata),
            inputs.step.total(),
            self.plan.token,
        )
        with inputs.step("write"):
            files = self._folder.write_job(record, result.tables)
        record = replace(record, files=files, steps=inputs.step.total())
        self._tables |= {(name, job.part): rows for name, rows in result.tables.items()}
        self.plan = self.plan.with_records([record])
        for side in list(self._scans):
            readers = {
                own.name
                for own in self.plan.jobs.values()
                for use in own.sources
                if use[:2] == (SCAN, side)
            }
            if self.plan.records.keys() >= readers:
                del self._scans[side]  # no later job reads it
        return record


def _finish_objects(
    tables: PairTables, job: Job, inputs: Inputs, made: Mapping[str, list[pa.Table]]
) -> JobRecord:
    """Keep and write the rows of all objects, in the order of the table's keys."""
    whole = {}
    for name, parts in made.items():
        schema = TABLES[name]
        rows = pa.concat_tables([schema.schema.empty_table(), *parts])
        whole[name] = rows.sort_by([(key, "ascending") for key in schema.keys]).combine_chunks()
    metadata = job.stage.gather(inputs, whole) if job.stage.gather is not None else {}
    return tables.finish(job, inputs, JobResult(whole, metadata))


def _kept_tables(plan: PairPlan) -> PairTables:
    """The tables of a pair that has several batches of objects; a process keeps the last two."""
    name = plan.token, plan.pair_id, tuple(plan.keys.values())
    if name not in _KEPT:
        while len(_KEPT) >= 2:
            del _KEPT[next(iter(_KEPT))]
        _KEPT[name] = PairTables(plan)
    _KEPT[name].plan = plan.with_records(_KEPT[name].plan.records.values())
    return _KEPT[name]


_KEPT: dict[tuple[str, str, tuple[str, ...]], PairTables] = {}


def _failure(job: Job, error: Exception) -> JobFailure:
    if isinstance(error, FidpipeError):
        return JobFailure(job.name, str(error))
    if isinstance(error, MemoryError):
        return JobFailure(job.name, f"out of memory ({error})")
    trace = "".join(traceback.format_exception(error))
    return JobFailure(job.name, f"internal error: {type(error).__name__}: {error}", trace)


def failure_text(failures: Iterable[JobFailure]) -> str:
    """Failed jobs and their reasons, in one line."""
    return "; ".join(f"{job_title(*failure.job)}: {failure.reason}" for failure in failures)


def job_title(stage: str, part: str) -> str:
    """Name of a job in messages."""
    return f"stage {stage}{', ' + part if part else ''}"
