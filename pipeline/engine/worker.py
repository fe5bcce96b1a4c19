"""Work of a worker: jobs of a pair one after the other, or some objects of one; and the tables that they work on.

A table that comes from the job before it and one that comes from the run's folder are the same,
value for value.
"""

from __future__ import annotations

import traceback
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace

import pyarrow as pa

from ...schemas.errors import DiskFullError, FidpipeError, StageError
from ...schemas.tables import TABLES
from ..datasets.content import scan_content
from ..datasets.readers import read_scan
from ..datasets.readers.scan import Scan
from ..stage import Grain, Inputs, JobResult, Memo, Steps, Tables
from ..storage.remote_dataset import restored_scan
from ..storage.scratch import temporary_space
from ..storage.table_files import JobId, JobRecord, plain_metadata, table_name, tables_of_run
from .costs import CostModel, largest_object
from .inputs import declared_inputs
from .plan import Job, PairPlan, Source
from .time_limit import OutOfTimeError, limited


@dataclass(frozen=True)
class JobFailure:
    """Reason why a job failed; with the traceback if it is a bug."""

    job: JobId
    reason: str
    trace: str = ""


@dataclass(frozen=True)
class ObjectRows:
    """Rows of some objects of a pair, and the seconds of their steps, by job."""

    tables: dict[JobId, Tables] = field(default_factory=dict)
    steps: dict[JobId, tuple[tuple[str, float], ...]] = field(default_factory=dict)


@dataclass(frozen=True)
class BatchResult:
    """Outcome of a batch for one pair: finished and failed jobs, or the rows of some objects."""

    pair_id: str
    records: tuple[JobRecord, ...] = ()
    failures: tuple[JobFailure, ...] = ()
    scored: ObjectRows | None = None


@dataclass(frozen=True)
class PairBatch:
    """Some jobs of a pair, to be run in order.

    jobs : their names
    most_bytes : a batch ends before a job that may need more than this
    objects : score these objects alone, and write nothing
    rows : of all objects, from such batches, from which the jobs write their tables; None if they
        are to be made
    """

    plan: PairPlan
    jobs: tuple[JobId, ...]
    most_bytes: int | None = None
    objects: tuple[int, ...] = ()
    rows: tuple[ObjectRows, ...] | None = None


def run_batch(batches: Sequence[PairBatch], costs: CostModel) -> list[BatchResult]:
    """Run the jobs of each pair and write their results; a failed job does not stop those that do not need it."""
    results = []
    for batch in batches:
        tables = _kept_tables(batch.plan) if batch.objects else PairTables(batch.plan)
        records: list[JobRecord] = []
        failures: list[JobFailure] = []
        scored = ObjectRows() if batch.objects else None
        try:
            with limited(batch.plan.limit) as note:
                for job in _next_jobs(batch, tables, failures, costs):
                    note(job_title(*job.name))
                    with _caught(job, failures):
                        if scored is not None:
                            _score_objects(tables, job, batch.objects, scored)
                        else:
                            records.append(make_job(tables, job, batch.rows))
        except OutOfTimeError as error:
            failures.append(JobFailure(batch.jobs[0], str(error)))
        pair_id = batch.plan.pair_id
        results.append(BatchResult(pair_id, tuple(records), tuple(failures), scored))
    return results


def _next_jobs(
    batch: PairBatch, tables: PairTables, failures: Sequence[JobFailure], costs: CostModel
) -> Iterator[Job]:
    """The jobs of a batch that do not need one that failed; none after a failure that fails the pair.

    Parameters
    ----------
    failures : grows while the jobs run
    """
    lost: set[JobId] = set()
    for job in [batch.plan.jobs[name] for name in batch.jobs]:
        lost |= {failure.job for failure in failures}
        if lost.intersection(job.needs):
            lost.add(job.name)
            continue
        limit = batch.most_bytes
        if limit is not None and tables.bytes_needed(job, costs) > limit:
            return
        yield job
        if not job.stage.is_extra and failures and failures[-1].job == job.name:
            return


@contextmanager
def _caught(job: Job, failures: list[JobFailure]) -> Iterator[None]:
    """Context of a job whose error fails its pair alone, unless no other pair could go on either."""
    try:
        with temporary_space():
            yield
    except DiskFullError:
        raise
    except Exception as error:
        failures.append(_failure(job, error))


def _score_objects(
    tables: PairTables, job: Job, objects: tuple[int, ...], scored: ObjectRows
) -> None:
    """Run a stage over objects on some of them; later stages take its rows in place of its tables."""
    rows: Tables = {}
    for earlier in scored.tables.values():
        rows |= earlier
    inputs = tables.inputs(job, objects, rows)
    scored.tables[job.name] = job.stage.make(inputs).tables
    scored.steps[job.name] = inputs.step.total()


