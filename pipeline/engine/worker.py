"""Work of a worker: jobs of a pair one after the other, or some objects of one; also in memory.

A table that comes from the job before it and one that comes from the run's folder are the same,
value for value.
"""

from __future__ import annotations

import traceback
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache, partial
from itertools import chain
from types import SimpleNamespace
from typing import cast

import pyarrow as pa

from ...schemas.errors import DiskFullError, FidpipeError, StageError
from ...schemas.settings import Settings
from ...schemas.tables import TABLES
from ..datasets.content import scan_content
from ..datasets.pairs import ScanPair
from ..datasets.readers import read_scan
from ..datasets.readers.scan import Scan
from ..stage import Grain, Inputs, JobResult, Memo, Metadata, Stage, Steps, Tables
from ..storage.remote_dataset import restored_scan
from ..storage.scratch import temporary_space
from ..storage.table_files import JobId, JobRecord, plain_metadata, table_name, tables_of_run
from .plan import Job, PairPlan, Source, plan_jobs, reads
from .time_limit import OutOfTimeError, limited

#: Tables of a pair by name and side.
PairTables = dict[tuple[str, str], pa.Table]
#: A pair without a name, whose tables are of no dataset.
NAMELESS = ScanPair("", None, None)
#: Of some objects, by job: rows of its tables, and name and seconds of its steps.
ObjectRows = dict[JobId, tuple[Tables, tuple[tuple[str, float], ...]]]


@dataclass(frozen=True)
class JobFailure:
    """Reason why a job failed; with the traceback if it is a bug."""

    job: JobId
    reason: str
    trace: str = ""


@dataclass(frozen=True)
class BatchResult:
    """Outcome of a batch for one pair: finished and failed jobs, or the rows of some objects."""

    records: list[JobRecord] = field(default_factory=list)
    failures: list[JobFailure] = field(default_factory=list)
    scored: ObjectRows = field(default_factory=dict)


@dataclass(frozen=True)
class PairBatch:
    """Some jobs of a pair, to be run in order.

    jobs : their names
    most_bytes : a batch ends before a job that may need more than this
    objects : score these objects alone, and write nothing
    rows : of all objects, from such batches, from which the jobs write their tables
    """

    plan: PairPlan
    jobs: tuple[JobId, ...]
    most_bytes: int | None = None
    objects: tuple[int, ...] = ()
    rows: tuple[ObjectRows, ...] = ()


def run_batch(batches: Sequence[PairBatch]) -> list[BatchResult]:
    """Run the jobs of each pair and write their results; a failed job does not stop those that do not need it."""
    results = []
    for batch in batches:
        runner = JobRunner(batch.plan, objects=batch.objects)
        failures = runner.result.failures
        try:
            with limited(batch.plan.limit) as note:
                for job in _next_jobs(batch, runner):
                    note(job_title(*job.name))
                    try:
                        with temporary_space():
                            runner.make_job(job, batch.rows)
                    except DiskFullError:
                        raise  # no other pair could go on either
                    except Exception as error:
                        failures.append(_failure(job, error))
        except OutOfTimeError as error:
            failures.append(JobFailure(batch.jobs[0], str(error)))
        results.append(runner.result)
    return results


def _next_jobs(batch: PairBatch, runner: JobRunner) -> Iterator[Job]:
    """The jobs of a batch whose needs are done; none after a failure that fails the pair."""
    for name in batch.jobs:
        job = batch.plan.jobs[name]
        failed = [batch.plan.jobs[failure.job] for failure in runner.result.failures]
        if not all(job.stage.is_extra for job in failed):
            return
        need = runner.plan.bytes_needed(with_objects=job.stage.grain is Grain.OBJECT)
        if batch.most_bytes is not None and need > batch.most_bytes:
            return
        if runner.done.issuperset(job.needs):
            yield job


