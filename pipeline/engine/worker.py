"""Work of a worker: jobs of a pair one after the other, or some objects of one; also in memory.

A table that comes from the job before it and one that comes from the run's folder are the same,
value for value.
"""

from __future__ import annotations

import traceback
from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
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
from ..storage.scratch import temporary_space
from ..storage.table_files import JobId, JobRecord, plain_metadata, table_name
from .plan import Job, JobFailure, PairPlan, Source, plan_jobs, reads
from .time_limit import OutOfTimeError, limited

#: Tables of a pair by name and side.
PairTables = dict[tuple[str, str], pa.Table]
#: A pair without a name, whose tables are of no dataset.
NAMELESS = ScanPair("", None, None)
#: Of some objects, by job: rows of its tables, and name and seconds of its steps.
ObjectRows = dict[JobId, tuple[Tables, tuple[tuple[str, float], ...]]]


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
    most_bytes : that the batch may occupy; it ends before a job that may need more
    objects : score these objects alone, and write nothing
    rows : of all objects, from such batches, from which the jobs write their tables
    """

    plan: PairPlan
    jobs: tuple[JobId, ...]
    most_bytes: int
    objects: tuple[int, ...] = ()
    rows: tuple[ObjectRows, ...] = ()


def run_batch(batches: Sequence[PairBatch]) -> list[BatchResult]:
    """Run the jobs of each pair and write their results; a failed job does not stop those that do not need it."""
    results = []
    for batch in batches:
        runner = JobRunner(batch.plan, objects=batch.objects)
        try:
            with limited(batch.plan.limit) as note:
                for name in batch.jobs:
                    job = batch.plan.jobs[name]
                    if job not in runner.plan.ready:
                        continue
                    need = runner.plan.bytes_needed(
                        with_objects=job.stage.grain is Grain.OBJECT
                    )
                    if need > batch.most_bytes and not batch.objects:
                        break
                    note(job_title(*name))
                    try:
                        with temporary_space():
                            runner.make_job(job, batch.rows)
                    except DiskFullError:
                        raise  # no other pair could go on either
                    except Exception as error:
                        runner.fail(_failure(job, error))
        except OutOfTimeError as error:
            runner.fail(JobFailure(batch.jobs[0], str(error)))
        results.append(runner.result)
    return results


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
    tables : existing tables, at least with the columns that the stages read; the jobs that make
        them are not run, nor those of a side without a table or a scan

    Raises
    ------
    StageError
        A stage fails; with the name of its job.
    """
    runner = JobRunner(PairPlan(pair, plan_jobs(stages, settings), defaultdict(str)), scans)
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
    scans : by side, those in memory
    objects : score these alone, and write nothing

    Attributes
    ----------
    plan : knows what came of the jobs so far
    tables : results of its jobs
    result : of the jobs, for the command
    """

    def __init__(
        self,
        plan: PairPlan,
        scans: Mapping[str, Scan] | None = None,
        objects: tuple[int, ...] = (),
    ) -> None:
        self.plan = plan
        self.tables: PairTables = {}
        self.result = BatchResult()
        self.scans = dict(scans or {})
        self._objects = objects
        self._stored: PairTables = {}
        self._memo = Memo()
        if objects and plan.tables:  # the pair's other batches read the same
            keys = tuple(plan.keys.values())
            self._stored, self._memo = _kept(plan.tables.token, plan.pair_id, keys)

    def fail(self, failure: JobFailure) -> None:
        """Note the failure of a job."""
        self.plan = self.plan.after(failures=[failure])
        self.result.failures.append(failure)

    def make_job(self, job: Job, rows: tuple[ObjectRows, ...] = ()) -> None:
        """Run a job, and write its results unless they are those of some objects; its errors are raised unchanged.

        Parameters
        ----------
        rows : see `PairBatch`
        """
        parts = [part[job.name] for part in rows]
        steps = Steps(chain.from_iterable(seconds for _, seconds in parts))
        inputs = self._inputs(job, steps)
        if job.stage.grain is Grain.OBJECT and not self._objects:
            tables = [tables for tables, _ in parts] or [job.stage.make(inputs).tables]
            made = _gathered(job, inputs, tables)
        else:
            made = job.stage.make(inputs)
        if self._objects:
            self.result.scored[job.name] = made.tables, steps.total()
            self.plan = self.plan.after([self._record(job, made)])
        else:
            self._finish(job, made, steps)
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
        """A table that was made here, or is in the run's folder: then without the names of pair and side."""
        name = source.table, source.side
        if name in self.tables:
            return self.tables[name]
        if name not in self._stored:
            path = table_name(source.table, self.plan.pair_id, source.side)
            stored = self.plan.records[source.maker].files[path]  # type: ignore[index]
            table = TABLES[source.table]
            columns = [column for column in table.schema.names if column not in table.of_file]
            with step("read"):
                rows = self.plan.tables.read(source.table, stored, path, columns)  # type: ignore[union-attr]
            self._stored[name] = rows
        return self._stored[name]

    def _scan(self, side: str) -> Scan:
        """The scan of a side, whose file must be the one that the keys were made of."""
        if side not in self.scans:
            ref = self.plan.pair.scans.get(side)
            if ref is None:
                raise StageError(f"no {side} scan")
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
        record = self._record(job, made)
        if self.plan.tables:
            with steps("write"):
                self.plan.tables.write_job(record, made.tables)
        record.steps = steps.total()
        self.plan = self.plan.after([record])
        if self.scans:
            needed = [left.scan_sides for left in self.plan.todo]
            for side in set(self.scans).difference(*needed):
                del self.scans[side]  # no later job reads it
        self.result.records.append(record)

    def _record(self, job: Job, made: JobResult) -> JobRecord:
        """The record of a finished job, without its files and seconds."""
        return JobRecord(
            job.stage.name,
            self.plan.pair_id,
            job.part,
            self.plan.keys[job.name],
            reads=reads(job, self.plan.keys),
            metadata=plain_metadata(made.metadata),
        )


def _gathered(job: Job, inputs: Inputs, parts: Sequence[Tables]) -> JobResult:
    """The rows of all objects, in the order of the table's keys."""
    tables = {}
    for name in parts[0]:
        rows = pa.concat_tables([part[name] for part in parts])
        keys = [(key, "ascending") for key in TABLES[name].keys]
        tables[name] = rows.sort_by(keys).combine_chunks()
    metadata = job.stage.gather(inputs, tables) if job.stage.gather is not None else {}
    return JobResult(tables, metadata)


@lru_cache(maxsize=2)
def _kept(token: str, pair_id: str, keys: tuple[str, ...]) -> tuple[PairTables, Memo]:
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