def make_job(tables: PairTables, job: Job, rows: tuple[ObjectRows, ...] | None = None) -> JobRecord:
    """Run one job of a pair and write its results; errors of its stage are raised unchanged.

    Parameters
    ----------
    rows : see `PairBatch`
    """
    if rows is None:
        objects = tables.plan.objects if job.stage.grain is Grain.OBJECT else None
        inputs = tables.inputs(job, tuple(number for number, _ in objects or []))
        result = job.stage.make(inputs)
        parts = [result.tables]
    else:
        steps: list[tuple[str, float]] = []
        for part in rows:
            steps += part.steps[job.name]
        inputs = tables.inputs(job, step=Steps(steps))
        parts = [part.tables[job.name] for part in rows]
    if job.stage.grain is Grain.OBJECT:
        result = _gathered(job, inputs, parts)
    return tables.finish(job, inputs, result)


def _gathered(job: Job, inputs: Inputs, parts: Sequence[Tables]) -> JobResult:
    """The rows of all objects, in the order of the table's keys."""
    tables = {}
    for name in job.stage.gives:
        schema = TABLES[name]
        rows = pa.concat_tables([schema.schema.empty_table(), *(part[name] for part in parts)])
        tables[name] = rows.sort_by([(key, "ascending") for key in schema.keys]).combine_chunks()
    metadata = job.stage.gather(inputs, tables) if job.stage.gather is not None else {}
    return JobResult(tables, metadata)


class PairTables:
    """The tables of one pair while jobs run on it: new ones, and those that are read when first requested."""

    def __init__(self, plan: PairPlan) -> None:
        self._folder = tables_of_run(plan.folder, plan.token, plan.url)
        self._scans: dict[str, Scan] = {}
        self._tables: dict[tuple[str, str], pa.Table] = {}
        self._parts: dict[Source, pa.Table] = {}
        self._memo = Memo()
        self.plan = plan

    def bytes_needed(self, job: Job, costs: CostModel) -> int:
        """Memory that a job may need, bytes, estimated from the counts known so far."""
        n_bytes = costs.pair_bytes(self.plan.n_points)
        if job.stage.grain is Grain.OBJECT:
            n_bytes += costs.object_bytes(largest_object(self.plan.objects or [])[1])
        return n_bytes

    def inputs(
        self,
        job: Job,
        objects: tuple[int, ...] = (),
        rows: Mapping[str, pa.Table] | None = None,
        step: Steps | None = None,
    ) -> Inputs:
        """The argument of a job: the inputs that its stage declares.

        Parameters
        ----------
        objects : of grain OBJECT, the ids of the matched objects to be scored
        rows : of these objects, in place of tables that are not written yet
        step : times the steps of the job
        """
        step = step or Steps()
        outputs = {}
        for name, record in self.plan.records.items():
            is_gathered = (
                name in self.plan.jobs and self.plan.jobs[name].stage.grain is Grain.OBJECT
            )
            if not (is_gathered and job.stage.grain is Grain.OBJECT):
                outputs[name] = record.metadata

        def read_table(source: Source) -> pa.Table:
            if rows and source.table in rows:
                return rows[source.table].select(source.columns)
            return self._read(source, step)

        return declared_inputs(
            job,
            read_table,
            self._scan,
            outputs,
            self.plan.pair.T_real_sim,
            pair_id=self.plan.pair_id,
            objects=objects,
            step=step,
            memo=self._memo,
        )

    def _read(self, source: Source, step: Steps) -> pa.Table:
        """The declared columns of a table that was made here or is in the run's folder."""
        if source not in self._parts:
            made = self._tables.get((source.table, source.side))
            if made is not None:
                rows = made.select(source.columns)
            else:
                path = table_name(source.table, self.plan.pair_id, source.side)
                stored = self.plan.records[source.maker].files[path]  # type: ignore[index]
                with step("read"):
                    rows = self._folder.read(source.table, stored, path, list(source.columns))
            self._parts[source] = rows
        return self._parts[source]

    def _scan(self, side: str) -> Scan:
        """The scan of a side, whose file must be the one that the keys were made of."""
        if side not in self._scans:
            ref = self.plan.pair.scans.get(side)
            if ref is None:
                raise StageError(f"no {side} scan")
            if self.plan.stubs:
                ref = replace(ref, file=restored_scan(ref.file, self.plan.stubs))
            columns = next(iter(self.plan.jobs.values())).settings.input.columns_of(side)
            scan = read_scan(ref, columns, dict(self.plan.label_names))
            if scan_content(ref) != self.plan.inputs[side]:
                raise StageError(
                    f"{ref}: the file changed while the run was using it; run the same command again"
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
            found = ", ".join(result.tables)
            raise ValueError(
                f"stage {job.stage.name}: expected tables {job.stage.gives}, got {found}"
            )
        record = JobRecord(
            job.stage.name,
            self.plan.pair_id,
            job.part,
            self.plan.keys[job.name],
            {},
            self.plan.reads(job),
            plain_metadata(result.metadata),
            made_by=self.plan.token,
        )
        with inputs.step("write"):
            files = self._folder.write_job(record, result.tables)
        record = replace(record, files=files, steps=inputs.step.total())
        self._tables |= {(name, job.part): rows for name, rows in result.tables.items()}
        self.plan = self.plan.with_records([record])
        for side in list(self._scans):
            readers = {job.name for job in self.plan.jobs.values() if side in job.scan_sides}
            if self.plan.records.keys() >= readers:
                del self._scans[side]  # no later job reads it
        return record


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