def run_in_memory(
    stages: Iterable[Stage],
    settings: Settings,
    *,
    pair: ScanPair = NAMELESS,
    scans: Mapping[str, Scan] | None = None,
    tables: PairTables | None = None,
) -> tuple[PairTables, dict[JobId, Metadata]]:
    """Run stages on a pair, and write nothing; returns all tables, and the metadata of the jobs.

    Parameters
    ----------
    stages : in their order
    scans : by side
    tables : existing tables, with the columns that the stages read; the jobs that make them are not
        run, nor those of a side without a table or a scan

    Raises
    ------
    StageError
        A stage fails; with the name of its job.
    """
    runner = JobRunner(PairPlan(pair, plan_jobs(stages, settings), {}), scans or {})
    runner.tables = dict(tables or {})
    parts = {"", *runner.scans, *(side for _, side in runner.tables)}
    for job in runner.plan.todo:
        if job.part not in parts or (job.stage.gives[0], job.part) in runner.tables:
            continue
        try:
            runner.make_job(job)
        except StageError as error:
            raise StageError(f"{job_title(*job.name)}: {error}") from error
    outputs = {name: record.metadata for name, record in runner.plan.records.items()}
    return runner.tables, outputs


class JobRunner:
    """Runs jobs of one pair, and keeps their tables for each other.

    Parameters
    ----------
    plan : of the pair
    scans : by side, of jobs that write nothing; None for those of the plan, whose results are
        written
    objects : score these alone, and write nothing

    Attributes
    ----------
    done : names of the jobs whose results exist
    tables : results of its jobs
    scans : by side, those in memory
    result : the same for the command
    """

    def __init__(
        self,
        plan: PairPlan,
        scans: Mapping[str, Scan] | None = None,
        objects: tuple[int, ...] = (),
    ) -> None:
        self.plan = plan
        self.done = set(plan.records)
        self.tables: PairTables = {}
        self.result = BatchResult()
        self._folder = tables_of_run(plan.folder, plan.token, plan.url)
        self._is_stored = scans is None
        self.scans = dict(scans or {})
        self._objects = objects
        self._selected: dict[Source, pa.Table] = {}
        self._stored: dict[Source, pa.Table] = {}
        self._memo = Memo()
        if objects:  # the pair's other batches read the same
            keys = tuple(plan.keys.values())
            self._stored, self._memo = _kept(plan.token, plan.pair_id, keys)

    def make_job(self, job: Job, rows: tuple[ObjectRows, ...] = ()) -> None:
        """Run a job, and write its results unless they are those of some objects; its errors are raised unchanged.

        Parameters
        ----------
        rows : see `PairBatch`
        """
        parts = [part[job.name] for part in rows]
        steps = Steps(chain.from_iterable(seconds for _, seconds in parts))
        inputs = self._inputs(job, steps)
        made = _joined([tables for tables, _ in parts]) if parts else job.stage.make(inputs)
        if self._objects:
            self.result.scored[job.name] = made.tables, steps.total()
        else:
            if job.stage.grain is Grain.OBJECT:
                made = _gathered(job, inputs, made)
            self._finish(job, made, steps)
        self.done.add(job.name)
        self.tables |= {(name, job.part): table for name, table in made.tables.items()}

    def _inputs(self, job: Job, step: Steps) -> Inputs:
        """The argument of a job: what its stage declares, read when first requested."""
        tables: dict[tuple[str, str], Callable[[], pa.Table]] = {}
        scans: dict[str, Callable[[], Scan]] = {}
        metadata: dict[tuple[str, str], Metadata] = {}
        is_of_objects = job.stage.grain is Grain.OBJECT
        for source in job.sources:
            if source.maker is None:
                scans[source.side] = partial(self._scan, source.side)
                continue
            name = source.table, source.side
            if source.columns:
                tables[name] = partial(self._read, source, step)
            maker = self.plan.jobs[source.maker]
            record = self.plan.records.get(source.maker)
            # rows of objects may be made before the metadata of all
            if record and not (is_of_objects and maker.stage.grain is Grain.OBJECT):
                metadata[name] = record.metadata
        objects = self._objects
        if is_of_objects and not objects:
            objects = tuple(number for number, _ in self.plan.objects or [])
        groups = {group: getattr(job.settings, group) for group in job.stage.settings}
        return Inputs(
            pair_id=self.plan.pair_id,
            part=job.part,
            settings=cast(Settings, SimpleNamespace(**groups)),
            tables=tables,
            outputs=metadata,
            scans=scans,
            T_real_sim=self.plan.pair.T_real_sim if "sim" in scans else None,
            objects=objects,
            arguments=job.stage.arguments,
            step=step,
            memo=self._memo,
        )

    def _read(self, source: Source, step: Steps) -> pa.Table:
        """The declared columns of a table that was made here or is in the run's folder."""
        made = self.tables.get((source.table, source.side))
        if made is not None:
            if source not in self._selected:
                self._selected[source] = made.select(source.columns)
            return self._selected[source]
        if source not in self._stored:
            path = table_name(source.table, self.plan.pair_id, source.side)
            stored = self.plan.records[source.maker].files[path]  # type: ignore[index]
            with step("read"):
                rows = self._folder.read(source.table, stored, path, list(source.columns))
            self._stored[source] = rows
        return self._stored[source]

    def _scan(self, side: str) -> Scan:
        """The scan of a side, whose file must be the one that the keys were made of."""
        if side not in self.scans:
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
            self.scans[side] = scan
        return self.scans[side]

    def _finish(self, job: Job, made: JobResult, steps: Steps) -> None:
        """Record a job, and write its tables.

        Raises
        ------
        ValueError
            The tables are not those that the stage declares.
        """
        if set(made.tables) != set(job.stage.gives):
            found = ", ".join(made.tables)
            raise ValueError(
                f"stage {job.stage.name}: expected tables {job.stage.gives}, got {found}"
            )
        plan = self.plan
        metadata = plain_metadata(made.metadata)
        record = JobRecord(job.stage.name, plan.pair_id, job.part, "", {}, metadata=metadata)
        if self._is_stored:
            record.key = plan.keys[job.name]
            record.reads = reads(job, plan.keys)
            record.made_by = plan.token
            with steps("write"):
                record.files = self._folder.write_job(record, made.tables)
        record.steps = steps.total()
        self.plan = plan.with_records([record])
        needed = [left.scan_sides for left in self.plan.todo]
        for side in set(self.scans).difference(*needed):
            del self.scans[side]  # no later job reads it
        self.result.records.append(record)


