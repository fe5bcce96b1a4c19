"""Execution plan: the expected key of each job of a pair, and whether an intact result with that key exists."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import NamedTuple

from ...schemas.columns import SIDES
from ...schemas.settings import Settings
from ...schemas.tables import TABLES
from ..datasets.content import ScanContent
from ..datasets.pairs import ScanPair
from ..stage import N_CLEAN, OBJECTS, SCAN, Stage
from ..storage.files import key_of
from ..storage.folder import RunFolder
from ..storage.run_record import library_versions
from ..storage.table_files import JobId, JobName, JobRecord, TableFolder
from . import costs
from .time_limit import TimeLimit

OUT_OF_DATE = "out of date"  #: reason why a result made from or with something else is stale


class Source(NamedTuple):
    """A table that a job takes, and the job that writes it.

    maker : None for an input file
    """

    table: str
    side: str
    maker: JobId | None


@dataclass(frozen=True)
class Job:
    """One stage of one part, the same for all pairs of a run.

    key : a hash of all that its result depends on, except for the inputs
    sources : what it takes
    """

    stage: Stage
    part: str
    key: str
    settings: Settings
    sources: tuple[Source, ...] = ()

    @cached_property
    def name(self) -> JobId:
        """Name among the jobs of its pair."""
        return self.stage.name, self.part

    @cached_property
    def scan_sides(self) -> set[str]:
        """The sides whose input file it takes."""
        return {source.side for source in self.sources if source.maker is None}

    @cached_property
    def needs(self) -> set[JobId]:
        """The jobs of the pair whose results it takes."""
        return {source.maker for source in self.sources if source.maker is not None}


@dataclass(frozen=True)
class JobFailure:
    """Reason why a job failed; with the traceback if it is a bug."""

    job: JobId
    reason: str
    trace: str = ""


@dataclass(frozen=True)
class PairPlan:
    """The jobs of a pair, and what came of them: all that a worker needs to know, paths and keys, no points.

    jobs : by name, in their order
    keys : of each job's result, by name; of each input file by `SCAN` and side
    records : of the jobs that are done, by name
    failures : of others
    inputs : by side, what its file holds
    tables : of the run; None for results that are not written
    limit : how long workers may work on it; None for as long as it takes
    """

    pair: ScanPair
    jobs: Mapping[JobId, Job]
    keys: Mapping[JobId, str]
    records: Mapping[JobId, JobRecord] = field(default_factory=dict)
    failures: tuple[JobFailure, ...] = ()
    inputs: Mapping[str, ScanContent] = field(default_factory=dict)
    label_names: Mapping[int, str] = field(default_factory=dict)
    tables: TableFolder | None = None
    limit: TimeLimit | None = None

    @property
    def pair_id(self) -> str:
        """The name of the pair."""
        return self.pair.pair_id

    @property
    def n_points(self) -> int:
        """Points of both sides after cleaning; of a side that is not clean yet, estimated from the size of its file."""
        counts = {side: content.approximate_points for side, content in self.inputs.items()}
        for record in self.records.values():
            if N_CLEAN in record.metadata:
                counts[record.part] = record.metadata[N_CLEAN]
        return sum(counts.values())

    @property
    def todo(self) -> list[Job]:
        """The jobs that can still be done; none after the failure of one that every run has."""
        failed = {failure.job for failure in self.failures}
        if not all(self.jobs[name].stage.is_extra for name in failed):
            return []
        left = []
        for name, job in self.jobs.items():
            if failed and (name in failed or failed.intersection(job.needs)):
                failed.add(name)
            elif name not in self.records:
                left.append(job)
        return left

    @property
    def ready(self) -> list[Job]:
        """Those of them whose needs are done."""
        return [job for job in self.todo if self.records.keys() >= job.needs]

    @property
    def objects(self) -> list[tuple[int, int]] | None:
        """Id and nodes of each matched object, where a finished job lists them."""
        for record in self.records.values():
            if OBJECTS in record.metadata:
                return record.metadata[OBJECTS]
        return None

    @property
    def largest_object(self) -> tuple[int, int]:
        """Id and nodes of the object that has the most nodes; (-1, 0) if there are none."""
        return max(self.objects or [], key=lambda entry: entry[1], default=(-1, 0))

    def bytes_needed(self, *, with_objects: bool) -> int:
        """Bytes that jobs may need, estimated from the counts known so far; with objects: also the largest one."""
        n_bytes = costs.pair_bytes(self.n_points)
        if with_objects:
            n_bytes += costs.object_bytes(self.largest_object[1])
        return n_bytes

    def after(
        self, records: Iterable[JobRecord] = (), failures: Iterable[JobFailure] = ()
    ) -> PairPlan:
        """The same plan, knowing that some more jobs are done or have failed."""
        done = {**self.records, **{record.job: record for record in records}}
        return replace(self, records=done, failures=(*self.failures, *failures))


def plan_jobs(stages: Iterable[Stage], settings: Settings) -> dict[JobId, Job]:
    """The jobs of any pair under some settings, by name.

    Parameters
    ----------
    stages : in their order

    Raises
    ------
    ValueError, KeyError
        A stage takes what none before it gives, or names a table or a column that `schemas.tables`
        does not have.
    """
    makers: dict[tuple[str, str], JobId | None] = {(SCAN, side): None for side in SIDES}
    jobs: dict[JobId, Job] = {}
    for stage in stages:
        known = {table for table, _ in makers}
        missing = [table for table in stage.takes if table not in known]
        if missing:
            raise ValueError(
                f"stage {stage.name} takes {', '.join(missing)}, which no earlier stage makes"
            )
        method_key = _method_key(stage, settings)
        for part in stage.parts:
            key = key_of(method_key, part, list(stage.arguments))
            sources = _sources(stage, part, settings, makers)
            jobs[stage.name, part] = Job(stage, part, key, settings, sources)
            makers |= {(table, part): (stage.name, part) for table in stage.gives}
    return jobs


def plan_pair(
    jobs: Mapping[JobId, Job],
    pair: ScanPair,
    inputs: Mapping[str, ScanContent],
    label_names: Mapping[int, str],
) -> PairPlan:
    """The jobs of a pair with their expected keys, none of them done yet.

    The key of a result is a hash of its stage's name, version, settings and libraries, the columns
    of the tables that it gives, its arguments and part, and the keys of what it reads; that of an
    input file hashes its content, its labels with their names, and T_real_sim.

    Parameters
    ----------
    inputs : by side, what its file holds
    label_names : class names by number
    """
    keys = {(SCAN, side): inputs[side].key(label_names, pair.motion(side)) for side in SIDES}
    for name, job in jobs.items():
        keys[name] = _key(job, keys)
    return PairPlan(pair, jobs, keys, inputs=inputs, label_names=label_names)


def plan_on_results(
    jobs: Mapping[JobId, Job], pair: ScanPair, records: Mapping[JobId, JobRecord], stage: Stage
) -> PairPlan:
    """The job of one stage of a pair whose other results are taken as they are, whatever they were made of.

    Parameters
    ----------
    records : finished jobs of the pair, by name
    stage : of grain PAIR
    """
    name = (stage.name, "")
    done = {job: record for job, record in records.items() if job in jobs and job != name}
    keys = {job: record.key for job, record in done.items()}
    keys[name] = _key(jobs[name], keys)
    return PairPlan(pair, {job: jobs[job] for job in keys}, keys, done)


def _method_key(stage: Stage, settings: Settings) -> str:
    """A hash of the settings, versions and code of a stage, which is the same for all pairs."""
    if SCAN in stage.takes and "input" not in stage.settings:
        raise ValueError(
            f"stage {stage.name}: takes {SCAN}, whose columns are read by the settings input"
        )
    groups = {}
    for group in stage.settings:
        groups[group] = getattr(settings, group).model_dump(mode="json")
    given = {}
    for table in stage.gives:
        given[table] = [f"{field.name} {field.type}" for field in TABLES[table].schema]
    libraries = library_versions(("numpy", "scipy", *stage.libraries))
    return key_of(stage.name, stage.version, groups, libraries, given)


def _sources(
    stage: Stage,
    part: str,
    settings: Settings,
    makers: Mapping[tuple[str, str], JobId | None],
) -> tuple[Source, ...]:
    """Inputs of one job of a stage: the tables and files that exist of its side or of the pair.

    Parameters
    ----------
    makers : by table and side, the job that makes it; None for an input file
    """
    sides = ("", part) if part else ("", *SIDES)
    declared = []
    for table in stage.takes:
        declared += [(table, side) for side in sides]
    if part == "sim":
        declared += [(table, "real") for table in stage.takes_real(settings)]
    return tuple(Source(*name, makers[name]) for name in declared if name in makers)


def with_results(
    plan: PairPlan,
    folder: RunFolder,
    redo: frozenset[str] = frozenset(),
) -> tuple[PairPlan, dict[JobName, str]]:
    """The plan knowing which jobs are done, and the stale finished jobs of the pair, with the reason.

    The result of an optional stage that is not requested is kept while its inputs are current.

    Parameters
    ----------
    plan : as planned
    folder : of the run
    redo : stages to recompute regardless of their keys
    """
    records = folder.ledger.jobs(plan.pair_id)
    whole = []
    unwanted = {}
    for name, job in plan.jobs.items():
        record = records.pop(name, None)
        if record is None:
            continue
        if record.key != plan.keys[name]:
            unwanted[record.name] = OUT_OF_DATE
        elif folder.damaged_files(record):
            unwanted[record.name] = "damaged or gone"
        elif job.stage.name in redo:
            unwanted[record.name] = "requested by --from"
        else:
            whole.append(record)
    for record in records.values():
        if not set(plan.keys.values()).issuperset(record.reads):
            unwanted[record.name] = OUT_OF_DATE
    return plan.after(whole), unwanted


def _key(job: Job, keys: Mapping[JobId, str]) -> str:
    """The key of a job's result: keys are hexadecimal digits, so that a space ends each."""
    return hashlib.sha256(" ".join((job.key, *reads(job, keys))).encode()).hexdigest()


def reads(job: Job, keys: Mapping[JobId, str]) -> tuple[str, ...]:
    """The keys of all that a job takes, in its order."""
    return tuple(
        dict.fromkeys(
            keys[source.maker or (source.table, source.side)] for source in job.sources
        )
    )