def _joined(parts: Sequence[Tables]) -> JobResult:
    """The rows of several parts of the same tables."""
    tables = {}
    for name in parts[0]:
        tables[name] = pa.concat_tables([part[name] for part in parts])
    return JobResult(tables)


def _gathered(job: Job, inputs: Inputs, made: JobResult) -> JobResult:
    """The rows of all objects, in the order of the table's keys."""
    tables = {}
    for name, rows in made.tables.items():
        keys = [(key, "ascending") for key in TABLES[name].keys]
        tables[name] = rows.sort_by(keys).combine_chunks()
    metadata = job.stage.gather(inputs, tables) if job.stage.gather is not None else {}
    return JobResult(tables, metadata)


@lru_cache(maxsize=2)
def _kept(token: str, pair_id: str, keys: tuple[str, ...]) -> tuple[dict[Source, pa.Table], Memo]:
    """Stored tables and common results of a pair that has several batches of objects, kept by the process."""
    return {}, Memo()


def _failure(job: Job, error: Exception) -> JobFailure:
    if isinstance(error, FidpipeError):
        return JobFailure(job.name, str(error))
    if isinstance(error, MemoryError):
        return JobFailure(job.name, f"out of memory ({error})")
    trace = "".join(traceback.format_exception(error))
    return JobFailure(job.name, f"internal error: {type(error).__name__}: {error}", trace)


def job_title(stage: str, part: str) -> str:
    """Name of a job in messages."""
    return f"stage {stage}{', ' + part if part else ''}"
